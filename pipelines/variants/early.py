"""early2d and early3d: points of all sensors become one cloud before anything is detected."""

from abc import abstractmethod
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Literal

from fbench.pipelines.fusion.early.cloud import DepthStage, DepthView, Scene, find_dense_ground, merge_clouds
from fbench.pipelines.fusion.early.fuse import EarlyParams, fuse
from fbench.pipelines.fusion.early.image import EarlyImageFusion, EarlyImageParams
from fbench.pipelines.fusion.early.rgbd import RgbdParams, RgbdStage
from fbench.pipelines.models.weights import AUTO
from fbench.pipelines.sensors.image.params import resolve_min_echoes
from fbench.pipelines.sensors.image.stage import Rays, projectable
from fbench.pipelines.sensors.lidar.clusters import LidarParams
from fbench.pipelines.sensors.radar.stage import RadarParams, RadarStage
from fbench.pipelines.sensors.stereo.stage import NOISE, StereoParams
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams, steady_tracking
from fbench.pipelines.tracking.stage import Detected, Memory
from fbench.pipelines.tracking.trackers import B, Tracker, Tracker2D, Tracker3D
from fbench.pipelines.variants.all_sensors import AllSensorsParams, FusionPipeline, StereoPair, take_pair
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True)
class OneCloudParams(AllSensorsParams):
    """What `early2d` and `early3d` have in common."""

    lidar: LidarParams = field(default_factory=LidarParams)
    """How the ground is found, what partly seen cars are completed to, and how shapes are classified: in all logs by
    the model where `judge` doesn't say otherwise; without a LiDAR by rules. Points are grouped as `fusion.density`
    says, not `lidar.cluster`."""
    radar: RadarParams = field(default_factory=RadarParams)
    """How echoes are prepared and which of them move; they are grouped as `fusion.density` says."""
    detector: Literal["rgb", "rgbd"] = "rgb"
    """What cameras look at: `rgb`, their images, or `rgbd`, with points of LiDARs and radars as two more channels. Then
    `rgbd` counts instead of `camera`, and those of single cameras are those of `rgbd`.
    """
    rgbd: RgbdParams = field(default_factory=RgbdParams)  # The network of `detector=rgbd`.
    stereo_pair: StereoPair = "auto"
    """Whether depth by a stereo pair joins the cloud: `on`, `off`, or `auto`, where the rig has a pair and no LiDAR."""
    stereo: StereoParams = field(default_factory=StereoParams)  # Depth by stereo.


