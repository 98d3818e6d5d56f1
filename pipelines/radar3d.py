"""radar3d: moving vehicles from the echoes of all radars alone, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.checks import require_between
from fbench.pipelines.points.merged import require, world_T_body
from fbench.pipelines.points.radar import RadarParams
from fbench.pipelines.points.radar_stage import RadarStage
from fbench.pipelines.points.reported import reported
from fbench.pipelines.rhythm import Rhythm, predicted
from fbench.pipelines.stages import StageClock
from fbench.pipelines.tracking.tracker3d import Tracker3D, Tracker3DParams
from fbench.replay.data import Frame, LogInfo, Output, Rig, Source
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True)
class Radar3DParams:
    """Parameters of `radar3d`."""

    radar: RadarParams = field(default_factory=RadarParams)
    """Detection."""
    min_score: float = 0.65
    """Clusters with a lower score are dropped."""
    tracking: Tracker3DParams = field(default_factory=Tracker3DParams)
    """The tracker."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one radar, by its name: `--set rear.max_range_m=40` goes before `radar.max_range_m`; so do min_magnitude_db
    and doppler. What acts on the echoes of all radars together can't differ.
    """

    def __post_init__(self) -> None:
        require_between("min_score", self.min_score, 0.0, 1.0)
        require_between("detect_every", self.detect_every, 1)


class Radar3D:
    """Boxes in 3D from all radars, with the velocity along the line of sight. They have no class."""

    def __init__(self, params: Radar3DParams = Radar3DParams()) -> None:
        self._params = params
        self._tracker, self._rhythm = Tracker3D(params.tracking), Rhythm(params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all radars of the rig."""
        require("radar3d", ("radar",), rig, log_info)
        self._rig = rig
        self._radar = RadarStage(rig, log_info, self._params.radar, SensorSettings(self._params, rig))
        self.reset("start")

    def reset(self, reason: str) -> None:
        """Forget all tracks."""
        self._tracker.reset()
        self._rhythm.reset()

    def step(self, frame: Frame) -> Output:
        """Detect and track; a frame without radar has no detections."""
        pose = world_T_body(self._rig, frame)
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns, pose))
        clock = StageClock()
        detections = reported(self._radar.view(frame, clock).boxes, self._params.min_score, Source.R)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns, pose)
        return Output(detections, tracks, clock.stage_ns)
