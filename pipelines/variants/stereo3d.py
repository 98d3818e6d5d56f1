"""stereo3d: vehicles from the depth of two cameras side by side, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.sensors.points.merged import report_boxes
from fbench.pipelines.sensors.stereo.stage import NOISE, ObjectParams, StereoParams, StereoStage, detect
from fbench.pipelines.tracking.params import Tracker3DParams
from fbench.pipelines.tracking.stage import Detected, TrackingPipeline
from fbench.pipelines.tracking.trackers import Tracker3D
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True)
class Stereo3DParams(CheckedParams):
    """Parameters of `stereo3d`."""

    stereo: StereoParams = field(default_factory=StereoParams)  # Which cameras, and how they give depth.
    objects: ObjectParams = field(default_factory=ObjectParams)  # What becomes of the points.
    min_score: float = in_range(0.5, 0, 1)  # Clusters that look less like a vehicle than this are dropped.
    tracking: Tracker3DParams = field(default_factory=Tracker3DParams)  # The tracker.
    detect_every: int = in_range(1, 1)
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""


class Stereo3D(TrackingPipeline[Boxes3D]):
    """Boxes in 3D from one stereo pair. They have no class and no velocity. A frame whose depth is noise has no
    detections, and both cameras count as missing from it.
    """

    def __init__(self, params: Stereo3DParams = Stereo3DParams()) -> None:
        super().__init__(Tracker3D(params.tracking), params.detect_every)
        self._params = params

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take the pair that is named, or the one with the longest baseline."""
        self._stereo = StereoStage(rig, log_info.name, self._params.stereo)
        super().start(rig, log_info)

    def required_sensors(self) -> tuple[str, ...]:
        """The cameras of the pair."""
        return self._stereo.pair.left, self._stereo.pair.right

    def _detect(self, frame: Frame, clock: StageClock) -> Detected[Boxes3D]:
        faults, pair = list[Fault](), self._stereo.pair
        view = self._stereo.view(frame, clock, faults)
        with clock.stage("detect.stereo"):
            found = detect(view.xyz, self._stereo.eye_m, self._stereo.focal_baseline, self._params.objects)
            boxes = report_boxes(found.boxes, self._params.min_score, Source.S)
        return Detected(boxes, tuple(faults), dict.fromkeys((pair.left, pair.right), NOISE) if view.is_off else {})
