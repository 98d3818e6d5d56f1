"""Boxes and poses that another system wrote into the log or a file beside it, frame by frame."""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.contracts.protocols import BoxReader
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.messages import Pose, Truth
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.engine.poses import FramePoses
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import inverse
from fbench.replay.truth.labelling import join_truths

HELD = 256  # So many results are held; also so far a log is read on after a clock jumped back
_LOOK_AHEAD_NS = 500_000_000
"""Results are read so far beyond what a frame can take, since they needn't be in the order of their stamps."""
_LOOK_AHEAD = 8  # The same in frames, where results say of which frame they are
_PERIODS = 9


@dataclass(eq=False)
class _Held:
    truth: Truth
    stamp_ns: int
    is_done: bool = False  # Whether a frame took it, or it was counted as one that none took


class ResultFinder:
    """Gives each result to at most one frame: the nearest one.

    Which frame comes next isn't known yet. So what lies behind a frame counts as its own up to half of the median
    period of the frames before it. Results come in the order in which they were recorded. Their stamps may differ from
    those of their frames by `tolerance_ns` [ns], and are ahead of them by `offset_ns` [ns].
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
        if before is not None:
            self._periods.append(frame.stamp_ns - before.stamp_ns)
        periods = sorted(self._periods)
        half = periods[(len(periods) - 1) // 2] // 2 if periods else self._tolerance_ns
        self._before, self._reach_ns = frame, min(self._tolerance_ns, half)
        fitting = [h for h in self._held if not h.is_done and self._fits(h, frame, before, reach_before_ns)]
        result = None
        if (best := min(fitting, key=lambda held: _distance(held, frame), default=None)) is not None:
            best.is_done, result = True, best.truth
            # What complements it at the same instant is joined: boxes of several cameras.
            for held in fitting:
                same = (held.stamp_ns, held.truth.frame_index) == (best.stamp_ns, best.truth.frame_index)
                both = join_truths(result, held.truth) if same and held is not best else None
                if both is not None:
                    held.is_done, result = True, both
        passed = [h for h in self._held if before is not None and not h.is_done and _is_between(h, before, frame)]
        for held in passed:
            held.is_done = True
        return result, len(passed)

    def _fits(self, held: _Held, frame: Frame, before: Frame | None, reach_before_ns: int) -> bool:
        counted = _count(held.truth, frame)
        if counted is not None:
            return counted[0] == counted[1]
        behind_ns = held.stamp_ns - frame.stamp_ns
        if not -self._tolerance_ns <= behind_ns <= self._reach_ns:
            return False
        if before is None:
            return True
        behind_last_ns = held.stamp_ns - before.stamp_ns
        return behind_last_ns > reach_before_ns or behind_last_ns > -behind_ns

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
        counted = _count(self._newest.truth, frame)
        if counted is not None:
            return counted[0] > counted[1] + _LOOK_AHEAD
        return self._newest.stamp_ns > frame.stamp_ns + self._tolerance_ns + _LOOK_AHEAD_NS


def _distance(held: _Held, frame: Frame) -> tuple[int, int]:
    """By stamps, of equal ones by when they were recorded: a recording that was played in a loop repeats its stamps."""
    arrived_ns = min((message.log_ns for message in frame.messages.values()), default=frame.stamp_ns)
    return abs(held.stamp_ns - frame.stamp_ns), abs(held.truth.log_ns - arrived_ns)


def _count(truth: Truth, frame: Frame) -> tuple[int, int] | None:
    """Numbers of a result's frame and of a frame, both by the log's count or fbench's; `None` where stamps tell."""
    if truth.frame_index is None:
        return None
    if truth.frame_number is not None and frame.frame_number is not None:
        return truth.frame_number, frame.frame_number
    return truth.frame_index, frame.index


def _is_between(held: _Held, before: Frame, frame: Frame) -> bool:
    first, second = _count(held.truth, before), _count(held.truth, frame)
    if first is not None and second is not None:
        return first[1] < first[0] and second[0] < second[1]
    return before.stamp_ns < held.stamp_ns < frame.stamp_ns


_POSES_AHEAD_NS = 2_000_000_000
"""Poses are read so far behind a frame's arrival in search of the one that follows it."""


class PoseFinder:
    """Interpolates between the poses around a frame, as for truth, though the later one isn't there yet when the frame
    is complete. Poses come in the order in which they were recorded; of their streams that with this name counts.
    """

    def __init__(self, poses: Iterator[Pose], name: str | None) -> None:
        self._poses, self._found, self._num = poses, FramePoses(name), 0
        self._next = next(poses, None)

    def world_T_body(self, frame: Frame) -> Float64 | None:
        """Pose (4, 4) at a frame's instant; `None` where unknown. Frames come in their order, each once."""
        index, self._num = self._num, self._num + 1
        arrived_ns = min((message.log_ns for message in frame.messages.values()), default=frame.stamp_ns)
        while self._next is not None and self._next.log_ns <= arrived_ns:
            self._take(self._next)
        self._found.open(index, frame.stamp_ns)
        while self._found.is_waiting:
            if self._next is None or self._next.log_ns > arrived_ns + _POSES_AHEAD_NS:
                self._found.finish()
            else:
                self._take(self._next)
        return self._found.world_T_body(index)

    def _take(self, pose: Pose) -> None:
        self._found.add(pose)
        self._next = next(self._poses, None)