class OneCloud(FusionPipeline[B]):
    """Points of LiDARs, radars and a stereo pair in one cloud; one of these must be there. Cameras label points."""

    name: ClassVar[str]

    def __init__(self, params: OneCloudParams, fusion: EarlyParams, tracker: Tracker[B, Any]) -> None:
        super().__init__(params, fusion.camera_share, tracker)
        self._one_cloud, self._echoes = params, fusion.echoes
        self._network = RgbdStage(params.rgbd, fusion.camera_share) if params.detector == "rgbd" else None
        if self._network is not None:
            if params.camera.weights != AUTO:
                raise ConfigError("camera.weights: detector=rgbd has a network of its own, set rgbd.weights")
            self._cameras = self._network.cameras
        self._learning: tuple[Memory, ...] = ()  # Of what is made of the cloud
        self._pair: tuple[str, ...] = ()  # Cameras that give depth

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig. Raises ConfigError where a camera that is named isn't there, or `detector=rgbd`
        has no weights for this log. Raises LogError where it has no LiDAR, radar or pair of cameras, or a camera that
        is to be used can't be projected into.
        """
        params, settings = self._one_cloud, SensorSettings(self._one_cloud, rig)
        stereo = take_pair(self.name, params.stereo_pair, params.stereo, rig, log_info)
        self._start_cameras(rig, log_info, settings)
        self._depth = DepthStage(rig, log_info, params.lidar, settings, stereo)
        self._radar, self._pair = RadarStage(rig, log_info, params.radar, settings), self._depth.pair
        self._min_echoes = resolve_min_echoes(None, log_info)
        learning = self._learning
        if self._network is not None:
            self._network.start(self.name, rig, log_info)
            learning = (*learning, self._network)
        self._remember(self._depth, *learning)
        super().start(rig, log_info)

    def required_sensors(self) -> tuple[str, ...]:
        """Those that it uses, and the cameras of a stereo pair, also without weights."""
        return tuple(sorted({*super().required_sensors(), *self._pair}))

    def _detect(self, frame: Frame, clock: StageClock) -> Any:
        of_images, of_pairs = list[Fault](), list[Fault]()
        look = partial((self._network or self._cameras).view, faults=of_images)
        find_depth = partial(self._depth.view, faults=of_pairs)
        images, depth, echoes = self._run(frame, clock, look, find_depth, self._radar.echoes)
        if self._network is not None:
            images = self._network.detect(images, depth, echoes, clock)
        views = self._note(clock, images, depth, echoes)
        return views, tuple(dict.fromkeys((*of_images, *of_pairs)))  # both may meet one corrupt image

    def _combine(self, seen: tuple[tuple[Any, ...], tuple[Fault, ...]], clock: StageClock) -> Detected[B]:
        (cameras, depth, echoes), faults = seen
        if self._network is not None:
            cameras = self._network.conclude(cameras, clock)
        with clock.stage("fuse"):
            stage, depth = self._depth, self._depth.remember(depth)
            plane, tall_echoes = find_dense_ground(echoes, depth.plane, self._min_echoes)
            depth = replace(depth, plane=plane)
            cloud = merge_clouds(depth, echoes, self._one_cloud.radar.min_speed_mps, self._echoes)
            scene = Scene(self._rig, cameras, cloud, plane, depth.lidar.tall, stage.eye_m, stage.shapes, tall_echoes)
            boxes = self._fuse(scene, depth)
        return Detected(boxes, faults, dict.fromkeys(depth.noisy, NOISE))

    @abstractmethod
    def _fuse(self, scene: Scene, depth: DepthView) -> B:
        """Find the objects of one frame."""


@dataclass(frozen=True)
class Early2DParams(OneCloudParams):
    """Parameters of `early2d`."""

    fusion: EarlyImageParams = field(default_factory=EarlyImageParams)  # How one cloud becomes objects in images.
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)  # The tracker, one per camera.


class Early2D(OneCloud[Boxes2D]):
    """Labeled boxes in the images of all cameras, with distance and range rate, around the objects of one cloud of all
    sensors, and around what only cameras see. What no camera sees is labeled by shape.
    """

    name = "early2d"

    def __init__(self, params: Early2DParams = Early2DParams()) -> None:
        super().__init__(params, params.fusion, Tracker2D(params.tracking))
        self._params = params

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig. Raises LogError where no camera can be projected into; see `OneCloud.start`."""
        fusion = self._params.fusion
        usual: Literal["points", "boxes"] = "points" if SIMULATED in log_info.metadata else "boxes"
        fusion = replace(fusion, outline=fusion.outline or usual)
        self._fusion = EarlyImageFusion(projectable(self.name, rig, log_info), fusion)
        self._learning = (self._fusion,)
        super().start(rig, log_info)

    def _fuse(self, scene: Scene, depth: DepthView) -> Boxes2D:
        rays = {name: Rays.of(self._rig, name, depth.measured) for name in scene.cameras}
        return self._fusion.fuse(scene, rays)


@dataclass(frozen=True)
class Early3DParams(OneCloudParams):
    """Parameters of `early3d`."""

    fusion: EarlyParams = field(default_factory=EarlyParams)  # How one cloud becomes objects.
    tracking: Tracker3DParams = field(default_factory=steady_tracking)  # The tracker.


class Early3D(OneCloud[Boxes3D]):
    """Labeled boxes in 3D around the points of LiDARs, radars and a stereo pair; one of these must be there. All points
    become one cloud, which is clustered. Cameras label points; what none of them sees is labeled by shape.
    """

    name = "early3d"

    def __init__(self, params: Early3DParams = Early3DParams()) -> None:
        super().__init__(params, params.fusion, Tracker3D(params.tracking))
        self._params = params

    def _fuse(self, scene: Scene, depth: DepthView) -> Boxes3D:
        return fuse(scene, self._params.fusion)
