"""lidar2d and lidar3d: road users from the points of all LiDARs alone, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.params import StageClock
from fbench.pipelines.sensors.image.params import LidarImageParams, whole_vehicles
from fbench.pipelines.sensors.image.stage import LidarInImages, projectable, unlabelled
from fbench.pipelines.sensors.lidar.lidar import LidarParams
from fbench.pipelines.sensors.lidar.stage import LidarStage
from fbench.pipelines.sensors.points.merged import reported, require
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams, steady_tracking
from fbench.pipelines.tracking.stage import Detected, Tracked2D, Tracked3D
from fbench.pipelines.variants.params import LidarAloneParams
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes2D, Boxes3D, Source
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True)
class Lidar2DParams(LidarAloneParams):
    """Parameters of `lidar2d`."""

    lidar: LidarParams = field(default_factory=whole_vehicles)
    """Points and ground; of `lidar.cluster` only max_height_m counts here."""
    min_score: float = 0.4
    """Clusters that look less like a vehicle than this are dropped."""
    lidar_image: LidarImageParams = field(default_factory=LidarImageParams)
    """Detection in images."""
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)
    """The tracker, one per camera."""


class Lidar2D:
    """Boxes in the images of all cameras from all LiDARs; images aren't looked at. They have no class."""

    def __init__(self, params: Lidar2DParams = Lidar2DParams()) -> None:
        self._params, self._tracked = params, Tracked2D(params.tracking, params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all LiDARs of the rig, and the cameras that can be projected into.

        Raises:
            LogError: where it has no LiDAR, or no such camera.
        """
        require("lidar2d", ("lidar",), rig, log_info)
        cameras = projectable("lidar2d", rig, log_info)
        self._points = LidarStage(rig, log_info, self._params.lidar, SensorSettings(self._params, rig))
        self._lidar = LidarInImages(rig, cameras, self._points, self._params.lidar_image)
        self.reset("start")

    def reset(self, reason: str) -> None:
        """Forget all tracks, and how the ground lies."""
        self._tracked.reset()
        self._points.reset()

    def step(self, frame: Frame) -> Output:
        """Detect and track; a frame without LiDAR has no detections."""
        return self._tracked.step(frame, self._detected)

    def _detected(self, frame: Frame, clock: StageClock) -> Detected[Boxes2D]:
        return Detected(unlabelled(self._lidar.view(frame, clock).seen, self._params.min_score))


@dataclass(frozen=True)
class Lidar3DParams(LidarAloneParams):
    """Parameters of `lidar3d`."""

    tracking: Tracker3DParams = field(default_factory=steady_tracking)
    """The tracker."""


class Lidar3D:
    """Boxes in 3D from all LiDARs, merged in body coordinates, without velocity; with labels where the model judges."""

    def __init__(self, params: Lidar3DParams = Lidar3DParams()) -> None:
        self._params, self._tracked = params, Tracked3D(params.tracking, params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all LiDARs of the rig.

        Raises:
            LogError: where it has none.
        """
        require("lidar3d", ("lidar",), rig, log_info)
        self._tracked.start(rig)
        self._lidar = LidarStage(rig, log_info, self._params.lidar, SensorSettings(self._params, rig))
        self.reset("start")

    def reset(self, reason: str) -> None:
        """Forget all tracks, and how the ground lies."""
        self._tracked.reset()
        self._lidar.reset()

    def step(self, frame: Frame) -> Output:
        """Detect and track; a frame without LiDAR has no detections."""
        return self._tracked.step(frame, self._detected)

    def _detected(self, frame: Frame, clock: StageClock) -> Detected[Boxes3D]:
        boxes = self._lidar.view(frame, clock).boxes
        return Detected(reported(boxes, self._params.min_score, Source.L, self._lidar.labelled))
