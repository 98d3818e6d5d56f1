"""late2d: cameras, LiDARs and radars detect in the images on their own; their boxes are merged there."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from fbench.pipelines.params import StageClock
from fbench.pipelines.sensors.camera.stage import CameraStage
from fbench.pipelines.sensors.image.stage import InImages, LidarInImages, RadarInImages
from fbench.pipelines.sensors.lidar.stage import LidarStage
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.sensors.radar.radar import RadarStage
from fbench.pipelines.tracking.stage import Tracked2D
from fbench.pipelines.variants.fused_images import FusedImages, FusedImagesParams
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import LogInfo, Rig


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
