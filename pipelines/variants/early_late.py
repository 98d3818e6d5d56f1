"""early2d, late2d, early3d and late3d: compositions of all sensors, one kind of fusion each, and a tracker."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Literal

from fbench.pipelines.fusion.early.cloud import DepthStage, DepthView, Scene, find_dense_ground, merge_clouds
from fbench.pipelines.fusion.early.fuse import EarlyParams, fuse
from fbench.pipelines.fusion.early.image import EarlyImageFusion, EarlyImageParams
from fbench.pipelines.fusion.early.rgbd import RgbdParams, RgbdStage
from fbench.pipelines.fusion.image import ImageFusion, ImageFusionParams
from fbench.pipelines.fusion.late.existence import FusionParams, resolve_weight
from fbench.pipelines.fusion.late.fuse import LateFusion, SensorViews
from fbench.pipelines.models.weights import AUTO, resolve_settings
from fbench.pipelines.sensors.camera.detector import CameraParams, CameraStage
from fbench.pipelines.sensors.image.params import LidarImageParams, RadarImageParams, far_radar, resolve_min_echoes
from fbench.pipelines.sensors.image.stage import InImages, LidarInImages, RadarInImages, Rays, projectable
from fbench.pipelines.sensors.image.stereo import StereoInImages
from fbench.pipelines.sensors.lidar.stage import LidarParams, LidarStage
from fbench.pipelines.sensors.parallel import Branches
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.sensors.radar.stage import RadarParams, RadarStage
from fbench.pipelines.sensors.stereo.stage import NOISE, StereoParams, StereoStage
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams, steady_tracking
from fbench.pipelines.tracking.stage import Detected, Memory, TrackingPipeline
from fbench.pipelines.tracking.trackers import B, Tracker, Tracker2D, Tracker3D
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.geometry.stereo_pairs import pairs


@dataclass(frozen=True)
class AllSensorsParams(CheckedParams):
    """What pipelines of cameras, LiDARs and radars share."""

    camera: CameraParams = field(default_factory=CameraParams)
    """Detection by camera; without weights those of fbench work on simulated logs; on others it counts as
    missing.
    """
    lidar: LidarParams = field(default_factory=LidarParams)  # Detection by LiDAR.
    radar: RadarParams = field(default_factory=RadarParams)  # Detection by radar.
    detect_every: int = in_range(1, 1)
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one sensor, by its name: `--set front_left.min_score=0.3` goes before `camera.min_score`. Cameras may differ
    in everything, LiDARs in min_range_m and max_range_m, radars in max_range_m, min_magnitude_db and doppler.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "by_sensor", resolve_settings(self.by_sensor))


class FusionPipeline(TrackingPipeline[B]):
    """Cameras and two other kinds of sensors, whose branches run in parallel."""

    kinds = ("camera", "lidar", "radar")

    def __init__(self, params: AllSensorsParams, camera_share: float, tracker: Tracker[B, Any]) -> None:
        super().__init__(tracker, params.detect_every)
        self._cameras, self._branches = CameraStage(params.camera, camera_share), Branches()

    def _start_cameras(self, rig: Rig, log_info: LogInfo, settings: SensorSettings) -> None:
        """Take all cameras of the rig. Raises LogError where one that is used can't be projected into."""
        self._cameras.start(rig, log_info, settings)
        self._cameras.require_projections()
        self.missing, self.weights = self._cameras.missing, self._cameras.identity

    def _view_cameras(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> Any:
        """What cameras see by themselves."""
        return self._cameras.view(frame, clock, faults)

    def _relate(self, seen: tuple[Any, ...], clock: StageClock) -> tuple[Any, ...]:
        """Let cameras know what other sensors measured; by default that makes no difference."""
        return seen

    def _view(
        self, frame: Frame, clock: StageClock, faults: list[Fault], *others: Callable[[Frame, StageClock], Any]
    ) -> tuple[Any, ...]:
        """Return what the cameras see, by name, and what `others` give; a corrupt image is one of the `faults`."""
        views: list[Callable[..., Any]] = [partial(self._view_cameras, faults=faults), *others]
        found = self._relate(self._branches.run(clock, *(partial(view, frame) for view in views)), clock)
        for kind, view in zip(self.kinds, found, strict=True):
            clock.note(kind, view)
        return found


StereoPair = Literal["auto", "on", "off"]


def _take_pair(
    pipeline: str, wanted: StereoPair, params: StereoParams, rig: Rig, log_info: LogInfo
) -> StereoStage | None:
    """Take the stereo pair of a rig, if it is to be used: `auto`, where the rig has one that gives depth, and no LiDAR.
    Raises ConfigError where a camera that is named isn't there. Raises LogError where the pair must be there and isn't,
    or where nothing else measures depth.
    """
    is_auto = wanted == "auto" and not rig.sensors("lidar") and bool(pairs(rig))
    if wanted == "on" or is_auto:
        try:
            return StereoStage(rig, log_info.name, params)
        except LogError:
            if wanted == "on" or not rig.sensors("radar"):
                raise
    require(pipeline, ("lidar", "radar"), rig, log_info, "a LiDAR, a radar or a stereo pair of cameras")
    return None


@dataclass(frozen=True)
class Late2DParams(AllSensorsParams):
    """Parameters of `late2d`."""

    radar: RadarParams = field(default_factory=far_radar)
    """Echoes and their velocities; clusters in space count only for sparse radars, see `radar_image.min_echoes`."""
    lidar_image: LidarImageParams = field(default_factory=LidarImageParams)  # Detection by LiDAR in images.
    radar_image: RadarImageParams = field(default_factory=RadarImageParams)  # Detection by radar in images.
    stereo_pair: StereoPair = "auto"
    """Whether a stereo pair detects, too, what LiDAR measured nothing of: `on`, `off`, or `auto`, where the rig has a
    pair and no LiDAR."""
    stereo: StereoParams = field(default_factory=StereoParams)  # Depth by stereo.
    fusion: ImageFusionParams = field(default_factory=ImageFusionParams)  # How the sensors' boxes become one.
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)  # The tracker, one per camera.


