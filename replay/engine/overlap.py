"""Overlap of frames: processes observe frames while the loop concludes earlier ones, in their order.

Each process has a pipeline of its own and hears of all frames, but gets only the poses of those that others observe.
So what it makes of a frame is what the loop's own pipeline would have made of it: see `contracts.protocols.Overlaps`.
"""

import os
import signal
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any, Self, TypeAlias

from fbench.replay.contracts.devices import current_execution, use_device
from fbench.replay.contracts.errors import INTERRUPTS, ConfigError, MissingPackageError, RunError, one_line
from fbench.replay.contracts.params import synchronize_cuda
from fbench.replay.contracts.plugins import open_pipeline
from fbench.replay.contracts.protocols import Overlaps
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Image, Pose
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.engine.warm_up import WarmUp
from fbench.replay.geometry.threads import VARIABLE

MOST_PROCESSES = 256
_AHEAD = 2  # Frames that are read in advance for each process
_MOST_ORDERS = 100  # That wait for the next frame
_END_S = 2.0  # To end by itself; then it is killed
_PROGRAM = "import sys; from fbench.replay.engine.overlap import main; sys.exit(main(sys.argv[1:]))"

_Order: TypeAlias = tuple[str, Any]
"""What a process is to do: `start` with rig and log, `reset`, `pass_by` or `observe` a frame."""


@dataclass(frozen=True, eq=False)
class ObservedFrame:
    """What a process made of a frame."""

    content: Any = None
    failed: str | None = None
    """What the pipeline raised, as a line."""
    is_missing: bool = False  # Whether a package is missing, so that no frame will do better
    wall_ns: int = 0
    cpu_ns: int = 0
    compiled: bool = False  # Whether code was compiled or loaded meanwhile


def make_overlap(num: int) -> int:
    """Return how many processes observe frames. Raises ConfigError where that isn't a number of them."""
    if not 1 <= num <= MOST_PROCESSES:
        raise ConfigError(f"--overlap {num}: expected 1 to {MOST_PROCESSES}")
    return num


class _Process:
    """One process, and the thread that waits for its answers."""

    def __init__(self, name: str, settings: list[str]) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            device = current_execution().device
            words = [sys.executable, "-P", "-c", _PROGRAM, str(theirs.fileno()), device, name, *settings]
            one = dict.fromkeys((VARIABLE, "OMP_NUM_THREADS"), "1")  # the processes share the processors
            self._process = subprocess.Popen(  # noqa: S603  # a module of ours
                words, stdin=subprocess.DEVNULL, stdout=2, pass_fds=[theirs.fileno()], env={**os.environ, **one}
            )
        self._socket, self._connection = ours, Connection(os.dup(ours.fileno()))
        self._thread = ThreadPoolExecutor(1, "fbench-overlap")
        self._orders: list[_Order] = []

    def await_ready(self) -> Future[ObservedFrame]:
        """Wait for it to start; from here on, only `close` ends its thread."""
        return self._thread.submit(self._receive)

    def tell(self, kind: str, content: Any) -> None:
        """Give it something to do before the next frame."""
        self._orders.append((kind, content))
        if len(self._orders) > _MOST_ORDERS:  # as where no frame can be sent
            orders, self._orders = self._orders, []
            self._thread.submit(self._send, orders)

    def observe(self, frame: Frame) -> Future[ObservedFrame]:
        """Have it observe a frame."""
        orders, self._orders = [*self._orders, ("observe", frame)], []
        return self._thread.submit(self._ask, orders)

    def close(self) -> None:
        """End it, whatever it does."""
        self._thread.shutdown(wait=False, cancel_futures=True)
        with self._socket:
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)  # wakes both sides
            try:
                self._process.wait(_END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._thread.shutdown()
        self._connection.close()

    def _ask(self, orders: list[_Order]) -> ObservedFrame:
        self._send(orders)
        return self._receive()

    def _send(self, orders: list[_Order]) -> None:
        with suppress(OSError):  # then there is no answer, either
            self._connection.send(orders)

    def _receive(self) -> ObservedFrame:
        try:
            answer: ObservedFrame | str = self._connection.recv()
        except (EOFError, OSError):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_END_S)
            code = self._process.returncode
            raise RunError(f"--overlap: a process that observed frames ended (exit code {code})") from None
        except Exception as error:  # of a plug-in's class
            raise RunError(f"--overlap: what `observe` returned can't be read: {one_line(error)}") from error
        if isinstance(answer, str):
            raise RunError(f"--overlap: a process can't observe frames: {answer}")
        return answer


