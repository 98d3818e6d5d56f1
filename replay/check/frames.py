"""Which frames the messages of a log make, and what is missing in them."""

from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.check.stats import quantile
from fbench.replay.data import Frame, Message, RigChange, Tick
from fbench.replay.skipped import Skipped
from fbench.replay.sync import FrameBuffer, SyncParams


@dataclass(frozen=True)
class SensorFrames:
    """How one sensor takes part in the frames of a log."""

    sensor: str
    num_missing: int
    """Frames without it; `num_late` of them because it came after the time-out, `num_skipped` since it was unusable."""
    num_late: int
    num_skipped: int
    late_median_ms: float | None
    late_max_ms: float | None
    num_unused: int
    """Messages that are in no frame."""


@dataclass(frozen=True)
class FrameStats:
    """All frames of a log."""

    num_frames: int
    num_complete: int
    sensors: tuple[SensorFrames, ...]
    breaks: tuple[str, ...]
    """Where a new segment begins, and why."""


class FrameCheck:
    """Puts messages into frames as a replay does, and counts."""

    def __init__(self, expected: Sequence[str], reference: str, params: SyncParams) -> None:
        self._buffer = FrameBuffer(expected, reference, params)
        self._expected, self._reference = tuple(sorted(expected)), reference
        self._missing: Counter[str] = Counter()
        self._skipped: Counter[str] = Counter()
        self._stamps, self._numbers = array("q"), array("q")
        self._num_complete = 0

    def change(self, change: RigChange) -> Iterator[Frame]:
        """End the segment where the rig changes."""
        yield from self._counted(self._buffer.break_off(change.reason))

    def add(self, recorded: Message, message: Message, usable: Message | Skipped) -> Iterator[Frame]:
        """Add one message, as recorded, with the stamp that counts, and as a pipeline would get it; yields the frames
        that are released.
        """
        yield from self._counted(self._buffer.advance(message.log_ns))
        if message.sensor == self._reference:
            yield from self._opened(recorded, message)
        if isinstance(usable, Skipped):
            self._skipped[usable.sensor] += 1
        else:
            yield from self._counted(self._buffer.add(usable))

    def tick(self, tick: Tick) -> Iterator[Frame]:
        """Add an instant that boxes give."""
        yield from self._counted(self._buffer.advance(tick.log_ns))
        yield from self._opened(tick, tick)

    def flush(self) -> Iterator[Frame]:
        """Release all frames: the log ends."""
        yield from self._counted(self._buffer.flush())

    @property
    def stamps(self) -> tuple[Int64, Int64]:
        """Stamps, as recorded, and numbers (-1: none) of all frames."""
        return np.array(self._stamps, np.int64), np.array(self._numbers, np.int64)

    @property
    def stats(self) -> FrameStats:
        """What was counted."""
        counts = self._buffer.counts
        late: dict[str, list[int]] = {name: [] for name in self._expected}
        for (_, sensor), ms in counts.late_ms.items():
            late[sensor].append(round(ms * 1e6))
        rows = tuple(
            SensorFrames(
                name, self._missing[name], len(late[name]), min(self._skipped[name], self._missing[name]),
                _ms(late[name], 0.5), _ms(late[name], 1.0), counts.unused[name],
            )
            for name in self._expected
        )  # fmt: skip
        return FrameStats(len(self._stamps), self._num_complete, rows, tuple(self._buffer.breaks))

    def _opened(self, recorded: Message | Tick, message: Message | Tick) -> Iterator[Frame]:
        num = self._buffer.num_frames
        yield from self._counted(self._buffer.open_frame(message))
        if self._buffer.num_frames > num:
            self._stamps.append(recorded.stamp_ns)
            self._numbers.append(-1 if recorded.frame_number is None else recorded.frame_number)

    def _counted(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        for frame in frames:
            self._missing.update(list(frame.missing))
            self._num_complete += not frame.missing
            yield frame


def _ms(late_ns: list[int], share: float) -> float | None:
    value = quantile(np.array(late_ns, np.int64), share)
    return None if value is None else value / 1e6
