"""Detection by all LiDARs of a rig, timed: from a frame to what they see."""

from dataclasses import replace

import numpy as np

from fbench.pipelines.points import lidar
from fbench.pipelines.points.deskew import Deskew
from fbench.pipelines.points.ground import Plane
from fbench.pipelines.points.lidar import LidarParams, LidarView, Obstacles
from fbench.pipelines.points.long_vehicles import with_whole_trucks
from fbench.pipelines.points.merged import Outline, lidar_points, lidar_position
from fbench.pipelines.stages import StageClock
from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Frame, LogInfo, Rig
from fbench.replay.sensor_settings import SensorSettings


class LidarStage:
    """Remembers how the ground lies, for frames in which no LiDAR tells, and how the body moves."""

    def __init__(self, rig: Rig, log_info: LogInfo, params: LidarParams, settings: SensorSettings) -> None:
        self._rig, self._params = rig, lidar.judging(params, log_info)
        self.labelled = self._params.judge == "model"
        """Whether boxes have labels."""
        own = settings.own("lidar", params, lidar.OWN)
        self._ranges_m = {name: (p.min_range_m, p.max_range_m or np.inf) for name, p in own.items()}
        self._own = Outline(params.ego_front_m, params.ego_rear_m, params.ego_side_m)
        self._deskew = Deskew(log_info) if params.deskew else None
        self._viewpoint = lidar_position(rig) if rig.sensors("lidar") else np.zeros(2)
        self.reset()

    def reset(self) -> None:
        """Forget how the ground lies, and how the body moves."""
        self._plane: Plane | None = None
        if self._deskew is not None:
            self._deskew.reset()

    def view(self, frame: Frame, clock: StageClock) -> LidarView:
        """Detect in the points of one frame; without points nothing is seen but the remembered ground."""
        points = self.points(frame, clock)
        if points is None:
            return LidarView(self._plane, np.zeros((0, 3)), np.zeros(0, np.int64), Boxes3D.empty())
        return self.detect(points, clock)

    def detect(self, points: Float64, clock: StageClock) -> LidarView:
        """Detect in points as `points` gives them."""
        found = self.obstacles(points, clock)
        with clock.stage("detect.lidar"):
            seen = lidar.detect(found, self._viewpoint, self._params)
            return replace(with_whole_trucks(seen, self._viewpoint), plane=self._plane)

    def points(self, frame: Frame, clock: StageClock) -> Float64 | None:
        """Points (N, 3) [m] of all LiDARs in body coordinates at the frame's instant that don't lie on the own vehicle,
        in lexicographic order; `None` where no LiDAR delivered.
        """
        with clock.stage("calibrate"):
            return lidar_points(self._rig, frame, self._ranges_m, self._own, self._deskew)

    def obstacles(self, points: Float64, clock: StageClock) -> Obstacles:
        """Take the ground away from points as `points` gives them, and remember it."""
        with clock.stage("preprocess"):
            found = lidar.obstacles(points, self._params)
        self._plane = found.plane or self._plane
        return found
