"""lidar3d: road users from the points of all LiDARs alone, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.common_params import LidarAloneParams
from fbench.pipelines.points.lidar_stage import LidarStage
from fbench.pipelines.points.merged import require
from fbench.pipelines.points.reported import reported
from fbench.pipelines.stages import StageClock
from fbench.pipelines.tracked import Detected, Tracked3D
from fbench.pipelines.tracking.params import Tracker3DParams, steady_tracking
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Frame, LogInfo, Output, Rig, Source
from fbench.replay.sensor_settings import SensorSettings


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
