"""Detection by all LiDARs of a rig, timed: from a frame to what they see."""

from dataclasses import replace

import numpy as np

from fbench.pipelines.points import lidar
from fbench.pipelines.points.ground import Plane
from fbench.pipelines.points.lidar import LidarParams, LidarView
from fbench.pipelines.points.merged import lidar_points, lidar_position, outside
from fbench.pipelines.stages import StageClock
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Frame, Rig
from fbench.replay.sensor_settings import SensorSettings


class LidarStage:
    """Remembers how the ground lies, for frames in which no LiDAR tells."""

    def __init__(self, rig: Rig, params: LidarParams, settings: SensorSettings) -> None:
        self._rig, self._params = rig, params
        own = settings.own("lidar", params, lidar.OWN)
        self._ranges_m = {name: (p.min_range_m, p.max_range_m or np.inf) for name, p in own.items()}
        self._viewpoint = lidar_position(rig) if rig.sensors("lidar") else np.zeros(2)
        self.reset()

    def reset(self) -> None:
        """Forget how the ground lies."""
        self._plane: Plane | None = None

    def view(self, frame: Frame, clock: StageClock) -> LidarView:
        """Detect in the points of one frame; without points nothing is seen but the remembered ground."""
        params = self._params
        with clock.stage("calibrate"):
            points = lidar_points(self._rig, frame, self._ranges_m)
            if points is None:
                return LidarView(self._plane, np.zeros((0, 3)), np.zeros(0, np.int64), Boxes3D.empty())
            points = outside(points, params.ego_front_m, params.ego_rear_m, params.ego_side_m)
        with clock.stage("preprocess"):
            found = lidar.obstacles(points, params)
        self._plane = found.plane or self._plane
        with clock.stage("detect.lidar"):
            return replace(lidar.detect(found, self._viewpoint, params), plane=self._plane)
