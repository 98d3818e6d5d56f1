"""Detection by the bird's-eye network in the points of all LiDARs and radars; timed."""

from dataclasses import dataclass, replace

import numpy as np

from fbench.pipelines.sensors.bev.detector import BevParams, Detector
from fbench.pipelines.sensors.bev.grid import NO_LIDAR, NO_RADAR, BevPoints, lidar_rows, radar_rows
from fbench.pipelines.sensors.lidar.clusters import LidarParams
from fbench.pipelines.sensors.lidar.stage import LidarStage
from fbench.pipelines.sensors.points.ground import Plane, find_ground
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.sensors.radar.stage import Compensated, RadarParams, RadarStage
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.frames import Frame
from fbench.replay.data.rig import Kind, LogInfo, Rig

FLAT = Plane(0.0, 0.0, 0.0)  # Where no LiDAR has told yet
KINDS: dict[str, tuple[Kind, ...]] = {"both": ("lidar", "radar"), "lidar": ("lidar",), "radar": ("radar",)}


@dataclass(frozen=True, eq=False)
class BevMeasurement:
    """What the sensors measured in one frame."""

    xyz: Float64 | None  # (N, 3) [m] of LiDARs; `None` where none delivered
    height_m: Float64  # (N,) above the ground in them, where it is known
    echoes: Compensated | None
    plane: Plane | None  # The ground in the points; `None` where they don't tell


@dataclass(frozen=True, eq=False)
class BevView:
    """What one frame alone tells: the boxes, or what was measured where the ground isn't in it."""

    measured: BevMeasurement
    boxes: Boxes3D | None


class BevInput:
    """Prepares points for the network of `model`, and remembers how the ground lies. Raises LogError where the rig
    lacks sensors of the kinds that are used.
    """

    def __init__(
        self, model: str, rig: Rig, log_info: LogInfo, sensors: str, lidar: LidarParams, radar: RadarParams,
        settings: SensorSettings,
    ) -> None:  # fmt: skip
        require(model, KINDS[sensors], rig, log_info)
        self._ground = lidar.ground
        self._lidar = LidarStage(rig, log_info, lidar, settings) if "lidar" in KINDS[sensors] else None
        self._radar = RadarStage(rig, log_info, radar, settings) if "radar" in KINDS[sensors] else None
        self.reset()

    def reset(self) -> None:
        """Forget how the ground lies, and how the body moves."""
        self._plane = FLAT
        if self._lidar is not None:
            self._lidar.reset()

    def note_pose(self, frame: Frame) -> None:
        """Take the pose of a frame whose points are looked at elsewhere."""
        if self._lidar is not None:
            self._lidar.note_pose(frame)

    def measure(self, frame: Frame, clock: StageClock) -> BevMeasurement:
        """Take the points of one frame, and find the ground in it."""
        xyz = None if self._lidar is None else self._lidar.points(frame, clock)
        echoes = None if self._radar is None else self._radar.echoes(frame, clock)
        with clock.stage("preprocess"):
            plane, _, height = (None, None, np.zeros(0)) if xyz is None else find_ground(xyz, self._ground)
        return BevMeasurement(xyz, height, echoes, plane)

    def remember(self, plane: Plane | None) -> Plane:
        """Take the ground as a frame showed it, `None` where it didn't; return that which was seen last."""
        self._plane = plane or self._plane
        return self._plane

    def prepare(self, seen: BevMeasurement, clock: StageClock) -> tuple[BevPoints, Plane]:
        """Prepare points by the ground in them, else by that which was seen last."""
        self.remember(seen.plane)
        lidar, radar, xyz, echoes = NO_LIDAR, NO_RADAR, seen.xyz, seen.echoes
        with clock.stage("preprocess"):
            if xyz is not None:
                height = xyz[:, 2] - self._plane.z_m(xyz) if seen.plane is None else seen.height_m
                lidar = lidar_rows(xyz, height)
            if echoes is not None:
                height = echoes.xyz[:, 2] - self._plane.z_m(echoes.xyz)
                radar = radar_rows(echoes.xyz, height, echoes.range_rate_mps)
        return BevPoints(lidar, radar), self._plane


class BevStage:
    """Runs the network on what its sensors measured; see `BevInput` and `open_detector` for what is raised."""

    def __init__(
        self, rig: Rig, log_info: LogInfo, network: BevParams, lidar: LidarParams, radar: RadarParams,
        settings: SensorSettings, detector: Detector,
    ) -> None:  # fmt: skip
        self._input = BevInput("learned3d", rig, log_info, detector.sensors, lidar, radar, settings)
        self._min_score, self._detector = network.min_score, detector

    def reset(self) -> None:
        """Forget what earlier frames told."""
        self._input.reset()

    def note_pose(self, frame: Frame) -> None:
        """Take the pose of a frame whose points are looked at elsewhere."""
        self._input.note_pose(frame)

    def view(self, frame: Frame, clock: StageClock) -> BevView:
        """Detect in one frame, unless only earlier ones tell how the ground lies."""
        seen = self._input.measure(frame, clock)
        if seen.plane is None:
            return BevView(seen, None)
        return BevView(BevMeasurement(None, np.zeros(0), None, seen.plane), self._detect(seen, clock))

    def detect(self, view: BevView, clock: StageClock) -> Boxes3D:
        """Return the boxes of a view, in the order of frames; where no sensor delivered, there is nothing."""
        if view.boxes is None:
            return self._detect(view.measured, clock)
        self._input.remember(view.measured.plane)
        return view.boxes

    def _detect(self, seen: BevMeasurement, clock: StageClock) -> Boxes3D:
        points, plane = self._input.prepare(seen, clock)
        with clock.stage("detect.network"):
            boxes = self._detector.detect(points, plane, self._min_score)
        sources = int(Source.L) * (seen.xyz is not None) | int(Source.R) * (seen.echoes is not None)
        return replace(boxes, sources=np.full(len(boxes), sources, np.uint8))
