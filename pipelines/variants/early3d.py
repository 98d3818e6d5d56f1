"""early3d: LiDAR, radar and stereo become one cloud, which is clustered; cameras label its points."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fbench.pipelines.fusion.early.cloud import Choice, DepthStage, Scene, Standing, merged, require_depth, stereo_stage
from fbench.pipelines.fusion.early.fuse import EarlyParams, fuse
from fbench.pipelines.params import StageClock
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.camera.stage import CameraStage
from fbench.pipelines.sensors.lidar.lidar import LidarParams
from fbench.pipelines.sensors.parallel import SideBySide
from fbench.pipelines.sensors.radar.radar import Compensated, RadarParams, RadarStage
from fbench.pipelines.sensors.stereo.stage import NOISE, StereoParams
from fbench.pipelines.tracking.params import Tracker3DParams, steady_tracking
from fbench.pipelines.tracking.stage import Detected, Tracked3D
from fbench.pipelines.variants.params import AllSensorsParams
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Fault, Frame, Output
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True)
class Early3DParams(AllSensorsParams):
    """Parameters of `early3d`."""

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
    tracking: Tracker3DParams = field(default_factory=steady_tracking)
    """The tracker."""


class Early3D:
    """Labelled boxes in 3D around the points of LiDARs, radars and a stereo pair; one of these must be there.

    Cameras label points; what none of them sees is labelled by its shape.
    """

    def __init__(self, params: Early3DParams = Early3DParams()) -> None:
        self._params, self._sensors = params, SideBySide(CameraStage(params.camera, params.fusion.camera_share))
        self._tracked = Tracked3D(params.tracking, params.detect_every)

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
        self._sensors.start(rig, log_info, settings)
        self._tracked.start(rig)
        self._rig = rig
        self._depth = DepthStage(rig, log_info, params.lidar, settings, stereo)
        self._radar = RadarStage(rig, log_info, params.radar, settings)
        self.reset("start")

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._sensors.identity

    def reset(self, reason: str) -> None:
        """Forget all tracks, and how the ground lies."""
        self._tracked.reset()
        self._depth.reset()

    def step(self, frame: Frame) -> Output:
        """Merge the points of all sensors that delivered, label, cluster and track; a corrupt image counts as
        missing.
        """
        return self._tracked.step(frame, self._detected, self._sensors.missing)

    def _detected(self, frame: Frame, clock: StageClock) -> Detected[Boxes3D]:
        of_images, of_pairs = list[Fault](), list[Fault]()
        cameras, standing, echoes = self._sensors.view(
            frame,
            clock,
            of_images,
            lambda frame, clock: self._depth.view(frame, clock, of_pairs),
            self._radar.echoes,
        )
        with clock.stage("fuse"):
            detections = self._fused(cameras, standing, echoes)
        faults = tuple(dict.fromkeys((*of_images, *of_pairs)))  # both may meet one corrupt image
        return Detected(detections, faults, dict.fromkeys(standing.noisy, NOISE))

    def _fused(
        self, cameras: Mapping[str, CameraDetections], standing: Standing, echoes: Compensated | None
    ) -> Boxes3D:
        fusion, speed = self._params.fusion, self._params.radar.min_speed_mps
        cloud = merged(standing.lidar, standing.stereo, echoes, standing.plane, speed, fusion.echoes)
        scene = Scene(
            self._rig, cameras, cloud, standing.plane, standing.lidar.tall, self._depth.eye_m, self._depth.judged
        )
        return fuse(scene, fusion)
