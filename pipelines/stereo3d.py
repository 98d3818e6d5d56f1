"""stereo3d: vehicles from the depth of two cameras side by side, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.checks import require_between
from fbench.pipelines.points.merged import world_T_body
from fbench.pipelines.points.reported import reported
from fbench.pipelines.rhythm import Rhythm, predicted
from fbench.pipelines.stages import StageClock
from fbench.pipelines.stereo.objects import ObjectParams, detect
from fbench.pipelines.stereo.params import StereoParams
from fbench.pipelines.stereo.stage import NOISE, StereoStage
from fbench.pipelines.tracking.tracker3d import Tracker3D, Tracker3DParams
from fbench.replay.data import Fault, Frame, LogInfo, Output, Rig, Source


@dataclass(frozen=True)
class Stereo3DParams:
    """Parameters of `stereo3d`."""

    stereo: StereoParams = field(default_factory=StereoParams)
    """Which cameras, and how they give depth."""
    objects: ObjectParams = field(default_factory=ObjectParams)
    """What becomes of the points."""
    min_score: float = 0.5
    """Clusters that look less like a vehicle than this are dropped."""
    tracking: Tracker3DParams = field(default_factory=Tracker3DParams)
    """The tracker."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""

    def __post_init__(self) -> None:
        require_between("min_score", self.min_score, 0.0, 1.0)
        require_between("detect_every", self.detect_every, 1)


class Stereo3D:
    """Boxes in 3D from one stereo pair. They have no class and no velocity.

    A frame whose depth is noise has no detections, and both cameras count as missing from it.
    """

    def __init__(self, params: Stereo3DParams = Stereo3DParams()) -> None:
        self._params = params
        self._tracker, self._rhythm = Tracker3D(params.tracking), Rhythm(params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take the pair that is named, or the one with the longest baseline."""
        self._rig = rig
        self._stereo = StereoStage(rig, log_info.name, self._params.stereo)
        self.reset("start")

    def reset(self, reason: str) -> None:
        """Forget all tracks."""
        self._tracker.reset()
        self._rhythm.reset()

    def step(self, frame: Frame) -> Output:
        """Detect and track; a frame without both images has no detections."""
        pose = world_T_body(self._rig, frame)
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns, pose))
        clock, faults = StageClock(), list[Fault]()
        view = self._stereo.view(frame, clock, faults)
        with clock.stage("detect.stereo"):
            found = detect(view.xyz, self._stereo.eye_m, self._stereo.focal_baseline, self._params.objects)
            detections = reported(found.boxes, self._params.min_score, Source.S)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns, pose)
        pair = self._stereo.pair
        missing = dict.fromkeys((pair.left, pair.right), NOISE) if view.is_off else {}
        return Output(detections, tracks, clock.stage_ns, tuple(faults), missing)
