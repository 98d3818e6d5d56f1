"""Finding for each frame what another system made of it, reading its results alongside."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from fbench.replay.data import Frame, Truth
from fbench.replay.truth.labelling import joined

HELD = 256
"""So many results are held; also so far a log is read on after a clock jumped back."""
_LOOK_AHEAD_NS = 500_000_000
"""Results are read so far beyond what a frame can take, since they needn't be in the order of their stamps."""
_LOOK_AHEAD = 8
"""The same in frames, where results say of which frame they are."""
_PERIODS = 9


@dataclass(eq=False)
class _Held:
    """A result that was read."""

    truth: Truth
    stamp_ns: int
    is_done: bool = False
    """Whether a frame took it, or it was counted as one that none took."""


class Alongside:
    """Gives each result to at most one frame: the nearest one.

    Which frame comes next isn't known yet. So what lies behind a frame counts as its own up to half of the median
    period of the frames before it.

    Args:
        results: In the order in which they were recorded.
        tolerance_ns: How far stamps of a frame and its result may differ.
        offset_ns: What results' stamps are ahead of those of their frames.
    """

    def __init__(self, results: Iterator[Truth], tolerance_ns: int, offset_ns: int) -> None:
        self._results, self._tolerance_ns, self._offset_ns = results, tolerance_ns, offset_ns
        self._held: deque[_Held] = deque(maxlen=HELD)
        self._before: Frame | None = None
        self._reach_ns = tolerance_ns
        self._periods: deque[int] = deque(maxlen=_PERIODS)
        self._newest: _Held | None = None
        self._last_ns: int | None = None
        self._back_ns = self._budget = 0

    def enter(self) -> None:
        """Begin a segment: frames before it don't count."""
        self._before = None
        self._periods.clear()
        for held in self._held:
            held.is_done = False

    def take(self, frame: Frame) -> tuple[Truth | None, int]:
        """Return the frame's result, and how many since the frame before it belong to none."""
        self._read(frame)
        before, reach_before_ns = self._before, self._reach_ns
        self._note(frame)
        fitting = [h for h in self._held if not h.is_done and self._fits(h, frame, before, reach_before_ns)]
        best = min(fitting, key=lambda held: _distance(held, frame), default=None)
        result = None if best is None else self._whole(best, fitting)
        return result, 0 if before is None else self._passed(before, frame)

    def _note(self, frame: Frame) -> None:
        """Take a frame's stamp, and say how far behind it results count as its own."""
        if self._before is not None:
            self._periods.append(frame.stamp_ns - self._before.stamp_ns)
        periods = sorted(self._periods)
        half = periods[(len(periods) - 1) // 2] // 2 if periods else self._tolerance_ns
        self._before, self._reach_ns = frame, min(self._tolerance_ns, half)

    def _fits(self, held: _Held, frame: Frame, before: Frame | None, reach_before_ns: int) -> bool:
        counted = _counted(held.truth, frame)
        if counted is not None:
            return counted[0] == counted[1]
        behind_ns = held.stamp_ns - frame.stamp_ns
        if not -self._tolerance_ns <= behind_ns <= self._reach_ns:
            return False
        if before is None:
            return True
        behind_last_ns = held.stamp_ns - before.stamp_ns
        return behind_last_ns > reach_before_ns or behind_last_ns > -behind_ns

    @staticmethod
    def _whole(best: _Held, fitting: list[_Held]) -> Truth:
        """Join what complements the best one at the same instant: boxes of several cameras."""
        best.is_done, whole = True, best.truth
        for held in fitting:
            same = (held.stamp_ns, held.truth.frame_index) == (best.stamp_ns, best.truth.frame_index)
            both = joined(whole, held.truth) if same and held is not best else None
            if both is not None:
                held.is_done, whole = True, both
        return whole

    def _passed(self, before: Frame, frame: Frame) -> int:
        passed = [h for h in self._held if not h.is_done and _is_between(h, before, frame)]
        for held in passed:
            held.is_done = True
        return len(passed)

    def _read(self, frame: Frame) -> None:
        """Read until behind what the frame can take; after a jump back, first past what was recorded before it."""
        if self._last_ns is not None and frame.stamp_ns < self._last_ns:
            self._back_ns, self._budget = (frame.stamp_ns + self._last_ns) // 2, HELD
        self._last_ns = frame.stamp_ns
        while self._budget > 0 or not self._is_behind(frame):
            truth = next(self._results, None)
            if truth is None:
                return
            self._newest = _Held(truth, truth.stamp_ns - self._offset_ns)
            self._held.append(self._newest)
            is_past_jump = truth.frame_index is not None or self._newest.stamp_ns < self._back_ns
            self._budget = 0 if is_past_jump else max(0, self._budget - 1)

    def _is_behind(self, frame: Frame) -> bool:
        """Tell whether the newest result lies so far behind a frame that those after it do as well."""
        if self._newest is None:
            return False
        counted = _counted(self._newest.truth, frame)
        if counted is not None:
            return counted[0] > counted[1] + _LOOK_AHEAD
        return self._newest.stamp_ns > frame.stamp_ns + self._tolerance_ns + _LOOK_AHEAD_NS


def _distance(held: _Held, frame: Frame) -> tuple[int, int]:
    """By stamps, of equal ones by when they were recorded: a recording that was played in a loop repeats its stamps."""
    arrived_ns = min((message.log_ns for message in frame.messages.values()), default=frame.stamp_ns)
    return abs(held.stamp_ns - frame.stamp_ns), abs(held.truth.log_ns - arrived_ns)


def _counted(truth: Truth, frame: Frame) -> tuple[int, int] | None:
    """Number of a result that says of which frame it is, and that of a frame, both as the log counts or as fbench does;
    `None` where stamps tell.
    """
    if truth.frame_index is None:
        return None
    if truth.frame_number is not None and frame.frame_number is not None:
        return truth.frame_number, frame.frame_number
    return truth.frame_index, frame.index


def _is_between(held: _Held, before: Frame, frame: Frame) -> bool:
    first, second = _counted(held.truth, before), _counted(held.truth, frame)
    if first is not None and second is not None:
        return first[1] < first[0] and second[0] < second[1]
    return before.stamp_ns < held.stamp_ns < frame.stamp_ns
