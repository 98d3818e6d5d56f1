"""late3d: cameras, LiDARs and radars detect on their own; their boxes are merged in 3D and tracked."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fbench.pipelines.branches import Branches
from fbench.pipelines.camera.cameras_stage import CameraStage
from fbench.pipelines.camera.detector import CameraParams
from fbench.pipelines.checks import require_between
from fbench.pipelines.fusion.late import LateFusion, Seen
from fbench.pipelines.fusion.params import FusionParams
from fbench.pipelines.points.lidar import LidarParams
from fbench.pipelines.points.lidar_stage import LidarStage
from fbench.pipelines.points.merged import require, world_T_body
from fbench.pipelines.points.radar import RadarParams
from fbench.pipelines.points.radar_stage import RadarStage
from fbench.pipelines.rhythm import Rhythm, predicted
from fbench.pipelines.stages import StageClock
from fbench.pipelines.tracking.tracker3d import Tracker3D, Tracker3DParams
from fbench.pipelines.weights.named import resolve_settings
from fbench.replay.data import Fault, Frame, LogInfo, Output, Rig
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True)
class Late3DParams:
    """Parameters of `late3d`."""

    camera: CameraParams = field(default_factory=CameraParams)
    """Detection by camera; without weights those of fbench work on simulated logs; on others it counts as
    missing.
    """
    lidar: LidarParams = field(default_factory=LidarParams)
    """Detection by LiDAR."""
    radar: RadarParams = field(default_factory=RadarParams)
    """Detection by radar."""
    fusion: FusionParams = field(default_factory=FusionParams)
    """How the sensors' objects become one."""
    tracking: Tracker3DParams = field(default_factory=Tracker3DParams)
    """The tracker."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one sensor, by its name: `--set front_left.min_score=0.3` goes before `camera.min_score`. Cameras may differ
    in everything, LiDARs in min_range_m and max_range_m, radars in max_range_m, min_magnitude_db and doppler.
    """

    def __post_init__(self) -> None:
        require_between("detect_every", self.detect_every, 1)
        object.__setattr__(self, "by_sensor", resolve_settings(self.by_sensor))


class Late3D:
    """Labelled boxes in 3D from any of cameras, LiDARs and radars; at least one LiDAR or radar must be there.

    Objects without a camera's label are called cars, or trucks where they are long.
    """

    def __init__(self, params: Late3DParams = Late3DParams()) -> None:
        self._params, self._branches = params, Branches()
        self._cameras = CameraStage(params.camera)
        self._fusion, self._tracker = LateFusion(params.fusion), Tracker3D(params.tracking)
        self._rhythm = Rhythm(params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig.

        Raises:
            LogError: where it has no LiDAR or radar, or a camera that is to be used can't be projected into.
        """
        require("late3d", ("lidar", "radar"), rig, log_info)
        settings = SensorSettings(self._params, rig)
        self._cameras.start(rig, log_info, settings)
        self._cameras.require_projections()
        self._rig = rig
        self._lidar = LidarStage(rig, log_info, self._params.lidar, settings)
        self._radar = RadarStage(rig, log_info, self._params.radar, settings)
        self.reset("start")

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._cameras.identity

    def reset(self, reason: str) -> None:
        """Forget all tracks, how the ground lies, and how well the sensors work."""
        self._fusion.reset()
        self._tracker.reset()
        self._lidar.reset()
        self._rhythm.reset()

    def step(self, frame: Frame) -> Output:
        """Detect with each sensor that delivered, merge and track; a corrupt image counts as missing."""
        pose = world_T_body(self._rig, frame)
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns, pose), self._cameras.missing)
        clock, faults = StageClock(), list[Fault]()
        seen = Seen(
            self._rig,
            *self._branches.run(
                clock,
                lambda clock: self._cameras.view(frame, clock, faults),
                lambda clock: self._lidar.view(frame, clock),
                lambda clock: self._radar.view(frame, clock),
            ),
        )
        with clock.stage("fuse"):
            detections = self._fusion.step(seen)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns, pose)
        return Output(detections, tracks, clock.stage_ns, tuple(faults), self._cameras.missing)