class Overlap:
    """Processes that observe the frames of one replay. A `with` block ends them at its end. Raises RunError where one
    of them can't be started, or is lost.
    """

    def __init__(self, pipeline: str, settings: list[str], num: int) -> None:
        self._ends = ExitStack()
        with self._ends as ends:
            self._processes = [ends.enter_context(closing(_Process(pipeline, settings))) for _ in range(num)]
            for start in [process.await_ready() for process in self._processes]:
                start.result()
            self._ends = ends.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.close()

    @property
    def num(self) -> int:
        """How many processes there are."""
        return len(self._processes)

    def run(
        self,
        frames: Iterable[tuple[Frame, Rig]],
        info: LogInfo,
        disturb: Callable[[Rig], Rig],
        used: Collection[str] | None,
    ) -> Iterator[tuple[Frame, Rig, ObservedFrame | None]]:
        """Yield frames in their order with what a process made of each; `None`: none did, as its video can't be sent.

        `disturb` makes the rig that the pipeline is given. `used`: sensors whose messages it looks at; `None`: at all.
        """
        waiting, number = deque[tuple[Frame, Rig, Future[ObservedFrame] | None]](), 0
        first: Rig | None = None
        known: Rig | None = None
        segment: int | None = None
        for frame, rig in frames:
            for process in self._processes:
                if rig is not known:
                    process.tell("start", (disturb(rig), info))
                if frame.segment != segment:
                    process.tell("reset", f"segment {frame.segment} begins")
            first, known, segment = first or rig, rig, frame.segment
            sent = _strip(frame, used if rig is first else None)  # what is used may change with the rig
            is_video = any(isinstance(m, Image) and m.video is not None for m in sent.messages.values())
            chosen = None if is_video else self._processes[number % self.num]
            poses = replace(frame, messages={name: m for name, m in frame.messages.items() if isinstance(m, Pose)})
            for process in self._processes:
                if process is not chosen:
                    process.tell("pass_by", poses)
            if chosen is None:
                waiting.append((frame, rig, None))
            else:
                waiting.append((frame, rig, chosen.observe(sent)))
                number += 1
            if len(waiting) > _AHEAD * self.num:
                yield _result(waiting.popleft())
        while waiting:
            yield _result(waiting.popleft())


def _result(waiting: tuple[Frame, Rig, Future[ObservedFrame] | None]) -> tuple[Frame, Rig, ObservedFrame | None]:
    frame, rig, future = waiting
    return frame, rig, None if future is None else future.result()


def _strip(frame: Frame, used: Collection[str] | None) -> Frame:
    """Leave out messages at which nobody looks."""
    if used is None:
        return frame
    kept = {name: m for name, m in frame.messages.items() if name in used or isinstance(m, Pose)}
    return replace(frame, messages=kept)


def main(arguments: list[str]) -> int:
    """Observe frames until the connection ends."""
    import cv2

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asks ends it
    cv2.setNumThreads(1)
    connection, name, settings = Connection(int(arguments[0])), arguments[2], arguments[3:]
    with connection, use_device("cuda" if arguments[1] == "cuda" else "cpu"), suppress(EOFError, OSError):
        try:
            with open_pipeline(name, settings) as (pipeline, _), closing(WarmUp()) as warm_up:
                if not isinstance(pipeline, Overlaps):
                    raise TypeError(f"{name} has no frames that overlap")
                connection.send(ObservedFrame())
                while True:
                    for kind, content in connection.recv():
                        if kind == "start":
                            pipeline.start(*content)
                        elif kind == "reset":
                            pipeline.reset(content)
                        elif kind == "pass_by":
                            pipeline.pass_by(content)
                        else:
                            _answer(connection, _observe(pipeline, content, warm_up))
        except (EOFError, OSError, *INTERRUPTS):
            raise
        except BaseException as error:  # noqa: BLE001 - of a plug-in; the replay ends with it
            connection.send(one_line(error))
    return 0


def _observe(pipeline: Overlaps, frame: Frame, warm_up: WarmUp) -> ObservedFrame:
    num_compiled, start, cpu_start = warm_up.count(), time.perf_counter_ns(), time.process_time_ns()
    try:
        seen = ObservedFrame(pipeline.observe(frame))
    except INTERRUPTS:
        raise
    except BaseException as error:  # noqa: BLE001 - it is a fault of the frame
        is_missing = isinstance(error, MissingPackageError)
        seen = ObservedFrame(failed=str(error) if is_missing else one_line(error), is_missing=is_missing)
    synchronize_cuda()
    wall_ns, cpu_ns = time.perf_counter_ns() - start, time.process_time_ns() - cpu_start
    return replace(seen, wall_ns=wall_ns, cpu_ns=cpu_ns, compiled=warm_up.count() > num_compiled)


def _answer(connection: Connection, seen: ObservedFrame) -> None:
    try:
        connection.send(seen)
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001 - what it observed can't be pickled
        connection.send(f"what `observe` returned can't be sent: {one_line(error)}")
