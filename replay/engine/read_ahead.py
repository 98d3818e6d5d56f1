"""Reading ahead: a thread reads and decodes messages while the pipeline works on earlier ones.

Order, faults and errors are those of reading without it: what was met while a message was read is told when that
message is delivered, and what was read but never delivered was never met.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog, StagedFaults
from fbench.replay.contracts.protocols import Reader
from fbench.replay.data.messages import Message, Tick, Truth
from fbench.replay.data.rig import LogInfo, Rig, RigChange

T = TypeVar("T")
R = TypeVar("R", bound=Message | RigChange | Tick)

DEFAULT = 4  # Messages: reading takes a few percent of a replay, and more than these hide no more of it
MAX_BYTES = 256 * 1024 * 1024  # What waits takes so much memory at most; one message may always wait


def make_limit(text: str) -> int | None:
    """Read `--read-ahead`. Raises ConfigError where it can't be understood."""
    if text in ("all", "auto"):
        return None if text == "all" else DEFAULT
    if not (text.isascii() and text.isdecimal() and len(text) <= 9):
        raise ConfigError(f"--read-ahead {text}: expected a number of messages, 'all' or 'auto'")
    return int(text)


@contextmanager
def open_ahead(open_log: Callable[[FaultLog], Reader], faults: FaultLog, limit: int | None) -> Iterator[Reader]:
    """Open a log and read ahead while the `with` block runs; faults are counted when their message is delivered.

    At most `limit` messages wait; 0: don't read ahead, `None`: as many as fit into `MAX_BYTES`.
    """
    if limit == 0:
        yield open_log(faults)
        return
    staged = StagedFaults()
    with ExitStack() as ends:
        ends.callback(staged.pass_to, faults)
        ahead = _AheadReader(open_log(staged), staged, faults, limit)
        ends.callback(ahead.stop)
        yield ahead


_LOOK_S = 1.0  # How often to look whether the thread still lives: without memory it may end and say nothing


class _Item(NamedTuple, Generic[R]):
    """What the thread hands over."""

    content: R | BaseException | None  # A message, an error that ended reading, or `None` at the end
    faults: StagedFaults
    num_bytes: int


class _Queue(Generic[R]):
    """Bounded by number and by bytes; closing it from either side wakes the other."""

    def __init__(self, limit: int | None) -> None:
        self._limit, self._items, self._num_bytes, self._closed = limit, deque[_Item[R]](), 0, False
        self._changed = threading.Condition()

    def put(self, item: _Item[R]) -> bool:
        """Wait for room and append; `False` where nobody wants it any more."""

        def has_room() -> bool:
            full = self._limit is not None and len(self._items) >= self._limit
            return not self._items or (not full and self._num_bytes + item.num_bytes <= MAX_BYTES)

        with self._changed:
            self._changed.wait_for(lambda: self._closed or has_room())
            if self._closed:
                return False
            self._items.append(item)
            self._num_bytes += item.num_bytes
            self._changed.notify_all()
            return True

    def get(self, is_filled: Callable[[], bool]) -> _Item[R]:
        """Wait for the next item. Raises MemoryError where nobody fills the queue any more, and nobody said why."""
        with self._changed:
            while not self._changed.wait_for(lambda: self._closed or self._items, _LOOK_S):
                if not (is_filled() or self._items):
                    raise MemoryError
            if not self._items:
                return _Item(None, StagedFaults(), 0)
            item = self._items.popleft()
            self._num_bytes -= item.num_bytes
            self._changed.notify_all()
            return item

    def close(self) -> None:
        """Let the other side end."""
        with self._changed:
            self._closed = True
            self._items.clear()
            self._changed.notify_all()


class _AheadReader:
    """A reader that reads ahead of whoever iterates over its messages; only one thread uses the log at a time."""

    def __init__(self, reader: Reader, staged: StagedFaults, faults: FaultLog, limit: int | None) -> None:
        self._reader, self._staged, self._faults, self._limit = reader, staged, faults, limit
        self._running: tuple[threading.Thread, _Queue[Any]] | None = None

    @property
    def info(self) -> LogInfo:
        return self._describe(self._reader.info)

    @property
    def rig(self) -> Rig:
        return self._describe(self._reader.rig)

    @property
    def num_messages(self) -> Mapping[str, int]:
        return self._describe(self._reader.num_messages)

    @property
    def poses(self) -> tuple[str, ...]:
        return self._describe(self._reader.poses)

    def _describe(self, value: T) -> T:
        """Pass on what the reader says of its log, with the faults met on the way, unless the thread uses it."""
        if self._running is None:
            self._staged.pass_to(self._faults)
        return value

    def messages(self) -> Iterator[Message | RigChange | Tick]:
        """All messages of the log, read by a thread that ends with the iteration."""
        return self._ahead(self._reader.messages)

    def events(self) -> Iterator[Message | RigChange | Tick]:
        return self._ahead(self._reader.events)

    def _ahead(self, messages: Callable[[], Iterator[R]]) -> Iterator[R]:
        self.stop()
        queue = _Queue[R](self._limit)
        thread = threading.Thread(target=self._read, args=(queue, messages), name="fbench-read-ahead")
        try:
            self._running = (thread, queue)
            thread.start()
            while True:
                item = queue.get(thread.is_alive)
                item.faults.pass_to(self._faults)
                if isinstance(item.content, BaseException):
                    raise item.content
                if item.content is None:
                    return
                yield item.content
        finally:
            self.stop()

    def truths(self) -> Iterator[Truth]:
        """Ground truth, not read ahead."""
        self.stop()
        for truth in self._reader.truths():
            self._staged.pass_to(self._faults)
            yield truth
        self._staged.pass_to(self._faults)

    def stop(self) -> None:
        """End the thread, and forget what was read but not delivered."""
        if self._running is None:
            return
        thread, queue = self._running
        queue.close()
        if thread.is_alive():  # a signal may come while it starts; then it ends by itself, as nobody wants anything
            thread.join()
        self._running = None
        self._staged.clear()

    def _read(self, queue: _Queue[R], messages: Callable[[], Iterator[R]]) -> None:
        end: BaseException | None = None
        try:
            for message in messages():
                values = [getattr(message, f.name) for f in fields(message)]
                num_bytes = sum(v.nbytes for v in values if isinstance(v, np.ndarray))
                num_bytes += sum(len(v) for v in values if isinstance(v, bytes))
                if not queue.put(_Item(message, self._staged.take(), num_bytes)):
                    return
        except BaseException as error:  # noqa: BLE001  # whatever it is, it is raised where the message is wanted
            end = error
        queue.put(_Item(end, self._staged.take(), 0))
