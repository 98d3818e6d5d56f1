"""early2d, late2d, early3d and late3d: all sensors, one way of fusion each, and a tracker."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from fbench.pipelines.fusion.early.cloud import Choice, DepthStage, Scene, Standing, merged, require_depth, stereo_stage
from fbench.pipelines.fusion.early.fuse import EarlyParams, fuse
from fbench.pipelines.fusion.image import ImageFusion
from fbench.pipelines.fusion.late.fuse import LateFusion, Seen
from fbench.pipelines.fusion.late.params import FusionParams
from fbench.pipelines.fusion.reliability import ImageFusionParams
from fbench.pipelines.params import StageClock
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.camera.stage import CameraStage
from fbench.pipelines.sensors.image.params import LidarImageParams, RadarImageParams, far_radar, whole_vehicles
from fbench.pipelines.sensors.image.stage import InImages, LidarInImages, RadarInImages, projectable
from fbench.pipelines.sensors.lidar.lidar import LidarParams
from fbench.pipelines.sensors.lidar.stage import LidarStage
from fbench.pipelines.sensors.parallel import SideBySide
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.sensors.radar.radar import Compensated, RadarParams, RadarStage
from fbench.pipelines.sensors.stereo.stage import NOISE, StereoParams
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams, steady_tracking
from fbench.pipelines.tracking.stage import Detected, Tracked2D, Tracked3D
from fbench.pipelines.variants.params import AllSensorsParams
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Fault, Frame, Output
from fbench.replay.data.rig import LogInfo, Rig

SeeInImages = Callable[[Frame, StageClock], InImages]
"""What sensors of one kind see in the images of one frame."""


@dataclass(frozen=True)
class FusedImagesParams(AllSensorsParams):
    """What `early2d` and `late2d` have in common."""

    lidar: LidarParams = field(default_factory=whole_vehicles)
    """Points and ground; of `lidar.cluster` only max_height_m counts here."""
    radar: RadarParams = field(default_factory=far_radar)
    """Echoes and their velocities; clusters in space count only for sparse radars, see `radar_image.min_echoes`."""
    lidar_image: LidarImageParams = field(default_factory=LidarImageParams)
    """Detection by LiDAR in images."""
    radar_image: RadarImageParams = field(default_factory=RadarImageParams)
    """Detection by radar in images."""
    fusion: ImageFusionParams = field(default_factory=ImageFusionParams)
    """How the sensors' boxes become one."""
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)
    """The tracker, one per camera."""


class FusedImages:
    """Merges in each image what its camera sees and what LiDARs and radars see there; how these see is left open."""

    def __init__(self, cameras: CameraStage, fusion: ImageFusionParams, tracked: Tracked2D) -> None:
        self._sensors, self._params, self._tracked = SideBySide(cameras), fusion, tracked

    @property
    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._sensors.identity

    def start(self, pipeline: str, rig: Rig, log_info: LogInfo, settings: SensorSettings) -> tuple[str, ...]:
        """Take all cameras of the rig, and return the names of those that can be projected into.

        Raises:
            LogError: where there is none, or one that has weights isn't among them.
        """
        cameras = projectable(pipeline, rig, log_info)
        self._sensors.start(rig, log_info, settings)
        self._fusion = ImageFusion(rig, cameras, self._params)
        return cameras

    def reset(self) -> None:
        """Forget all tracks, and how well the cameras see."""
        self._tracked.reset()
        self._fusion.reset()

    def step(self, frame: Frame, lidar: SeeInImages, radar: SeeInImages) -> Output:
        """Detect with each sensor that delivered, merge and track; a corrupt image counts as missing."""

        def merged(frame: Frame, clock: StageClock) -> Detected[Boxes2D]:
            faults = list[Fault]()
            seen = self._sensors.view(frame, clock, faults, lidar, radar)
            with clock.stage("fuse"):
                return Detected(self._fusion.merge(*seen), tuple(faults))

        return self._tracked.step(frame, merged, self._sensors.missing)


@dataclass(frozen=True)
class Early2DParams(FusedImagesParams):
    """Parameters of `early2d`."""


