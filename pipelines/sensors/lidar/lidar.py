"""LiDAR detection: ground removed, the rest clustered and classified."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from fbench.pipelines.sensors.lidar.classification import CarShapeParams, Seen, Standing, classify
from fbench.pipelines.sensors.points import ground
from fbench.pipelines.sensors.points.clustering import ClusterParams
from fbench.pipelines.sensors.points.ground import GroundParams, Plane
from fbench.pipelines.sensors.points.vehicle import HEADINGS_RAD, NEAR_M, OtherSizes, VehicleSize, fit_rectangles
from fbench.replay.contracts.params import CheckedParams, bounded
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo


@dataclass(frozen=True)
class LidarClusterParams(ClusterParams, prefix="lidar.cluster"):
    """Clustering of what stands on the ground."""

    with_height: bool = False  # Whether heights count; if not, points are grouped as seen from above.
    max_height_m: float = bounded(2.5, 0.1, 100)
    """Points higher above the ground [m], such as trees over a street, are left out."""


OWN = ("min_range_m", "max_range_m")
"""Parameters that may differ between LiDARs: what acts before their points are merged."""


@dataclass(frozen=True)
class LidarParams(CheckedParams, prefix="lidar"):
    """Parameters of detection by LiDAR."""

    min_range_m: float = bounded(2.5, 0, 1000)  # Points nearer to the LiDAR [m] lie on the own vehicle.
    max_range_m: float | None = bounded(None, 0.1, 10000)
    """Points farther from the LiDAR [m] are left out; none: all are used."""
    ego_front_m: float = bounded(4.0, 0, 1000)
    """The own vehicle reaches this far ahead of the body's origin [m]: points in its outline lie on it."""
    ego_rear_m: float = bounded(2.5, 0, 1000)  # The own vehicle reaches this far behind the body's origin [m].
    ego_side_m: float = bounded(1.1, 0, 1000)
    """The own vehicle reaches this far to each side of the body's origin [m]; 0: no points are taken for its own."""
    deskew: bool = True
    """Where poses are known, points are moved to the frame's instant by their own times, unless the log says that
    nothing moved in a sweep; sweeps of other instants are moved as a whole."""
    ground: GroundParams = field(default_factory=GroundParams)  # How the ground is found.
    cluster: LidarClusterParams = field(default_factory=LidarClusterParams)  # How points are grouped.
    size: VehicleSize = field(default_factory=VehicleSize)  # What partly seen cars are completed to.
    sizes: OtherSizes = field(default_factory=OtherSizes)
    """What others are completed to; only the model tells them apart."""
    judge: Literal["model", "rules"] | None = None
    """How clusters are judged: `model`, fitted on the simulated city, gives the probability of a road user and its
    class, `rules` how much a cluster looks like a passenger car; none: by the model in simulated logs, else by rules.
    """
    shape: CarShapeParams = field(default_factory=CarShapeParams)  # What a cluster must look like by the rules.

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, size in {
            "size": self.size,
            **{f"sizes.{name}": one for name, one in vars(self.sizes).items()},
        }.items():
            size.check(f"lidar.{name}")


@dataclass(frozen=True, eq=False)
class Obstacles:
    """What stands on the ground and what hangs over it."""

    plane: Plane | None  # The ground; `None` where too few points tell, and then there are no obstacles
    xyz: Float64  # (N, 3) [m] in body coordinates
    height_m: Float64  # (N,) above ground [m]
    tall: Float64  # (M, 3) [m] points above the height of cars


@dataclass(frozen=True, eq=False)
class LidarView:
    """What the LiDAR sees: points that stand on the ground, their clusters, one box for each."""

    plane: Plane | None  # The ground; `None` where too few points tell
    xyz: Float64  # (N, 3) [m] in body coordinates, sorted by cluster, those of no cluster first
    cluster: Int64  # (N,) number of the cluster, -1: none; those numbers are rows of `boxes`
    boxes: Boxes3D
    """One for each cluster. Judged by the model, with its likeliest class as label, and as score the probability that
    it is one road user; by rules, without labels, and the score says how much it looks like a passenger car."""


def judging(params: LidarParams, log_info: LogInfo) -> LidarParams:
    """Return parameters that say how clusters of this log are judged."""
    by_model = SIMULATED in log_info.metadata
    return params if params.judge is not None else replace(params, judge="model" if by_model else "rules")


def obstacles(xyz: Float64, params: LidarParams) -> Obstacles:
    """Take the ground away from points (N, 3) in body coordinates."""
    around = ground.surroundings(xyz, params.ground)
    lowest, near = ground.lowest_points(around, params.ground), around.is_near
    plane = ground.fit_plane(lowest, params.ground)
    if plane is None:
        near, height = np.zeros(len(xyz), np.bool_), np.zeros(len(xyz))
    else:
        height = ground.height_above_ground(around, lowest, plane, params.ground)
    top = params.cluster.max_height_m
    standing = near & (height > params.ground.tolerance_m) & (height < top)
    rows, tall = np.flatnonzero(standing), np.flatnonzero(near & (height >= top) & (height < 2.5 * top))
    return Obstacles(plane, xyz.take(rows, axis=0), height.take(rows), xyz.take(tall, axis=0))


def detect(found: Obstacles, viewpoint: Float64, params: LidarParams) -> LidarView:
    """Cluster obstacles, whose points are in lexicographic order, and judge them, seen from `viewpoint` (2,)."""
    return classify_obstacles(found, clusters(found.xyz, params.cluster), viewpoint, params)


def classify_obstacles(found: Obstacles, cluster: Int64, viewpoint: Float64, params: LidarParams) -> LidarView:
    """Judge obstacles by their clusters (N,), -1 for none, seen from `viewpoint` (2,); by rules unless told."""
    xyz, cluster, seen = sort_by_cluster(found, cluster, viewpoint)
    how = params.judge, params.size, params.sizes, params.shape
    return LidarView(found.plane, xyz, cluster, Boxes3D.empty() if seen is None else classify(seen, *how))


def sort_by_cluster(found: Obstacles, cluster: Int64, viewpoint: Float64) -> tuple[Float64, Int64, Seen | None]:
    """Sort obstacles by their clusters (N,), -1 for none, and fit rectangles; `None` where there are no clusters."""
    by_cluster = np.argsort(cluster, kind="stable")
    xyz, cluster = found.xyz.take(by_cluster, axis=0), cluster[by_cluster]
    loose = int(np.searchsorted(cluster, 0))
    if found.plane is None or loose == len(cluster):
        return xyz, cluster, None
    first = np.append(loose + np.flatnonzero(np.diff(cluster[loose:], prepend=-1)), len(cluster))
    rectangles = fit_rectangles(np.ascontiguousarray(xyz[:, :2]), first, HEADINGS_RAD, NEAR_M)
    height = np.column_stack([xyz[:, :2], found.height_m[by_cluster]])
    tall = np.column_stack([found.tall[:, :2], found.tall[:, 2] - found.plane.z_m(found.tall)])
    return xyz, cluster, Seen(Standing(height, first, tall), rectangles, found.plane, viewpoint)


def clusters(xyz: Float64, params: LidarClusterParams) -> Int64:
    """Cluster obstacles (N, 3): numbers (N,), -1 for none."""
    features = xyz if params.with_height else xyz[:, :2]
    return params.grouping.clusters(features, np.hypot(xyz[:, 0], xyz[:, 1]))
