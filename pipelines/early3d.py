"""early3d: LiDAR, radar and stereo become one cloud, which is clustered; cameras label its points."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fbench.pipelines.branches import Branches
from fbench.pipelines.camera.cameras_stage import CameraStage
from fbench.pipelines.camera.detector import CameraParams
from fbench.pipelines.checks import require_between
from fbench.pipelines.early.cloud import merged
from fbench.pipelines.early.depth import Choice, DepthStage, require_depth, stereo_stage
from fbench.pipelines.early.fuse import EarlyParams, fuse
from fbench.pipelines.early.scene import Scene
from fbench.pipelines.points.lidar import LidarParams
from fbench.pipelines.points.merged import world_T_body
from fbench.pipelines.points.radar import RadarParams
from fbench.pipelines.points.radar_stage import RadarStage
from fbench.pipelines.rhythm import Rhythm, predicted
from fbench.pipelines.stages import StageClock
from fbench.pipelines.stereo.params import StereoParams
from fbench.pipelines.stereo.stage import NOISE
from fbench.pipelines.tracking.tracker3d import Tracker3D, Tracker3DParams
from fbench.pipelines.weights.named import resolve_settings
from fbench.replay.data import Fault, Frame, LogInfo, Output, Rig
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True)
class Early3DParams:
    """Parameters of `early3d`."""

    camera: CameraParams = field(default_factory=CameraParams)
    """Detection by camera; without weights those of fbench work on simulated logs; on others it counts as
    missing.
    """
    lidar: LidarParams = field(default_factory=LidarParams)
    """How the ground is found, what partly seen cars are completed to, and how shapes are judged: in all logs by the
    model where `judge` doesn't say otherwise. Points are grouped as `fusion.density` says, not `lidar.cluster`."""
    radar: RadarParams = field(default_factory=RadarParams)
    """How echoes are prepared and which of them move; they are grouped as `fusion.density` says."""
    stereo_pair: Choice = "auto"
    """Whether depth by a stereo pair joins the cloud: `on`, `off`, or `auto`, where the rig has a pair and no LiDAR."""
    stereo: StereoParams = field(default_factory=StereoParams)
    """Depth by stereo."""
    fusion: EarlyParams = field(default_factory=EarlyParams)
    """How one cloud becomes objects."""
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


class Early3D:
    """Labelled boxes in 3D around the points of LiDARs, radars and a stereo pair; one of these must be there.

    Cameras label points; what none of them sees is labelled by its shape.
    """

    def __init__(self, params: Early3DParams = Early3DParams()) -> None:
        self._params, self._branches = params, Branches()
        self._cameras = CameraStage(params.camera)
        self._tracker, self._rhythm = Tracker3D(params.tracking), Rhythm(params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig.

        Raises:
            ConfigError: where a camera that is named isn't there.
            LogError: where it has no LiDAR, radar or pair of cameras, or a camera that is to be used can't be projected
                into.
        """
        params, settings = self._params, SensorSettings(self._params, rig)
        stereo = stereo_stage(rig, log_info.name, params.stereo_pair, params.stereo)
        require_depth(rig, log_info.name, stereo)
        self._cameras.start(rig, log_info, settings)
        self._cameras.require_projections()
        self._rig = rig
        self._depth = DepthStage(rig, log_info, params.lidar, settings, stereo)
        self._radar = RadarStage(rig, log_info, params.radar, settings)
        self.reset("start")

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._cameras.identity

    def reset(self, reason: str) -> None:
        """Forget all tracks, and how the ground lies."""
        self._tracker.reset()
        self._rhythm.reset()
        self._depth.reset()

    def step(self, frame: Frame) -> Output:
        """Merge the points of all sensors that delivered, label, cluster and track; a corrupt image counts as
        missing.
        """
        pose = world_T_body(self._rig, frame)
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns, pose), self._cameras.missing)
        clock, of_images, of_pairs = StageClock(), list[Fault](), list[Fault]()
        cameras, standing, echoes = self._branches.run(
            clock,
            lambda clock: self._cameras.view(frame, clock, of_images),
            lambda clock: self._depth.view(frame, clock, of_pairs),
            lambda clock: self._radar.echoes(frame, clock),
        )
        fusion = self._params.fusion
        with clock.stage("fuse"):
            speed = self._params.radar.min_speed_mps
            cloud = merged(standing.lidar, standing.stereo, echoes, standing.plane, speed, fusion.echoes)
            scene = Scene(
                self._rig, cameras, cloud, standing.plane, standing.lidar.tall, self._depth.eye_m, self._depth.judged
            )
            detections = fuse(scene, fusion)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns, pose)
        faults = tuple(dict.fromkeys((*of_images, *of_pairs)))  # both may meet one corrupt image
        missing = {**self._cameras.missing, **dict.fromkeys(standing.noisy, NOISE)}
        return Output(detections, tracks, clock.stage_ns, faults, missing)
