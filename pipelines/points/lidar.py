"""LiDAR detection: ground removed, the rest clustered, clusters judged by how much they look like vehicles."""

from dataclasses import dataclass, field

import numpy as np

from fbench.pipelines.checks import require_between, require_ranges
from fbench.pipelines.points.car_shape import CarShapeParams, plausibility
from fbench.pipelines.points.clustering import Grouping
from fbench.pipelines.points.ground import GroundParams, Plane, fit_plane, height_above_ground, lowest_points
from fbench.pipelines.points.rectangle_kernel import fit_rectangles
from fbench.pipelines.points.vehicle import VehicleSize, complete
from fbench.replay.arrays import Float64, Int64
from fbench.replay.boxes import Boxes3D

_HEADINGS_RAD = np.radians(np.arange(0.0, 90.0, 2.0))
_NEAR_M = 0.05


@dataclass(frozen=True)
class LidarClusterParams:
    """Clustering of what stands on the ground."""

    method: str = "dbscan"
    """DBSCAN, or one of scikit-learn's: agglomerative, birch, hdbscan, meanshift, optics."""
    eps_m: float = 0.6
    """Radius [m]."""
    min_points: int = 4
    """Points within the radius that make a core point, itself included."""
    adaptive_from_m: float | None = None
    """Beyond this distance from the body's origin [m] the radius grows in proportion to it; none: it is the same
    everywhere."""
    with_height: bool = False
    """Whether heights count; if not, points are grouped as seen from above."""
    max_height_m: float = 2.5
    """Points higher above the ground [m], such as trees over a street, are left out."""

    def __post_init__(self) -> None:
        ranges = {"eps_m": (0.01, 100.0), "min_points": (1, 1e6), "max_height_m": (0.1, 100.0)}
        require_ranges("lidar.cluster", self, ranges)
        self.grouping.check("lidar.cluster")

    @property
    def grouping(self) -> Grouping:
        """What of this tells how points are grouped."""
        return Grouping(self.method, self.eps_m, self.min_points, self.adaptive_from_m)


OWN = ("min_range_m", "max_range_m")
"""Parameters that may differ between LiDARs: what acts before their points are merged."""


@dataclass(frozen=True)
class LidarParams:
    """Parameters of detection by LiDAR."""

    min_range_m: float = 2.5
    """Points nearer to the LiDAR [m] lie on the own vehicle."""
    max_range_m: float | None = None
    """Points farther from the LiDAR [m] are left out; none: all are used."""
    ego_front_m: float = 4.0
    """The own vehicle reaches this far ahead of the body's origin [m]: points in its outline lie on it."""
    ego_rear_m: float = 2.5
    """The own vehicle reaches this far behind the body's origin [m]."""
    ego_side_m: float = 1.1
    """The own vehicle reaches this far to each side of the body's origin [m]; 0: no points are taken for its own."""
    ground: GroundParams = field(default_factory=GroundParams)
    """How the ground is found."""
    cluster: LidarClusterParams = field(default_factory=LidarClusterParams)
    """How points are grouped."""
    size: VehicleSize = field(default_factory=VehicleSize)
    """What partly seen vehicles are completed to."""
    shape: CarShapeParams = field(default_factory=CarShapeParams)
    """What a cluster must look like."""

    def __post_init__(self) -> None:
        names = ("min_range_m", "ego_front_m", "ego_rear_m", "ego_side_m")
        require_ranges("lidar", self, dict.fromkeys(names, (0.0, 1000.0)))
        if self.max_range_m is not None:
            require_between("lidar.max_range_m", self.max_range_m, 0.1, 10_000.0)
        self.size.check("lidar.size")


@dataclass(frozen=True, eq=False)
class Obstacles:
    """What stands on the ground and what hangs over it."""

    plane: Plane | None
    """The ground; `None` where too few points tell, and then there are no obstacles."""
    xyz: Float64
    """(N, 3) [m] in body coordinates."""
    height_m: Float64
    """(N,) above ground [m]."""
    tall: Float64
    """(M, 3) [m] points above the height of cars."""


@dataclass(frozen=True, eq=False)
class LidarView:
    """What the LiDAR sees: points that stand on the ground, their clusters, one box for each."""

    plane: Plane | None
    """The ground; `None` where too few points tell."""
    xyz: Float64
    """(N, 3) [m] in body coordinates, sorted by cluster, those of no cluster first."""
    cluster: Int64
    """(N,) number of the cluster, -1: none; those numbers are rows of `boxes`."""
    boxes: Boxes3D
    """One for each cluster, with a score in [0, 1]: how much it looks like a passenger car."""


def obstacles(xyz: Float64, params: LidarParams) -> Obstacles:
    """Take the ground away from points (N, 3) in body coordinates."""
    lowest = lowest_points(xyz, params.ground)
    plane = fit_plane(lowest, params.ground)
    near = np.hypot(xyz[:, 0], xyz[:, 1]) < params.ground.range_m
    if plane is None:
        near, height = np.zeros(len(xyz), np.bool_), np.zeros(len(xyz))
    else:
        height = height_above_ground(xyz, lowest, plane, params.ground)
    top = params.cluster.max_height_m
    standing = near & (height > params.ground.tolerance_m) & (height < top)
    return Obstacles(plane, xyz[standing], height[standing], xyz[near & (height >= top) & (height < 2.5 * top)])


def detect(found: Obstacles, viewpoint: Float64, params: LidarParams) -> LidarView:
    """Cluster obstacles, whose points are in lexicographic order, and judge them, seen from `viewpoint` (2,)."""
    return judged(found, _clusters(found.xyz, params.cluster), viewpoint, params)


def judged(found: Obstacles, cluster: Int64, viewpoint: Float64, params: LidarParams) -> LidarView:
    """Judge obstacles by their clusters (N,), -1 for none, seen from `viewpoint` (2,)."""
    by_cluster = np.argsort(cluster, kind="stable")
    xyz, cluster = found.xyz[by_cluster], cluster[by_cluster]
    member = cluster >= 0
    if found.plane is None or not member.any():
        return LidarView(found.plane, xyz, cluster, Boxes3D.empty())
    grouped = Obstacles(found.plane, xyz[member], found.height_m[by_cluster][member], found.tall)
    return LidarView(found.plane, xyz, cluster, _boxes(grouped, found.plane, cluster[member], viewpoint, params))


def _clusters(xyz: Float64, params: LidarClusterParams) -> Int64:
    features = xyz if params.with_height else xyz[:, :2]
    return params.grouping.clusters(features, np.hypot(xyz[:, 0], xyz[:, 1]))


def _boxes(found: Obstacles, plane: Plane, cluster: Int64, viewpoint: Float64, params: LidarParams) -> Boxes3D:
    """Judge clusters, whose points are sorted by `cluster` (N,)."""
    first = np.append(np.flatnonzero(np.diff(cluster, prepend=-1)), len(cluster))
    rectangles = fit_rectangles(np.ascontiguousarray(found.xyz[:, :2]), first, _HEADINGS_RAD, _NEAR_M)
    footprint = complete(rectangles, viewpoint, params.size)
    top = np.maximum.reduceat(found.height_m, first[:-1])
    bottom = np.minimum.reduceat(found.height_m, first[:-1])
    score = plausibility(rectangles, np.diff(first), bottom, top, found.tall, params.shape)
    height = np.maximum(top, params.size.height_m)
    center = np.column_stack([footprint.center_m, plane.z_m(footprint.center_m) + height / 2])
    size = np.column_stack([footprint.size_lw_m, height])
    return Boxes3D(center, size, footprint.yaw_rad, score=score)
