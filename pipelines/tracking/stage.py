"""The course of a frame: detection where it is due, then tracking; prediction in between."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Generic, Protocol, runtime_checkable

from fbench.pipelines.sensors.points.merged import world_T_body
from fbench.pipelines.tracking.trackers import B, Tracker, Tracker3D
from fbench.replay.contracts.params import StageClock, require_between
from fbench.replay.data.boxes import Boxes
from fbench.replay.data.frames import Fault, Frame, Output
from fbench.replay.data.rig import Kind, LogInfo, Rig

NOTHING: Mapping[str, str] = MappingProxyType({})  # No sensor is missing


class DetectionInterval:
    """Says in which frames of a segment is detected: the first, and every so many-th after it.

    It counts frames, whatever sensors they hold, so that which ones are due is a property of the log's frames alone.
    Raises ConfigError where `every` is less than 1.
    """

    def __init__(self, every: int) -> None:
        require_between("detect_every", every, 1)
        self._every, self._num = every, 0

    def reset(self) -> None:
        """Begin a segment, whose first frame is due."""
        self._num = 0

    def is_due(self) -> bool:
        """Count a frame, and say whether detection runs in it; to be asked once a frame."""
        self._num += 1
        return (self._num - 1) % self._every == 0


def predict_output(
    predict: Callable[[], Boxes],
    missing: Mapping[str, str] = NOTHING,
    *,
    clock: StageClock | None = None,
    faults: tuple[Fault, ...] = (),
) -> Output:
    """Output of a frame that isn't due: the predicted tracks stand for its detections; nothing is decoded.

    `predict` gives the tracks at the frame's instant, marked as predicted, and is timed as `track`, after the stages of
    `clock`. Sensors are `missing` that the pipeline can't use in any frame, with the reason.
    """
    clock = clock or StageClock()
    with clock.stage("track"):
        tracks = predict()
    return Output(tracks, tracks, clock.stage_ns, faults, missing, cpu_ns=clock.cpu_ns)


class Memory(Protocol):
    """What remembers something of earlier frames."""

    def reset(self) -> None:
        """Forget it."""


@runtime_checkable
class NotesPoses(Protocol):
    """What needs the poses of all frames in which is detected, also where another process does that."""

    def note_pose(self, frame: Frame) -> None:
        """Take the pose of a frame."""


@dataclass(frozen=True, eq=False)
class Detected(Generic[B]):
    """Detections of one frame."""

    boxes: B
    faults: tuple[Fault, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)
    """Sensors that couldn't be used in this frame, with the reason."""


class TrackingPipeline(ABC, Generic[B]):
    """Detects in the frames that are due (see `DetectionInterval`), predicts tracks in others; subclasses know how to
    detect. Trackers in space track in world coordinates where the log has poses.
    """

    is_tracker = True
    kinds: tuple[Kind, ...] = ()  # Of the sensors that it uses
    missing: Mapping[str, str] = NOTHING  # Sensors that can't be used in any frame, with the reason
    weights: Mapping[str, object] = NOTHING  # See `identity`

    def __init__(self, tracker: Tracker[B, Any], detect_every: int) -> None:
        self._tracker, self._interval = tracker, DetectionInterval(detect_every)
        self._remember()

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take the sensors of the rig. Raises ConfigError where what the parameters ask for isn't there. Raises
        LogError where the rig lacks sensors that the pipeline needs, or a camera that can be projected into.
        """
        self._rig = rig
        self.reset("start")

    def required_sensors(self) -> tuple[str, ...]:
        """All sensors of the kinds that it uses, but cameras that have no weights."""
        return tuple(name for name in self._rig.sensors(*self.kinds) if name not in self.missing)

    def used_sensors(self) -> tuple[str, ...]:
        """The same: no other is looked at."""
        return self.required_sensors()

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self.weights

    def warnings(self) -> Sequence[Fault]:
        """Say what casts doubt on all results since the start; nothing by default."""
        return ()

    def _remember(self, *parts: Memory) -> None:
        """Name the sensors and fusion that remember something of earlier frames of a segment."""
        self._memories: tuple[Memory, ...] = (self._tracker, self._interval, *parts)

    def reset(self, reason: str) -> None:
        """Begin a segment: end all tracks, and forget what sensors and fusion remember of earlier frames."""
        for part in self._memories:
            part.reset()

    def step(self, frame: Frame) -> Output:
        """Detect and track; what a missing sensor would have given isn't there, as with a corrupt image."""
        return self.conclude(frame, self.observe(frame))

    def observe(self, frame: Frame) -> tuple[Any, StageClock] | None:
        """Detect in one frame, as far as no earlier frame matters but for its poses; `None` where it isn't due."""
        if not self._interval.is_due():
            return None
        clock = StageClock()
        return self._detect(frame, clock), clock

    def pass_by(self, frame: Frame) -> None:
        """Count a frame that another process observes, and note its pose."""
        if self._interval.is_due():
            for part in self._memories:
                if isinstance(part, NotesPoses):
                    part.note_pose(frame)

    def conclude(self, frame: Frame, observed: tuple[Any, StageClock] | None) -> Output:
        """Do what depends on earlier frames: fuse, where that learns from them, and track."""
        pose = world_T_body(self._rig, frame) if isinstance(self._tracker, Tracker3D) else None
        if observed is None:
            return predict_output(lambda: self._tracker.predict(frame.stamp_ns, pose), self.missing)
        seen, clock = observed
        found = self._combine(seen, clock)
        with clock.stage("track"):
            tracks = self._tracker.step(found.boxes, frame.stamp_ns, pose)
        missing = {**self.missing, **found.missing}
        return Output(
            found.boxes, tracks, clock.stage_ns, found.faults, missing, digests=clock.digests, cpu_ns=clock.cpu_ns
        )

    @abstractmethod
    def _detect(self, frame: Frame, clock: StageClock) -> Any:
        """Detect in one frame without knowing earlier ones, but for their poses. What it returns can be pickled."""

    def _combine(self, seen: Any, clock: StageClock) -> Detected[B]:
        """Make detections of what `_detect` returned, which may depend on earlier frames; by default it is them."""
        found: Detected[B] = seen
        return found
