"""lidar2d and lidar3d: road users from the points of all LiDARs alone, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.sensors.image.params import LidarImageParams
from fbench.pipelines.sensors.image.stage import InImages, LidarInImages, drop_labels, projectable
from fbench.pipelines.sensors.lidar.clusters import LidarParams, LidarView
from fbench.pipelines.sensors.lidar.stage import LidarStage, RejectedClusters
from fbench.pipelines.sensors.points.merged import report_boxes, require
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams, steady_tracking
from fbench.pipelines.tracking.stage import Detected, TrackingPipeline
from fbench.pipelines.tracking.trackers import Tracker2D, Tracker3D
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes2D, Boxes3D, Source
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True)
class LidarAloneParams(CheckedParams):
    """What pipelines of LiDARs alone share."""

    lidar: LidarParams = field(default_factory=LidarParams)  # Detection.
    min_score: float = in_range(0.5, 0, 1)  # Clusters with a lower score are dropped.
    detect_every: int = in_range(1, 1)
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one LiDAR, by its name: `--set top.min_range_m=1` goes before `lidar.min_range_m`; so does max_range_m. What
    acts on the points of all LiDARs together can't differ.
    """


@dataclass(frozen=True)
class Lidar2DParams(LidarAloneParams):
    """Parameters of `lidar2d`."""

    min_score: float = in_range(0.4, 0, 1)  # Clusters that look less like a vehicle than this are dropped.
    lidar_image: LidarImageParams = field(default_factory=LidarImageParams)  # Detection in images.
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)  # The tracker, one per camera.


@dataclass(frozen=True)
class Lidar3DParams(LidarAloneParams):
    """Parameters of `lidar3d`."""

    tracking: Tracker3DParams = field(default_factory=steady_tracking)  # The tracker.


class Lidar2D(TrackingPipeline[Boxes2D]):
    """Boxes in the images of all cameras from all LiDARs; images aren't decoded. They have no class."""

    kinds = ("lidar",)

    def __init__(self, params: Lidar2DParams = Lidar2DParams()) -> None:
        super().__init__(Tracker2D(params.tracking), params.detect_every)
        self._params, self._rejected = params, RejectedClusters()

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all LiDARs, and cameras with a projection. Raises LogError where either is missing."""
        require("lidar2d", ("lidar",), rig, log_info)
        cameras = projectable("lidar2d", rig, log_info)
        params, settings = self._params, SensorSettings(self._params, rig)
        self._lidar = LidarInImages(rig, log_info, cameras, params.lidar, params.lidar_image, settings, self._rejected)
        self._remember(self._lidar)
        self.weights = self._lidar.identity
        super().start(rig, log_info)

    def warnings(self) -> tuple[Fault, ...]:
        """Say where nearly all clusters were rejected."""
        return self._lidar.warnings()

    def _detect(self, frame: Frame, clock: StageClock) -> InImages:
        return self._lidar.view(frame, clock)

    def _combine(self, seen: InImages, clock: StageClock) -> Detected[Boxes2D]:
        self._lidar.remember(seen)
        return Detected(drop_labels(seen.seen, self._params.min_score))


class Lidar3D(TrackingPipeline[Boxes3D]):
    """Boxes in 3D from all LiDARs, merged in body coordinates, without velocity; labeled where the model classifies."""

    kinds = ("lidar",)

    def __init__(self, params: Lidar3DParams = Lidar3DParams()) -> None:
        super().__init__(Tracker3D(params.tracking), params.detect_every)
        self._params, self._rejected = params, RejectedClusters()

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all LiDARs of the rig. Raises LogError where it has none."""
        require("lidar3d", ("lidar",), rig, log_info)
        settings = SensorSettings(self._params, rig)
        self._lidar = LidarStage(rig, log_info, self._params.lidar, settings, self._rejected)
        self._remember(self._lidar)
        self.weights = self._lidar.identity
        super().start(rig, log_info)

    def warnings(self) -> tuple[Fault, ...]:
        """Say where nearly all clusters were rejected."""
        return self._lidar.warnings()

    def _detect(self, frame: Frame, clock: StageClock) -> LidarView:
        return self._lidar.view(frame, clock)

    def _combine(self, seen: LidarView, clock: StageClock) -> Detected[Boxes3D]:
        boxes = self._lidar.remember(seen).boxes
        return Detected(report_boxes(boxes, self._params.min_score, Source.L, self._lidar.labeled))
