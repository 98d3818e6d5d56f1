"""lidar3d: road users from the points of all LiDARs alone, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.checks import require_between
from fbench.pipelines.points.lidar import LidarParams
from fbench.pipelines.points.lidar_stage import LidarStage
from fbench.pipelines.points.merged import require, world_T_body
from fbench.pipelines.points.reported import reported
from fbench.pipelines.rhythm import Rhythm, predicted
from fbench.pipelines.stages import StageClock
from fbench.pipelines.tracking.tracker3d import Tracker3D, Tracker3DParams
from fbench.replay.data import Frame, LogInfo, Output, Rig, Source
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True)
class Lidar3DParams:
    """Parameters of `lidar3d`."""

    lidar: LidarParams = field(default_factory=LidarParams)
    """Detection."""
    min_score: float = 0.5
    """Clusters with a lower score are dropped."""
    tracking: Tracker3DParams = field(default_factory=Tracker3DParams)
    """The tracker."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one LiDAR, by its name: `--set top.min_range_m=1` goes before `lidar.min_range_m`; so does max_range_m. What
    acts on the points of all LiDARs together can't differ.
    """

    def __post_init__(self) -> None:
        require_between("min_score", self.min_score, 0.0, 1.0)
        require_between("detect_every", self.detect_every, 1)


class Lidar3D:
    """Boxes in 3D from all LiDARs, merged in body coordinates, without velocity; with labels where the model judges."""

    def __init__(self, params: Lidar3DParams = Lidar3DParams()) -> None:
        self._params = params
        self._tracker, self._rhythm = Tracker3D(params.tracking), Rhythm(params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all LiDARs of the rig."""
        require("lidar3d", ("lidar",), rig, log_info)
        self._rig = rig
        self._lidar = LidarStage(rig, log_info, self._params.lidar, SensorSettings(self._params, rig))
        self.reset("start")

    def reset(self, reason: str) -> None:
        """Forget all tracks."""
        self._tracker.reset()
        self._rhythm.reset()
        self._lidar.reset()

    def step(self, frame: Frame) -> Output:
        """Detect and track; a frame without LiDAR has no detections."""
        pose = world_T_body(self._rig, frame)
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns, pose))
        clock = StageClock()
        boxes = self._lidar.view(frame, clock).boxes
        detections = reported(boxes, self._params.min_score, Source.L, self._lidar.labelled)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns, pose)
        return Output(detections, tracks, clock.stage_ns)