@dataclass(frozen=True)
class ResultParams(CheckedParams):
    """Which results, and how they belong to frames: parameters of pipelines that take them."""

    topic: str = ""
    """Topic with the results; empty: the file that was named beside the log, else the only topic with results."""
    tolerance_ms: float = in_range(50.0, 0)
    """A result belongs to the nearest frame whose stamp differs by no more than this [ms]."""
    offset_ms: float = in_range(0.0, -1e6)  # What the results' stamps are ahead of those of their frames [ms].


@dataclass(frozen=True, eq=False)
class Found:
    """What was recorded for one frame."""

    boxes: Boxes  # In body coordinates, or in images of the rig's cameras; empty where there is no result
    world_T_body: Float64 | None  # Pose (4, 4) of the body, `None` where unknown
    missing: Mapping[str, str] = field(default_factory=dict)  # What isn't there, and why
    faults: tuple[Fault, ...] = ()
    latency_ns: int | None = None
    """From the frame's instant to the recording of its result, `None` where it wasn't recorded by a stack at work."""


class RecordedBoxes:
    """Finds the result of each frame, for pipelines."""

    name: ClassVar[str]  # Of the pipeline, in errors
    argument: ClassVar[str] = "topic"

    def __init__(self, params: ResultParams) -> None:
        self._params, self._topic = params, params.topic or "results"
        self._log: BoxReader | None = None
        self._finder: ResultFinder | None = None
        self._poses: PoseFinder | None = None
        self.kind: type[Boxes] = Boxes3D

    def use_log(self, log: BoxReader) -> None:
        """Take the log whose results are meant."""
        self._log, self._finder = log, None

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Find out whether boxes are in 3D or in images; a result that holds both counts in 3D. Raises LogError where
        there are no results, or nothing can move them to the body.
        """
        self._rig = rig
        if self._log is None:
            raise ConfigError(f"pipeline '{self.name}' reads results from a log, and got none")
        if self._finder is None:
            self.kind = self._first_kind(self._log, log_info)
            results = self._log.detections(self._params.topic)
            tolerance_ns, offset_ns = (round(ms * 1e6) for ms in (self._params.tolerance_ms, self._params.offset_ms))
            self._finder = ResultFinder(results, tolerance_ns, offset_ns)
            self._poses = PoseFinder(self._log.body_poses(), min(self._log.poses, default=None))

    def reset(self, reason: str) -> None:
        """Begin a segment."""
        if self._finder is not None:
            self._finder.enter()

    def skip(self, frame: Frame) -> None:
        """Take the result of a frame that was dropped, so that it doesn't count as one without a frame."""
        if self._finder is not None:
            self.take(frame)

    def take(self, frame: Frame) -> Found:
        """Return what was recorded for the next frame."""
        if self._finder is None:
            raise ConfigError(f"pipeline '{self.name}' wasn't started")
        result, num_passed = self._finder.take(frame)
        world_T_body = None if self._poses is None else self._poses.world_T_body(frame)
        faults = (Fault("PRD003", f"{self._topic} before frame {frame.index}"),) * num_passed
        if result is None:
            why = f"no output within {self._params.tolerance_ms:g} ms"
            return Found(self.kind.empty(), world_T_body, {self._topic: why}, faults)
        boxes, missing = self._place(result, world_T_body)
        latency_ns = result.log_ns - frame.stamp_ns
        # What has the stamp itself for its time of recording wasn't recorded by a stack at work.
        is_timed = boxes is not None and result.log_ns > 0 and result.log_ns != result.stamp_ns
        if is_timed and latency_ns < 0:
            faults = (*faults, Fault("PRD004", f"{self._topic}: {-latency_ns / 1e6:.3f} ms"))
        latency = latency_ns if is_timed and latency_ns >= 0 else None
        return Found(self.kind.empty() if boxes is None else boxes, world_T_body, missing, faults, latency)

    def _first_kind(self, log: BoxReader, log_info: LogInfo) -> type[Boxes]:
        """Kind of the first boxes that there are; of results without any box the kind of the first one."""
        empty: type[Boxes] | None = None
        for result in log.detections(self._params.topic):
            if result.in_world and not log.poses:
                raise LogError(
                    f"log '{log_info.name}': the boxes of '{self._topic}' are in coordinates of the world, and the log "
                    "has no poses to move them to the body; name a topic with poses (`pose` in [body] of fbench.toml)",
                    "CFG001",
                )
            for boxes in (result.boxes3d, result.boxes2d):
                if boxes is not None and len(boxes):
                    return type(boxes)
                empty = type(boxes) if empty is None and boxes is not None else empty
        if empty is None:
            raise LogError(f"log '{log_info.name}': '{self._topic}' holds no result that can be used", "CFG001")
        return empty

    def _place(self, result: Truth, world_T_body: Float64 | None) -> tuple[Boxes | None, dict[str, str]]:
        """Boxes in body coordinates or in images of the rig's cameras, and what is missing."""
        if self.kind is Boxes2D:
            if (boxes := result.boxes2d) is None:
                return None, {self._topic: "no boxes in images, as in other frames"}
            known = np.isin(boxes.camera, sorted(self._rig.cameras))
            others = sorted(set(boxes.camera[~known].tolist()))
            return boxes[known], {f"{self._topic} in {name}": "isn't among the cameras of the run" for name in others}
        if result.boxes3d is None:
            return None, {self._topic: "no boxes in 3D, as in other frames"}
        if not result.in_world:
            return result.boxes3d, {}
        if world_T_body is None:
            return None, {self._topic: "no pose that moves it from the world to the body"}
        return move_boxes(result.boxes3d, inverse(world_T_body)), {}
