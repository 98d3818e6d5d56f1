"""Depth by one stereo pair, timed, and vehicles in its points."""

from dataclasses import dataclass, field, replace

import numpy as np

from fbench.pipelines.sensors.lidar import clusters as lidar
from fbench.pipelines.sensors.lidar.classification import CarShapeParams
from fbench.pipelines.sensors.lidar.clusters import LidarClusterParams, LidarParams, LidarView
from fbench.pipelines.sensors.points.dbscan import dbscan
from fbench.pipelines.sensors.points.ground import GroundParams
from fbench.pipelines.sensors.points.vehicle import VehicleSize, fade
from fbench.pipelines.sensors.stereo import depth
from fbench.pipelines.sensors.stereo.depth import DepthParams, DisparityParams, Matcher, QualityParams
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.images import Pixels, decode_grey
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import Rig


@dataclass(frozen=True)
class StereoParams:
    """Parameters of depth by stereo."""

    left: str | None = None  # Name of the left camera; none: that of the pair with the longest baseline.
    right: str | None = None  # Name of the right camera; none: see `left`.
    disparity: DisparityParams = field(default_factory=DisparityParams)  # How the images are matched.
    quality: QualityParams = field(default_factory=QualityParams)  # When depth is taken for noise.
    depth: DepthParams = field(default_factory=DepthParams)  # What depth becomes.


NOISE = "stereo depth is noise"  # Why stereo is left out of a frame whose images match too badly


@dataclass(frozen=True, eq=False)
class StereoView:
    """Depth of one frame."""

    xyz: Float64
    """(N, 3) [m] in body coordinates, in lexicographic order; none where stereo is off, or an image is missing."""
    sure_share: float | None = None
    """Share of pixels on the ground and what stands there that are surely matched; `None` where an image is missing."""
    is_off: bool = False  # Whether both images are there but their depth is taken for noise


