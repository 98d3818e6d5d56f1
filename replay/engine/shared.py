"""One decode for several replays of a log: what the first one reads and disturbs is kept for the next ones.

Replays come one after the other and get the same messages, faults and effects as if each had read the log itself. What
is kept is bounded in bytes; a log that takes more is read anew by each.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import fields
from typing import Self, TypeAlias

import numpy as np

from fbench.replay.conditions.disturb import Disturbance, DisturbedReader, Event
from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.steps import Deferred
from fbench.replay.contracts.faults import FaultLog, StagedFaults
from fbench.replay.contracts.protocols import Reader, ReaderWrapper
from fbench.replay.data.messages import Image
from fbench.replay.engine.read_ahead import open_ahead

Key: TypeAlias = tuple[object, ...]


class _Step:
    """One event, or the end where it is `None`, with what was met on the way to it."""

    __slots__ = ("counts", "event", "faults")

    def __init__(
        self, event: Event | Deferred | None, faults: StagedFaults, counts: list[tuple[str, dict[str, float]]]
    ) -> None:
        self.event, self.faults, self.counts = event, faults, counts


class _Stream:
    """Messages of a log under conditions, read once, as far as anybody wanted them; each is disturbed once one of the
    replays uses it.
    """

    def __init__(self, open_log: Callable[[FaultLog], Reader], disturbance: Disturbance, limit: int | None) -> None:
        self.steps: list[_Step] = []
        self.num_bytes, self.is_broken = 0.0, False
        self._ends, self._staged, self._effects = ExitStack(), StagedFaults(), _StagedEffects()
        with self._ends as ends:
            reader = ends.enter_context(open_ahead(open_log, self._staged, limit))
            _ = reader.info, reader.rig, reader.num_messages, reader.poses
            self._events: Iterator[Event | Deferred] = reader.messages()
            if disturbance:
                self._events = DisturbedReader(reader, disturbance, self._effects).defer(reader.messages())
            self._ends = ends.pop_all()
        self._staged.clear()  # each replay meets these when it opens the log for what isn't a message

    def read(self) -> _Step:
        """Read the next event."""
        try:
            event = next(self._events, None)
        except BaseException:  # who reads it next gets there by himself
            self.is_broken = True
            raise
        if event is None:
            self._ends.close()
        return _Step(event, self._staged.take(), self._effects.take())

    def close(self) -> None:
        """End reading, and forget everything."""
        self.steps = []
        self._ends.close()


class _StagedEffects(Effects):
    """Keeps what is to be counted until others take it."""

    def __init__(self) -> None:
        super().__init__()
        self._waiting: list[tuple[str, dict[str, float]]] = []

    def count(self, sensor: str, counts: Mapping[str, float]) -> None:
        self._waiting.append((sensor, dict(counts)))

    def take(self) -> list[tuple[str, dict[str, float]]]:
        """Hand over what was counted since the last time."""
        taken, self._waiting = self._waiting, []
        return taken


class SharedLogs:
    """The messages of one log under one condition at a time, for the replays of one process, of which `max_bytes` are
    kept at most; a `with` block forgets them at its end.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._key: Key | None = None
        self._stream: _Stream | None = None  # `None`: nothing is kept of this one
        self.num_shared = 0  # Replays that needn't have read anything

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._forget()

    def events(self, reader: "SharedReader") -> Iterator[Event]:
        """Yield the messages of a log for one replay."""
        stream = self._find(reader)
        if stream is None:
            return reader.read_alone()
        return self._replay(stream, reader)

    def _find(self, reader: "SharedReader") -> _Stream | None:
        if reader.key != self._key:
            self._forget()
            self._stream = _Stream(reader.open_log, reader.disturbance, reader.limit)
            self._key = reader.key
        elif self._stream is not None and self._stream.is_broken:
            self._drop()
        elif self._stream is not None:
            self.num_shared += 1
        return self._stream

    def _replay(self, stream: _Stream, reader: "SharedReader") -> Iterator[Event]:
        at, is_kept = 0, True
        while True:
            if is_kept and at < len(stream.steps):
                step = stream.steps[at]
            else:
                step = stream.read()
                if is_kept:
                    event = step.event
                    stream.num_bytes += _size(event.recorded if isinstance(event, Deferred) else event)
                    is_kept = stream.num_bytes <= self._max_bytes
                    if is_kept:
                        stream.steps.append(step)
                    else:
                        stream.steps, self._stream = [], None  # read to its end by this replay, by others anew
            at += 1
            step.faults.copy_to(reader.faults)
            for sensor, counts in step.counts:
                reader.effects.count(sensor, counts)
            if step.event is None:
                if not is_kept:
                    stream.close()
                return
            if isinstance(step.event, Deferred):
                yield self._take(stream, step.event, reader)
            else:
                yield step.event

    def _take(self, stream: _Stream, event: Deferred, reader: "SharedReader") -> Event:
        """Return a disturbed message, and keep it for others where it fits in."""
        was_known = event.result is not None
        message = event.take(reader.effects, is_used=reader.is_used(event.recorded.sensor))
        if event.result is not None and event.result is not event.recorded and not was_known:
            num_bytes = stream.num_bytes + _size(message)
            if num_bytes <= self._max_bytes:
                stream.num_bytes = num_bytes
            else:
                event.forget()
        return message

    def _drop(self) -> None:
        if self._stream is not None:
            self._stream.close()
        self._stream = None

    def _forget(self) -> None:
        self._drop()
        self._key = None


class SharedReader(ReaderWrapper):
    """A log whose messages, disturbed as asked, may have been read by an earlier replay.

    Raises ConfigError and LogError as `Disturbance.require_fits` does.
    """

    def __init__(
        self, logs: SharedLogs, key: Key, open_log: Callable[[FaultLog], Reader], disturbance: Disturbance,
        faults: FaultLog, effects: Effects, limit: int | None,
    ) -> None:  # fmt: skip
        self.key, self.open_log, self.disturbance, self.limit = key, open_log, disturbance, limit
        self.faults, self.effects = faults, effects
        self.is_used: Callable[[str], bool] = lambda sensor: True
        """Whether the replay's pipeline uses messages of a sensor, which may be known once it has started."""
        self._logs = logs
        super().__init__(open_log(faults))
        disturbance.require_fits(self.rig)

    def messages(self) -> Iterator[Event]:
        """All messages as they are delivered."""
        return self._logs.events(self)

    def events(self) -> Iterator[Event]:
        """The same with the instants of boxes, which aren't kept."""
        return self._disturb().events()

    def read_alone(self) -> Iterator[Event]:
        """Read and disturb all messages for this replay only."""
        return self._disturb().messages()

    def _disturb(self) -> Reader:
        if not self.disturbance:
            return self._reader
        return DisturbedReader(self._reader, self.disturbance, self.effects, self.is_used)


def _size(event: Event | None) -> float:
    """How much memory an event takes, about; a picture of a video needs those before it."""
    if isinstance(event, Image) and event.video is not None:
        return math.inf
    values = [] if event is None else [getattr(event, f.name) for f in fields(event)]
    arrays = sum(v.nbytes for v in values if isinstance(v, np.ndarray))
    return 500 + arrays + sum(len(v) for v in values if isinstance(v, bytes))