class Early2D:
    """Labelled boxes in the images of all cameras, with distance and range rate; at least one LiDAR or radar must be
    there.

    Objects without a camera's label are called cars, or trucks where they are long.
    """

    def __init__(self, params: Early2DParams = Early2DParams()) -> None:
        self._params, tracked = params, Tracked2D(params.tracking, params.detect_every)
        self._fused = FusedImages(CameraStage(params.camera, params.fusion.camera_share), params.fusion, tracked)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig.

        Raises:
            LogError: where it has no LiDAR or radar, or no camera that can be projected into, or one that is to be used
                can't.
        """
        require("early2d", ("lidar", "radar"), rig, log_info)
        params, settings = self._params, SensorSettings(self._params, rig)
        cameras = self._fused.start("early2d", rig, log_info, settings)
        self._points = LidarStage(rig, log_info, params.lidar, settings)
        self._lidar = LidarInImages(rig, cameras, self._points, params.lidar_image)
        echoes = RadarStage(rig, log_info, params.radar, settings)
        self._radar = RadarInImages(rig, cameras, echoes, params.radar, params.radar_image)
        self.reset("start")

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._fused.identity

    def reset(self, reason: str) -> None:
        """Forget all tracks, how the ground lies, and how well the cameras see."""
        self._fused.reset()
        self._points.reset()

    def step(self, frame: Frame) -> Output:
        """Detect with each sensor that delivered, merge and track; a corrupt image counts as missing."""
        return self._fused.step(frame, self._lidar.view, self._radar.view)


@dataclass(frozen=True)
class Late2DParams(FusedImagesParams):
    """Parameters of `late2d`."""


class Late2D:
    """Labelled boxes in the images of all cameras, with distance and range rate; at least one LiDAR or radar must be
    there. Each sensor detects as in `camera2d`, `lidar2d` and `radar2d`.

    Objects without a camera's label are called cars, or trucks where they are long.
    """

    def __init__(self, params: Late2DParams = Late2DParams()) -> None:
        self._params, tracked = params, Tracked2D(params.tracking, params.detect_every)
        self._fused = FusedImages(CameraStage(params.camera, params.fusion.camera_share), params.fusion, tracked)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig.

        Raises:
            LogError: where it has no LiDAR or radar, or no camera that can be projected into, or one that is to be used
                can't.
        """
        require("late2d", ("lidar", "radar"), rig, log_info)
        params, settings = self._params, SensorSettings(self._params, rig)
        cameras = self._fused.start("late2d", rig, log_info, settings)
        self._points = LidarStage(rig, log_info, params.lidar, settings)
        self._lidar = LidarInImages(rig, cameras, self._points, params.lidar_image)
        echoes = RadarStage(rig, log_info, params.radar, settings)
        self._radar = RadarInImages(rig, cameras, echoes, params.radar, params.radar_image)
        self.reset("start")

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._fused.identity

    def reset(self, reason: str) -> None:
        """Forget all tracks, how the ground lies, and how well the cameras see."""
        self._fused.reset()
        self._points.reset()

    def step(self, frame: Frame) -> Output:
        """Detect with each sensor that delivered, merge and track; a corrupt image counts as missing."""
        return self._fused.step(frame, self._boxes_of_lidar, self._boxes_of_radar)

    def _boxes_of_lidar(self, frame: Frame, clock: StageClock) -> InImages:
        return replace(self._lidar.view(frame, clock), points={})

    def _boxes_of_radar(self, frame: Frame, clock: StageClock) -> InImages:
        return replace(self._radar.view(frame, clock), points={})


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


@dataclass(frozen=True)
class Late3DParams(AllSensorsParams):
    """Parameters of `late3d`."""

    fusion: FusionParams = field(default_factory=FusionParams)
    """How the sensors' objects become one."""
    tracking: Tracker3DParams = field(default_factory=steady_tracking)
    """The tracker."""


class Late3D:
    """Labelled boxes in 3D from any of cameras, LiDARs and radars; at least one LiDAR or radar must be there.

    Objects without a camera's label are called cars, or trucks where they are long.
    """

    def __init__(self, params: Late3DParams = Late3DParams()) -> None:
        self._params, self._fusion = params, LateFusion(params.fusion)
        self._sensors = SideBySide(CameraStage(params.camera, params.fusion.camera_share))
        self._tracked = Tracked3D(params.tracking, params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig.

        Raises:
            LogError: where it has no LiDAR or radar, or a camera that is to be used can't be projected into.
        """
        require("late3d", ("lidar", "radar"), rig, log_info)
        settings = SensorSettings(self._params, rig)
        self._sensors.start(rig, log_info, settings)
        self._tracked.start(rig)
        self._rig = rig
        self._lidar = LidarStage(rig, log_info, self._params.lidar, settings)
        self._radar = RadarStage(rig, log_info, self._params.radar, settings)
        self.reset("start")

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._sensors.identity

    def reset(self, reason: str) -> None:
        """Forget all tracks, how the ground lies, and how well the sensors work."""
        self._tracked.reset()
        self._fusion.reset()
        self._lidar.reset()

    def step(self, frame: Frame) -> Output:
        """Detect with each sensor that delivered, merge and track; a corrupt image counts as missing."""
        return self._tracked.step(frame, self._detected, self._sensors.missing)

    def _detected(self, frame: Frame, clock: StageClock) -> Detected[Boxes3D]:
        faults = list[Fault]()
        seen = Seen(self._rig, *self._sensors.view(frame, clock, faults, self._lidar.view, self._radar.view))
        with clock.stage("fuse"):
            return Detected(self._fusion.step(seen), tuple(faults))