class StereoStage:
    """Finds depth with one pair of cameras; a frame's depth depends on that frame alone. Raises ConfigError where a
    camera that is named isn't there. Raises LogError where the rig has no stereo pair, or what it has can't be
    rectified.
    """

    def __init__(self, rig: Rig, log_name: str, params: StereoParams) -> None:
        self._params = params
        self._sizes = {name: camera.size_wh for name, camera in rig.cameras.items()}
        self.pair = depth.choose_pair(rig, log_name, params.left, params.right)  # The cameras that are used
        self._how = depth.rectifier(rig, self.pair, params.disparity.shrink)
        camera, self.eye_m = self._how.camera, self._how.body_T_camera[:3, 3]
        self._matcher = Matcher(float(camera.K[0, 0]), self._how.baseline_m, camera.size_wh[0], params.disparity)
        self.focal_baseline = float(camera.K[0, 0]) * self._how.baseline_m
        """f B [px m] of the shrunk images: Z = f B / d."""

    def view(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> StereoView:
        """Find the depth of one frame; a corrupt image is a fault and counts as missing."""
        with clock.stage("decode"):
            images = [self._pixels(frame, name, faults) for name in (self.pair.left, self.pair.right)]
        if images[0] is None or images[1] is None:
            return StereoView(np.zeros((0, 3)))
        with clock.stage("preprocess"):
            left, right = self._how.images(images[0], images[1])
        with clock.stage("detect.stereo"):
            texture = self._matcher.texture(left)
            disparity = self._matcher.disparity(left, right, texture)
            end = depth.last_row(disparity, self._how, self._matcher.num_px)
            share = depth.sure_share(left, right, disparity, texture, self._how, end, self._params.quality)
        if share < self._params.quality.min_share:
            return StereoView(np.zeros((0, 3)), share, True)
        with clock.stage("calibrate"):
            nearest_m = max(self._params.disparity.nearest_m, self.focal_baseline / self._matcher.num_px)
            disparity[end:] = np.nan
            return StereoView(depth.points(disparity, self._how, nearest_m, self._params.depth), share)

    def _pixels(self, frame: Frame, name: str, faults: list[Fault]) -> Pixels | None:
        image = frame.messages.get(name)
        if not isinstance(image, Image):
            return None
        pixels = decode_grey(image)
        if pixels is None:
            faults.append(Fault("DEC002", f"{name} at stamp {image.stamp_ns}"))
        elif pixels.shape[1::-1] != self._sizes[name]:
            faults.append(Fault("LIM003", f"{name} at stamp {image.stamp_ns}"))
            return None
        return pixels


@dataclass(frozen=True)
class StereoGroundParams(GroundParams, prefix="objects.ground"):
    """How the ground is found in points of stereo."""

    tolerance_m: float = in_range(0.3, 0, 10)


@dataclass(frozen=True)
class StereoShapeParams(CarShapeParams, prefix="objects.shape"):
    """What a cluster of stereo must be like: errors of depth widen clusters and fill them."""

    top_m: tuple[float, float] = (2.2, 2.6)
    least_extent_m: tuple[float, float] = (1.2, 0.6)
    most_length_m: tuple[float, float] = (6.0, 8.0)
    most_width_m: tuple[float, float] = (2.6, 3.6)
    filling_m: tuple[float, float] = (0.5, 0.9)
    num_points: tuple[float, float] = (12.0, 6.0)
    num_over: tuple[float, float] = (1.0, 4.0)


@dataclass(frozen=True)
class StereoClusterParams(CheckedParams, prefix="objects.cluster"):
    """DBSCAN on what stands on the ground, seen from above, with radii that grow with range r."""

    eps_m: float = in_range(0.5, 0.01, 100)
    """Least radius along the line of sight [m]: it is eps_m + 2 r^2 / (f B) sigma_px."""
    sigma_px: float = in_range(0.1, 0.001, 100)
    """Error of disparity [px] of the shrunk image that is bridged; errors of neighbors are alike."""
    eps_rad: float = in_range(0.04, 0.001, 3)  # Radius across the line of sight [rad]: 0.8 m at 20 m.
    min_points: int = in_range(5, 1, 1e6)  # Points within the radius that make a core point, itself included.
    max_height_m: float = in_range(2.5, 0.1, 100)  # Points higher above the ground [m] are left out.


@dataclass(frozen=True)
class ObjectParams:
    """What becomes of the points."""

    ground: StereoGroundParams = field(default_factory=StereoGroundParams)  # How the ground is found.
    cluster: StereoClusterParams = field(default_factory=StereoClusterParams)  # How points are grouped.
    least_top_m: tuple[float, float] = (1.0, 0.8)
    """Height of a cluster's highest point [m]: from the first on fine, below the second no vehicle but a barrier."""
    size: VehicleSize = field(default_factory=VehicleSize)  # What partly seen vehicles are completed to.
    shape: StereoShapeParams = field(default_factory=StereoShapeParams)  # What a cluster must look like.

    def __post_init__(self) -> None:
        self.size.check("objects.size")
        fine, impossible = self.least_top_m
        if not 0 <= impossible < fine <= 100:
            raise ConfigError(f"objects.least_top_m: expected 100 >= first > second >= 0, got {fine:g},{impossible:g}")

    @property
    def as_lidar(self) -> LidarParams:
        """The same for stages that are LiDAR's, too."""
        cluster = LidarClusterParams(max_height_m=self.cluster.max_height_m)
        return LidarParams(ground=self.ground, cluster=cluster, size=self.size, judge="rules", shape=self.shape)


def detect(xyz: Float64, eye_m: Float64, focal_baseline: float, params: ObjectParams) -> LidarView:
    """Find vehicles in points (N, 3) in body coordinates [m] and lexicographic order. `eye_m` (3,) is where the left
    camera is, `focal_baseline` f B [px m] what depth follows from.
    """
    how = params.as_lidar
    found = lidar.obstacles(xyz, how)
    # Points are moved to where a radius of 1 is that of the parameters everywhere: across the line of sight that is the
    # azimuth over eps_rad, along it the integral of dr / (e + k r^2), which is atan(r sqrt(k / e)) / sqrt(k e).
    x, y = (found.xyz[:, :2] - eye_m[:2]).T
    own, growth = params.cluster, 2 * params.cluster.sigma_px / focal_baseline
    along = np.arctan(np.hypot(x, y) * np.sqrt(growth / own.eps_m)) / np.sqrt(growth * own.eps_m)
    cluster = dbscan(np.column_stack([along, np.arctan2(y, x) / own.eps_rad]), 1.0, own.min_points)
    view = lidar.classify_obstacles(found, cluster, eye_m, how)
    score = view.boxes.score
    if view.plane is None or score is None or not len(score):
        return view
    member = view.cluster >= 0
    first = np.flatnonzero(np.diff(view.cluster[member], prepend=-1))
    top_m = np.maximum.reduceat((view.xyz[:, 2] - view.plane.z_m(view.xyz))[member], first)
    return replace(view, boxes=replace(view.boxes, score=score * fade(top_m, *params.least_top_m)))


_EXACT_M = 0.3
"""Points of stereo with such an error of depth [m] count half."""


def rate_exactness(range_m: Float64, focal_baseline: float, sigma_px: float) -> Float64:
    """How much points of stereo (N,) at ranges [m] count: as 1 / variance does beside a variance that all have. With
    Z = f B / d the error of depth is Z^2 / (f B) times that of disparity [px] (thesis, stereo; any textbook).
    """
    error_m = range_m**2 / focal_baseline * sigma_px
    return np.asarray(1 / (1 + (error_m / _EXACT_M) ** 2), np.float64)


_CELL_RAD = np.radians(0.5)  # Beams of a LiDAR that isn't sparse are at most about twice as far from each other
_CELLS = round(2 * np.pi / _CELL_RAD)  # Around


def find_unmeasured(xyz: Float64, measured: Float64, eye_m: Float64) -> Bool:
    """Which points (N, 3) lie in directions from `eye_m` (3,) in and beside which LiDARs measured nothing, given all
    their points (K, 3) in the same coordinates. In all others, LiDARs measure better than stereo.
    """
    is_measured = np.zeros((_CELLS, _CELLS // 2 + 3), np.bool_)
    azimuth, elevation = _direction_cells(measured - eye_m)
    for beside in (-1, 0, 1):
        for above in (0, 1, 2):
            is_measured[(azimuth + beside) % _CELLS, elevation + above] = True
    azimuth, elevation = _direction_cells(xyz - eye_m)
    return np.asarray(~is_measured[azimuth % _CELLS, elevation + 1], np.bool_)


def _direction_cells(ray: Float64) -> tuple[Int64, Int64]:
    x, y, z = ray.T
    azimuth, elevation = np.arctan2(y, x) + np.pi, np.arctan2(z, np.hypot(x, y)) + np.pi / 2
    return np.floor(azimuth / _CELL_RAD).astype(np.int64), np.floor(elevation / _CELL_RAD).astype(np.int64)
