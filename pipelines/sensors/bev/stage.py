"""Detection by the bird's-eye network in the points of all LiDARs and radars; timed."""

import numpy as np

from fbench.pipelines.sensors.bev.detector import BevDetector, BevParams
from fbench.pipelines.sensors.bev.grid import NO_LIDAR, NO_RADAR, BevPoints, lidar_rows
from fbench.pipelines.sensors.lidar.stage import LidarParams, LidarStage
from fbench.pipelines.sensors.points.ground import Plane, find_ground
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.sensors.radar.stage import RadarParams, RadarStage
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.rig import Kind, LogInfo, Rig

_FLAT = Plane(0.0, 0.0, 0.0)  # Where no LiDAR has told yet
KINDS: dict[str, tuple[Kind, ...]] = {"both": ("lidar", "radar"), "lidar": ("lidar",), "radar": ("radar",)}


class BevInput:
    """Prepares points for the network, and remembers how the ground lies. Raises LogError where the rig lacks sensors
    of the kinds that are used.
    """

    def __init__(
        self, rig: Rig, log_info: LogInfo, sensors: str, lidar: LidarParams, radar: RadarParams,
        settings: SensorSettings,
    ) -> None:  # fmt: skip
        require("learned3d", KINDS[sensors], rig, log_info)
        self._ground = lidar.ground
        self._lidar = LidarStage(rig, log_info, lidar, settings) if "lidar" in KINDS[sensors] else None
        self._radar = RadarStage(rig, log_info, radar, settings) if "radar" in KINDS[sensors] else None
        self.reset()

    def reset(self) -> None:
        """Forget how the ground lies, and how the body moves."""
        self._plane = _FLAT
        if self._lidar is not None:
            self._lidar.reset()

    def view(self, frame: Frame, clock: StageClock) -> tuple[BevPoints, Plane]:
        """Points of one frame, and the ground that their heights are above."""
        xyz = None if self._lidar is None else self._lidar.points(frame, clock)
        echoes = None if self._radar is None else self._radar.echoes(frame, clock)
        lidar, radar = NO_LIDAR, NO_RADAR
        with clock.stage("preprocess"):
            if xyz is not None:
                plane, _, height = find_ground(xyz, self._ground)
                self._plane = plane or self._plane
                lidar = lidar_rows(xyz, xyz[:, 2] - self._plane.z_m(xyz) if plane is None else height)
            if echoes is not None:
                rate = np.nan_to_num(echoes.range_rate_mps)
                height = echoes.xyz[:, 2] - self._plane.z_m(echoes.xyz)
                radar = np.column_stack([echoes.xyz[:, :2], height, rate]).astype(np.float32)
        return BevPoints(lidar, radar), self._plane


class BevStage:
    """Runs the network on what its sensors measured; see `BevInput` and `BevDetector` for what is raised."""

    def __init__(
        self, rig: Rig, log_info: LogInfo, network: BevParams, lidar: LidarParams, radar: RadarParams,
        settings: SensorSettings, detector: BevDetector,
    ) -> None:  # fmt: skip
        self._input = BevInput(rig, log_info, network.sensors, lidar, radar, settings)
        self._min_score, self._detector = network.min_score, detector

    def reset(self) -> None:
        """Forget what earlier frames told."""
        self._input.reset()

    def view(self, frame: Frame, clock: StageClock) -> Boxes3D:
        """Detect in one frame; where no sensor delivered, there is nothing."""
        points, plane = self._input.view(frame, clock)
        with clock.stage("detect.network"):
            return self._detector.detect(points, plane, self._min_score)
