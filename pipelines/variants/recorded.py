"""recorded and track: detections of another system from a log or a file, as they are or tracked."""

from dataclasses import dataclass, field

from fbench.pipelines.sensors.recorded import RecordedBoxes, ResultParams
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams
from fbench.pipelines.tracking.stage import DetectionInterval, predict_output
from fbench.pipelines.tracking.trackers import Tracker2D, Tracker3D
from fbench.replay.contracts.params import StageClock, in_range
from fbench.replay.data.boxes import Boxes, Boxes2D
from fbench.replay.data.frames import Frame, Output

STAGE = "recorded"  # Stands for all that the other system did


@dataclass(frozen=True)
class RecordedParams(ResultParams):
    """Parameters of `recorded`."""


class Recorded(RecordedBoxes):
    """Passes on what was recorded. Latency is the time from a frame's instant to the recording of its result."""

    name = "recorded"

    def __init__(self, params: RecordedParams = RecordedParams()) -> None:
        super().__init__(params)

    def step(self, frame: Frame) -> Output:
        """Pass on the frame's result; boxes with ids are its tracks."""
        found = self.take(frame)
        stage_ns = {} if found.latency_ns is None else {STAGE: found.latency_ns}
        return Output(found.boxes, found.boxes, stage_ns, found.faults, found.missing, clock="log")


_TRACKING = Tracker3DParams(association="giou", max_missed=3, predicted_share=0.0)


@dataclass(frozen=True)
class TrackParams(ResultParams):
    """Parameters of `track`."""

    detect_every: int = in_range(1, 1)
    """Detections count on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    tracking: Tracker3DParams = _TRACKING
    """The tracker where detections are in 3D."""
    tracking2d: Tracker2DParams = field(default_factory=Tracker2DParams)  # The tracker where they are in images.


class Track(RecordedBoxes):
    """Tracks recorded detections, in 3D where there are any, else in images. Ids that they had are left aside."""

    name = "track"
    is_tracker = True

    def __init__(self, params: TrackParams = TrackParams()) -> None:
        super().__init__(params)
        self._tracker3d = Tracker3D(params.tracking, any_order=True)
        self._tracker2d = Tracker2D(params.tracking2d, any_order=True)
        self._interval = DetectionInterval(params.detect_every)

    def reset(self, reason: str) -> None:
        """End all tracks."""
        super().reset(reason)
        self._tracker3d.reset()
        self._tracker2d.reset()
        self._interval.reset()

    def step(self, frame: Frame) -> Output:
        """Track what was detected; a frame between detections has its predicted tracks for detections."""
        clock, stamp_ns = StageClock(), frame.stamp_ns
        with clock.stage("read"):
            found = self.take(frame)
        if not self._interval.is_due():
            tracker = self._tracker2d if self.kind is Boxes2D else self._tracker3d
            return predict_output(
                lambda: tracker.predict(stamp_ns, found.world_T_body), clock=clock, faults=found.faults
            )
        boxes = found.boxes
        with clock.stage("track"):
            tracks: Boxes
            if isinstance(boxes, Boxes2D):
                tracks = self._tracker2d.step(boxes, stamp_ns)
            else:
                tracks = self._tracker3d.step(boxes, stamp_ns, found.world_T_body)
        return Output(boxes, tracks, clock.stage_ns, found.faults, found.missing, cpu_ns=clock.cpu_ns)
