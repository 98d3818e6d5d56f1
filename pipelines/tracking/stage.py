"""The course of a frame: detection where it is due, then tracking; prediction in between."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Generic, TypeVar

from fbench.pipelines.params import StageClock, require_between
from fbench.pipelines.sensors.points.merged import world_T_body
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams
from fbench.pipelines.tracking.tracker2d import Tracker2D
from fbench.pipelines.tracking.tracker3d import Tracker3D
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D
from fbench.replay.data.frames import Fault, Frame, Output
from fbench.replay.data.rig import Rig

NOTHING: Mapping[str, str] = MappingProxyType({})
"""No sensor is missing."""


class Rhythm:
    """Says in which frames of a segment is detected: the first, and every so many-th after it.

    It counts frames, whatever sensors they hold, so that which ones are due is a property of the log's frames alone.

    Raises:
        ConfigError: where `every` is less than 1.
    """

    def __init__(self, every: int) -> None:
        require_between("detect_every", every, 1)
        self._every, self._num = every, 0

    def reset(self) -> None:
        """Begin a segment, whose first frame is due."""
        self._num = 0

    def due(self) -> bool:
        """Count a frame, and tell whether detection runs in it; to be asked once a frame."""
        is_due = self._num % self._every == 0
        self._num += 1
        return is_due


def predicted(
    predict: Callable[[], Boxes],
    missing: Mapping[str, str] = NOTHING,
    *,
    clock: StageClock | None = None,
    faults: tuple[Fault, ...] = (),
) -> Output:
    """Output of a frame that isn't due: the predicted tracks stand for its detections; nothing is decoded.

    Args:
        predict: Gives the tracks at the frame's instant, marked as predicted; timed as `track`.
        missing: Sensors that the pipeline can't use in any frame, with the reason.
        clock: With the stages that ran before.
        faults: Met before.
    """
    clock = clock or StageClock()
    with clock.stage("track"):
        tracks = predict()
    return Output(tracks, tracks, clock.stage_ns, faults, missing)


B = TypeVar("B", Boxes2D, Boxes3D)


@dataclass(frozen=True, eq=False)
class Detected(Generic[B]):
    """What was detected in one frame."""

    boxes: B
    faults: tuple[Fault, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)
    """Sensors that couldn't be used in this frame, with the reason."""


Detect = Callable[[Frame, StageClock], Detected[B]]
"""Detects in a frame, and times its stages."""


class Tracked2D:
    """Boxes in images: detected, tracked by camera, and predicted in frames in which nothing is looked for.

    Args:
        params: Of the tracker.
        detect_every: See `Rhythm`.
    """

    def __init__(self, params: Tracker2DParams, detect_every: int) -> None:
        self._tracker, self._rhythm = Tracker2D(params), Rhythm(detect_every)

    def reset(self) -> None:
        """Forget all tracks; the next frame begins a segment."""
        self._tracker.reset()
        self._rhythm.reset()

    def step(self, frame: Frame, detect: Detect[Boxes2D], missing: Mapping[str, str] = NOTHING) -> Output:
        """Return detections and tracks of a frame; `missing` are sensors that can't be used in any frame."""
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns), missing)
        return _followed(frame, detect, lambda boxes: self._tracker.step(boxes, frame.stamp_ns), missing)


class Tracked3D:
    """Boxes in space, in the same way; tracked in world coordinates where the log has poses.

    Args:
        params: Of the tracker.
        detect_every: See `Rhythm`.
    """

    def __init__(self, params: Tracker3DParams, detect_every: int) -> None:
        self._tracker, self._rhythm = Tracker3D(params), Rhythm(detect_every)

    def start(self, rig: Rig) -> None:
        """Take the rig whose poses count."""
        self._rig = rig

    def reset(self) -> None:
        """Forget all tracks; the next frame begins a segment."""
        self._tracker.reset()
        self._rhythm.reset()

    def step(self, frame: Frame, detect: Detect[Boxes3D], missing: Mapping[str, str] = NOTHING) -> Output:
        """Return detections and tracks of a frame; `missing` are sensors that can't be used in any frame."""
        pose = world_T_body(self._rig, frame)
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns, pose), missing)
        return _followed(frame, detect, lambda boxes: self._tracker.step(boxes, frame.stamp_ns, pose), missing)


def _followed(frame: Frame, detect: Detect[B], track: Callable[[B], B], missing: Mapping[str, str]) -> Output:
    clock = StageClock()
    found = detect(frame, clock)
    with clock.stage("track"):
        tracks = track(found.boxes)
    return Output(found.boxes, tracks, clock.stage_ns, found.faults, {**missing, **found.missing})
