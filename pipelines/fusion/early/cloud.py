"""One cloud of what stands on the ground, as LiDAR, radar and stereo see it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.image.params import RadarImageParams
from fbench.pipelines.sensors.lidar.clusters import LidarParams, Obstacles, obstacles
from fbench.pipelines.sensors.lidar.stage import LidarStage
from fbench.pipelines.sensors.points.grid import lexicographic_order
from fbench.pipelines.sensors.points.ground import Plane, find_ground
from fbench.pipelines.sensors.points.merged import viewpoint
from fbench.pipelines.sensors.radar.stage import Compensated
from fbench.pipelines.sensors.rows import Rows
from fbench.pipelines.sensors.stereo.stage import ObjectParams, StereoStage, find_unmeasured, rate_exactness
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.arrays import Array, Bool, Float64
from fbench.replay.data.boxes import Source
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True, eq=False)
class FusedCloud(Rows):
    """Points of all sensors in body coordinates: LiDAR, then stereo, then radar, each in its own canonical order."""

    xyz: Float64  # (N, 3) [m]
    source: Array  # (N,) uint8 bits of `Source`: which sensor saw the point
    range_rate_mps: Float64
    """(N,) radial velocity over ground [m/s], positive when receding; NaN where nothing measured it."""
    period_mps: Float64  # (N,) velocities alias with this period [m/s]; 0: unambiguous
    is_moving: Bool  # (N,) whether a radar saw it move
    height_m: Float64  # (N,) above the ground [m], 0 where that isn't known
    own_mps: Float64  # (N,) the radar's own velocity towards the point [m/s]; NaN of other sensors, or unknown
    exactness: Float64  # (N,) 0 to 1: how much its place counts against an exact one; 1 but for stereo


@dataclass(frozen=True, eq=False)
class DepthView:
    """What stands on the ground in one frame."""

    lidar: Obstacles
    stereo: Obstacles
    plane: Plane | None
    """The ground, as LiDAR sees it, else stereo; `None` where neither does. See `DepthStage.remember`."""
    noisy: tuple[str, ...] = ()  # Cameras whose depth is taken for noise
    measured: Float64 | None = None  # (K, 3) all points of LiDARs, the ground too [m]; `None`: none delivered
    exactness: Float64 = field(default_factory=lambda: np.zeros(0))  # (N,) of the points of `stereo`, 0 to 1


@dataclass(frozen=True)
class EchoParams(CheckedParams, prefix="fusion.echoes"):
    """Which standing radar echoes join the cloud."""

    least_height_m: float = in_range(0.3, -1000, 1000)
    """Standing echoes lower than this above the ground [m] are left out, where the ground is known."""
    most_height_m: float = in_range(3.5, -1000, 1000)
    """Standing echoes higher than this above the ground [m] are left out, where the ground is known."""


def merge_clouds(depth: DepthView, echoes: Compensated | None, min_speed_mps: float, params: EchoParams) -> FusedCloud:
    """Merge what LiDAR and stereo see stand on the ground with radar echoes, in body coordinates.

    Echoes slower than `min_speed_mps` over ground stand, and so do those whose velocity isn't known; of the latter only
    the strongest of a scan are used. Radar is poor at heights, but standing echoes must be about as high as objects.
    """
    lidar, stereo, plane = depth.lidar, depth.stereo, depth.plane
    nums = len(lidar.xyz), len(stereo.xyz)
    xyz, height = np.concatenate([lidar.xyz, stereo.xyz]), np.concatenate([lidar.height_m, stereo.height_m])
    source, zero = np.repeat(np.array([Source.L, Source.S], np.uint8), nums), np.zeros(len(xyz))
    unknown = np.full(len(xyz), np.nan)
    exactness = np.concatenate([np.ones(nums[0]), depth.exactness])
    dense = FusedCloud(xyz, source, unknown, zero, zero > 0, height, unknown, exactness)
    if echoes is None:
        return dense
    moving = np.abs(echoes.range_rate_mps) >= min_speed_mps
    standing, above = np.isfinite(echoes.range_rate_mps) | echoes.is_strong, np.zeros(len(echoes.xyz))
    if plane is not None:
        above = echoes.xyz[:, 2] - plane.z_m(echoes.xyz)
        standing &= (above > params.least_height_m) & (above < params.most_height_m)
    source = np.full(len(moving), Source.R, np.uint8)
    every = FusedCloud(
        echoes.xyz, source, echoes.range_rate_mps, echoes.period_mps, moving, above, echoes.own_mps, np.ones(len(above))
    )
    return FusedCloud.join([dense, every[moving | standing]])


_DENSE = RadarImageParams()  # How a radar shows the ground and shapes; from how many echoes on depends on the log


def find_dense_ground(
    echoes: Compensated | None, plane: Plane | None, min_echoes: int
) -> tuple[Plane | None, Float64 | None]:
    """The ground, by radar where nothing else shows it, and echoes (K, 3) above the height of vehicles [m]; `None`
    where there are fewer than `min_echoes`, too few to show ground and shapes.
    """
    if echoes is None or len(echoes.xyz) < min_echoes:
        return plane, None
    if plane is None:
        plane = find_ground(echoes.xyz[lexicographic_order(*echoes.xyz.T)], _DENSE.ground)[0]
    if plane is None:
        return None, None
    height = echoes.xyz[:, 2] - plane.z_m(echoes.xyz)
    return plane, echoes.xyz[(height >= _DENSE.max_height_m) & (height < 2.5 * _DENSE.max_height_m)]


_NOTHING = Obstacles(None, np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))  # Of a sensor that doesn't deliver


class DepthStage:
    """Remembers how the ground lies, for frames in which nothing shows it."""

    def __init__(
        self, rig: Rig, log_info: LogInfo, params: LidarParams, settings: SensorSettings, stereo: StereoStage | None
    ) -> None:
        if params.detector != "clusters":
            raise ConfigError(f"lidar.detector={params.detector}: early fusion detects in one cloud of all sensors")
        self._lidar = LidarStage(rig, log_info, params, settings)
        self._stereo, self._params = stereo, ObjectParams()
        self.pair = () if stereo is None else (stereo.pair.left, stereo.pair.right)  # Cameras that give depth
        has_lidar = bool(rig.sensors("lidar"))
        own = viewpoint(rig, "lidar" if has_lidar else "radar")
        self.eye_m = np.asarray(own if has_lidar or stereo is None else stereo.eye_m, np.float64)
        """(3,) from where the cloud is seen [m]."""
        self.shapes = replace(params, judge=params.judge or "model")
        """How shapes are classified: those of stereo by rules."""
        if not has_lidar:
            self.shapes = replace(params, judge="rules", shape=self._params.shape)
        self.reset()

    def reset(self) -> None:
        """Forget how the ground lies."""
        self._plane: Plane | None = None
        self._lidar.reset()

    def note_pose(self, frame: Frame) -> None:
        """Take the pose of a frame whose points are looked at elsewhere."""
        self._lidar.note_pose(frame)

    def remember(self, view: DepthView) -> DepthView:
        """Return a view with the ground that was seen last; once for each view, in the order of frames."""
        self._plane = view.plane or self._plane
        return replace(view, plane=self._plane)

    def view(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> DepthView:
        """Take the ground away from the points of one frame; a corrupt image is a fault and counts as missing."""
        points = self._lidar.points(frame, clock)
        lidar = _NOTHING if points is None else self._lidar.obstacles(points, clock)
        stereo, noisy, exactness = _NOTHING, tuple[str, ...](), np.zeros(0)
        if self._stereo is not None:
            view, pair = self._stereo.view(frame, clock, faults), self._stereo.pair
            noisy = (pair.left, pair.right) if view.is_off else ()
            with clock.stage("preprocess"):
                stereo = obstacles(view.xyz, self._params.as_lidar) if len(view.xyz) else stereo
                if points is not None:
                    own = find_unmeasured(stereo.xyz, points, self._stereo.eye_m)
                    stereo = replace(stereo, xyz=stereo.xyz[own], height_m=stereo.height_m[own])
                ray, sigma_px = stereo.xyz - self._stereo.eye_m, self._params.cluster.sigma_px
                exactness = rate_exactness(np.hypot(ray[:, 0], ray[:, 1]), self._stereo.focal_baseline, sigma_px)
        return DepthView(lidar, stereo, lidar.plane or stereo.plane, noisy, points, exactness)


@dataclass(frozen=True, eq=False)
class Scene:
    """What the sensors see in one frame, and how shapes are classified."""

    rig: Rig
    cameras: Mapping[str, CameraDetections]  # By camera name; a camera that failed isn't in it
    cloud: FusedCloud
    plane: Plane | None  # The ground, where it is known
    tall: Float64  # (K, 3) LiDAR points above the height of cars [m]
    eye_m: Float64  # (3,) from where the cloud is seen [m]
    shapes: LidarParams  # How shapes are classified, and what partly seen cars are completed to
    tall_echoes: Float64 | None = None
    """(K, 3) radar echoes above the height of vehicles [m], if enough to show shapes; see `find_dense_ground`.
    """