class Late2D(FusionPipeline[Boxes2D]):
    """Labeled boxes in the images of all cameras, with distance and range rate; a LiDAR, a radar or a stereo pair must
    be there. Sensors detect as in `camera2d`, `lidar2d`, `radar2d` and `stereo3d`; their boxes are merged in the
    images, and tracked. Objects without a camera's label are called cars, or trucks where they are long.
    """

    def __init__(self, params: Late2DParams = Late2DParams()) -> None:
        super().__init__(params, params.fusion.camera_share, Tracker2D(params.tracking))
        self._params = params

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig. Raises ConfigError where a camera that is named isn't there. Raises LogError
        where it has no LiDAR, radar or pair of cameras, or no camera that can be projected into, or one that is to be
        used can't.
        """
        params, settings = self._params, SensorSettings(self._params, rig)
        pair = _take_pair("late2d", params.stereo_pair, params.stereo, rig, log_info)
        cameras = projectable("late2d", rig, log_info)
        self._start_cameras(rig, log_info, settings)
        self._fusion = ImageFusion(rig, cameras, params.fusion)
        self._lidar = LidarInImages(rig, log_info, cameras, params.lidar, params.lidar_image, settings)
        echoes = RadarStage(rig, log_info, params.radar, settings)
        self._radar = RadarInImages(rig, log_info, cameras, echoes, params.radar, params.radar_image)
        self._stereo = None if pair is None else StereoInImages(rig, cameras, pair)
        self._remember(self._fusion, self._lidar)
        super().start(rig, log_info)

    def required_sensors(self) -> tuple[str, ...]:
        """Those that it uses, and the cameras of a stereo pair, also without weights."""
        pair = () if self._stereo is None else self._stereo.pair
        return tuple(sorted({*super().required_sensors(), *pair}))

    def warnings(self) -> tuple[Fault, ...]:
        """Say where nearly all clusters of LiDAR were rejected."""
        return self._lidar.warnings()

    def _detect(self, frame: Frame, clock: StageClock) -> Any:
        of_images, of_pairs = list[Fault](), list[Fault]()
        views = self._view(frame, clock, of_images, partial(self._view_depth, faults=of_pairs), self._radar.view)
        return views, tuple(dict.fromkeys((*of_images, *of_pairs)))  # both may meet one corrupt image

    def _view_depth(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> tuple[InImages, InImages]:
        xyz = self._lidar.points(frame, clock)
        lidar = self._lidar.detect(xyz, clock)
        return lidar, InImages() if self._stereo is None else self._stereo.view(frame, clock, faults, xyz)

    def _combine(self, seen: tuple[tuple[Any, ...], tuple[Fault, ...]], clock: StageClock) -> Detected[Boxes2D]:
        (cameras, (lidar, stereo), radar), faults = seen
        self._lidar.remember(lidar)
        self._radar.remember(radar)
        with clock.stage("fuse"):
            boxes = self._fusion.merge(cameras, lidar, radar, stereo)
        return Detected(boxes, faults, dict.fromkeys(stereo.noisy, NOISE))


@dataclass(frozen=True)
class OneCloudParams(AllSensorsParams):
    """What `early2d` and `early3d` have in common."""

    lidar: LidarParams = field(default_factory=LidarParams)
    """How the ground is found, what partly seen cars are completed to, and how shapes are classified: in all logs by
    the model where `judge` doesn't say otherwise. Points are grouped as `fusion.density` says, not `lidar.cluster`."""
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
        stereo = _take_pair(self.name, params.stereo_pair, params.stereo, rig, log_info)
        self._start_cameras(rig, log_info, settings)
        self._depth = DepthStage(rig, log_info, params.lidar, settings, stereo)
        self._radar, self._pair = RadarStage(rig, log_info, params.radar, settings), self._depth.pair
        self._min_echoes = resolve_min_echoes(None, log_info)
        learning = self._learning
        if self._network is not None:
            self._network.start(self.name, rig)
            learning = (*learning, self._network)
        self._remember(self._depth, *learning)
        super().start(rig, log_info)

    def required_sensors(self) -> tuple[str, ...]:
        """Those that it uses, and the cameras of a stereo pair, also without weights."""
        return tuple(sorted({*super().required_sensors(), *self._pair}))

    def _detect(self, frame: Frame, clock: StageClock) -> Any:
        of_images, of_pairs = list[Fault](), list[Fault]()
        find_depth = partial(self._depth.view, faults=of_pairs)
        views = self._view(frame, clock, of_images, find_depth, self._radar.echoes)
        return views, tuple(dict.fromkeys((*of_images, *of_pairs)))  # both may meet one corrupt image

    def _view_cameras(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> Any:
        return (self._network or self._cameras).view(frame, clock, faults)

    def _relate(self, seen: tuple[Any, ...], clock: StageClock) -> tuple[Any, ...]:
        if self._network is None:
            return seen
        images, depth, echoes = seen
        return self._network.detect(images, depth, echoes, clock), depth, echoes

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


@dataclass(frozen=True)
class Late3DParams(AllSensorsParams):
    """Parameters of `late3d`."""

    fusion: FusionParams = field(default_factory=FusionParams)  # How the sensors' objects become one.
    tracking: Tracker3DParams = field(default_factory=steady_tracking)  # The tracker.


class Late3D(FusionPipeline[Boxes3D]):
    """Labeled boxes in 3D from any of cameras, LiDARs and radars; at least one LiDAR or radar must be there.

    Each sensor detects on its own; their boxes are merged in space, and tracked. Objects without a camera's label are
    called cars, or trucks where they are long.
    """

    def __init__(self, params: Late3DParams = Late3DParams()) -> None:
        super().__init__(params, params.fusion.camera_share, Tracker3D(params.tracking))
        self._params = params

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig. Raises LogError where it has no LiDAR or radar, or a camera that is to be used
        can't be projected into.
        """
        require("late3d", ("lidar", "radar"), rig, log_info)
        settings = SensorSettings(self._params, rig)
        self._start_cameras(rig, log_info, settings)
        self._lidar = LidarStage(rig, log_info, self._params.lidar, settings)
        self._radar = RadarStage(rig, log_info, self._params.radar, settings)
        self._fusion = LateFusion(resolve_weight(self._params.fusion, self._lidar.judge, bool(self._cameras.used)))
        self._remember(self._fusion, self._lidar)
        super().start(rig, log_info)

    def warnings(self) -> tuple[Fault, ...]:
        """Say where nearly all clusters of LiDAR were rejected."""
        return self._lidar.warnings()

    def _detect(self, frame: Frame, clock: StageClock) -> Any:
        faults = list[Fault]()
        return self._view(frame, clock, faults, self._lidar.view, self._radar.view), tuple(faults)

    def _combine(self, seen: tuple[tuple[Any, ...], tuple[Fault, ...]], clock: StageClock) -> Detected[Boxes3D]:
        (cameras, lidar, radar), faults = seen
        with clock.stage("fuse"):
            views = SensorViews(self._rig, cameras, self._lidar.remember(lidar), radar)
            return Detected(self._fusion.step(views), faults)
