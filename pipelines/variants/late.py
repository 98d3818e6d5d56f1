"""late2d and late3d: sensors detect separately, and what they found is merged."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from fbench.pipelines.fusion.image import ImageFusion, ImageFusionParams
from fbench.pipelines.fusion.late.existence import FusionParams, resolve_weight
from fbench.pipelines.fusion.late.fuse import LateFusion, SensorViews
from fbench.pipelines.sensors.image.params import LidarImageParams, RadarImageParams, far_radar
from fbench.pipelines.sensors.image.stage import InImages, LidarInImages, RadarInImages, SparseFrames, projectable
from fbench.pipelines.sensors.image.stereo import StereoInImages
from fbench.pipelines.sensors.lidar.stage import LidarStage, RejectedClusters
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.sensors.radar.stage import RadarParams, RadarStage
from fbench.pipelines.sensors.stereo.stage import NOISE, StereoParams
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams, steady_tracking
from fbench.pipelines.tracking.stage import Detected
from fbench.pipelines.tracking.trackers import Tracker2D, Tracker3D
from fbench.pipelines.variants.all_sensors import AllSensorsParams, FusionPipeline, StereoPair, take_pair
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import LogInfo, Rig


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
        self._params, self._rejected, self._sparse = params, RejectedClusters(), SparseFrames()

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig. Raises ConfigError where a camera that is named isn't there. Raises LogError
        where it has no LiDAR, radar or pair of cameras, or no camera that can be projected into, or one that is to be
        used can't.
        """
        params, settings = self._params, SensorSettings(self._params, rig)
        pair = take_pair("late2d", params.stereo_pair, params.stereo, rig, log_info)
        cameras = projectable("late2d", rig, log_info)
        self._start_cameras(rig, log_info, settings)
        self._fusion = ImageFusion(rig, cameras, params.fusion)
        self._lidar = LidarInImages(rig, log_info, cameras, params.lidar, params.lidar_image, settings, self._rejected)
        echoes = RadarStage(rig, log_info, params.radar, settings)
        self._radar = RadarInImages(rig, log_info, cameras, echoes, params.radar, params.radar_image, self._sparse)
        self._stereo = None if pair is None else StereoInImages(rig, cameras, pair)
        self._remember(self._fusion, self._lidar)
        self.weights = {**self._cameras.identity, **self._lidar.identity}
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
        look, find_depth = partial(self._cameras.view, faults=of_images), partial(self._view_depth, faults=of_pairs)
        views = self._note(clock, *self._run(frame, clock, look, find_depth, self._radar.view))
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
class Late3DParams(AllSensorsParams):
    """Parameters of `late3d`."""

    fusion: FusionParams = field(default_factory=FusionParams)  # How the sensors' objects become one.
    tracking: Tracker3DParams = field(default_factory=steady_tracking)  # The tracker.


class Late3D(FusionPipeline[Boxes3D]):
    """Labeled boxes in 3D from any of cameras, LiDARs and radars; at least one LiDAR or radar must be there.

    Each sensor detects on its own, but the network of `lidar.detector=learned` gets echoes, too. Their boxes are merged
    in space, and tracked. Objects without a camera's label are called cars, or trucks where they are long.
    """

    def __init__(self, params: Late3DParams = Late3DParams()) -> None:
        super().__init__(params, params.fusion.camera_share, Tracker3D(params.tracking))
        self._params, self._rejected = params, RejectedClusters()

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig. Raises LogError where it has no LiDAR or radar, or a camera that is to be used
        can't be projected into.
        """
        require("late3d", ("lidar", "radar"), rig, log_info)
        settings = SensorSettings(self._params, rig)
        self._start_cameras(rig, log_info, settings)
        self._lidar = LidarStage(rig, log_info, self._params.lidar, settings, self._rejected)
        self._radar = RadarStage(rig, log_info, self._params.radar, settings)
        self._fusion = LateFusion(resolve_weight(self._params.fusion, self._lidar.judge, bool(self._cameras.used)))
        self._remember(self._fusion, self._lidar)
        self.weights = {**self._cameras.identity, **self._lidar.identity}
        super().start(rig, log_info)

    def warnings(self) -> tuple[Fault, ...]:
        """Say where nearly all clusters of LiDAR were rejected."""
        return self._lidar.warnings()

    def _detect(self, frame: Frame, clock: StageClock) -> Any:
        faults = list[Fault]()
        look = partial(self._cameras.view, faults=faults)
        if self._lidar.takes_echoes:
            echoes = self._radar.echoes(frame, clock)
            see = partial(self._lidar.view, frame, echoes=echoes)
            seen = self._branches.run(clock, partial(look, frame), see, partial(self._radar.detect, echoes))
        else:
            seen = self._run(frame, clock, look, self._lidar.view, self._radar.view)
        return self._note(clock, *seen), tuple(faults)

    def _combine(self, seen: tuple[tuple[Any, ...], tuple[Fault, ...]], clock: StageClock) -> Detected[Boxes3D]:
        (cameras, lidar, radar), faults = seen
        with clock.stage("fuse"):
            views = SensorViews(self._rig, cameras, self._lidar.remember(lidar), radar)
            return Detected(self._fusion.step(views), faults)
