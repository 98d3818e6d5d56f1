"""LiDAR detection by clusters: ground removed, the rest clustered and classified, long vehicles put together again."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from fbench.pipelines.sensors.bev.detector import LidarNetworkParams
from fbench.pipelines.sensors.bev.grid import NO_LIDAR, lidar_rows
from fbench.pipelines.sensors.lidar.classification import CarShapeParams, Seen, Standing, classify
from fbench.pipelines.sensors.points import vehicle
from fbench.pipelines.sensors.points.clustering import ClusterParams
from fbench.pipelines.sensors.points.ground import GroundParams, Plane, find_ground
from fbench.pipelines.sensors.points.vehicle import Footprints, OtherSizes, VehicleSize
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.arrays import DIGESTED, Bool, Float32, Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo


@dataclass(frozen=True)
class LidarClusterParams(ClusterParams, prefix="lidar.cluster"):
    """Clustering of what stands on the ground."""

    with_height: bool = False  # Whether heights count; if not, points are grouped as seen from above.
    max_height_m: float = in_range(2.5, 0.1, 100)
    """Points higher above the ground [m], such as trees over a street, are left out."""


OWN = ("min_range_m", "max_range_m")
"""Parameters that may differ between LiDARs: what acts before their points are merged."""


@dataclass(frozen=True)
class LidarParams(CheckedParams, prefix="lidar"):
    """Parameters of detection by LiDAR."""

    min_range_m: float = in_range(2.5, 0, 1000)  # Points nearer to the LiDAR [m] lie on the own vehicle.
    max_range_m: float | None = in_range(None, 0.1, 10000)
    """Points farther from the LiDAR [m] are left out; none: all are used."""
    ego_front_m: float = in_range(4.0, 0, 1000)
    """The own vehicle reaches this far ahead of the body's origin [m]: points in its outline lie on it."""
    ego_rear_m: float = in_range(2.5, 0, 1000)  # The own vehicle reaches this far behind the body's origin [m].
    ego_side_m: float = in_range(1.1, 0, 1000)
    """The own vehicle reaches this far to each side of the body's origin [m]; 0: no points are taken for its own."""
    deskew: bool = True
    """Where poses are known, points are moved to the frame's instant by their own times, unless the log says that
    nothing moved in a sweep; sweeps of other instants are moved as a whole."""
    ground: GroundParams = field(default_factory=GroundParams)  # How the ground is found.
    cluster: LidarClusterParams = field(default_factory=LidarClusterParams)  # How points are grouped.
    size: VehicleSize = field(default_factory=VehicleSize)  # What partly seen cars are completed to.
    sizes: OtherSizes = field(default_factory=OtherSizes)
    """What others are completed to; only the model tells them apart."""
    judge: Literal["model", "rules", "both"] | None = None
    """How clusters are judged: `model`, fitted on the simulated city, gives the probability of a road user and its
    class, `rules` how much a cluster looks like a passenger car, `both` the mean of their log-odds, in which rules
    count the less the denser the LiDAR; none: by the model in simulated logs, else by both.
    """
    shape: CarShapeParams = field(default_factory=CarShapeParams)  # What a cluster must look like by the rules.
    detector: Literal["clusters", "learned"] = "clusters"
    """Whether points are clustered and judged, or a bird's-eye network detects in them: clusters are then what lies in
    its boxes."""
    network: LidarNetworkParams = field(default_factory=LidarNetworkParams)
    """That network. In late3d it gets the echoes of radars, too, see `network.sensors`; elsewhere points of LiDARs
    alone."""

    def __post_init__(self) -> None:
        super().__post_init__()
        sizes = {"size": self.size, **{f"sizes.{name}": size for name, size in vars(self.sizes).items()}}
        for name, size in sizes.items():
            size.check(f"lidar.{name}")
        if self.detector == "learned" and self.network.sensors == "radar":
            raise ConfigError("lidar.network.sensors: must be both or lidar, for the network to get points of LiDARs")


@dataclass(frozen=True, eq=False)
class Obstacles:
    """What stands on the ground and what hangs over it."""

    plane: Plane | None  # The ground; `None` where too few points tell, and then there are no obstacles
    xyz: Float64  # (N, 3) [m] in body coordinates
    height_m: Float64  # (N,) above ground [m]
    tall: Float64  # (M, 3) [m] points above the height of cars
    rows: Float32 = field(default_factory=lambda: NO_LIDAR)  # (K, 3) x, y and height above ground [m] of all points
    every_height_m: Float64 = field(default_factory=lambda: np.zeros(0), metadata={DIGESTED: False})
    """(K,) above ground [m] of all points."""


@dataclass(frozen=True, eq=False)
class LidarView:
    """What the LiDAR sees: points that stand on the ground, their clusters, one box for each."""

    plane: Plane | None  # The ground; `None` where too few points tell
    xyz: Float64
    """(N, 3) [m] in body coordinates, sorted by cluster, those of no cluster first; a few stand for a network's box in
    which only echoes lie"""
    cluster: Int64  # (N,) number of the cluster, -1: none; those numbers are rows of `boxes`
    boxes: Boxes3D
    """One for each cluster. Judged by the model, with its likeliest class as label, and as score the probability that
    it is one road user; by rules, without labels, and the score says how much it looks like a passenger car. Those of
    a network have as sources which of LiDAR and radar measured something there."""
    learned: bool = False  # Whether a network detected the boxes, whose classes are as good as a camera's
    with_echoes: bool = False
    """Whether that network got the radars' echoes, too, so that those it doesn't report are of no object"""


def resolve_judge(params: LidarParams, log_info: LogInfo) -> LidarParams:
    """Return parameters that say how clusters of this log are judged."""
    by_model = SIMULATED in log_info.metadata
    return params if params.judge is not None else replace(params, judge="model" if by_model else "both")


def obstacles(xyz: Float64, params: LidarParams) -> Obstacles:
    """Take the ground away from points (N, 3) in body coordinates."""
    plane, near, height = find_ground(xyz, params.ground)
    top = params.cluster.max_height_m
    standing = near & (height > params.ground.tolerance_m) & (height < top)
    rows, tall = np.flatnonzero(standing), np.flatnonzero(near & (height >= top) & (height < 2.5 * top))
    found = Obstacles(plane, xyz.take(rows, axis=0), height.take(rows), xyz.take(tall, axis=0), every_height_m=height)
    return found if params.detector == "clusters" else replace(found, rows=lidar_rows(xyz, height))


def detect(found: Obstacles, viewpoint: Float64, params: LidarParams) -> LidarView:
    """Cluster obstacles, whose points are in lexicographic order, and judge them, seen from `viewpoint` (3,)."""
    return classify_obstacles(found, clusters(found.xyz, params.cluster), viewpoint, params)


def classify_obstacles(found: Obstacles, cluster: Int64, viewpoint: Float64, params: LidarParams) -> LidarView:
    """Judge obstacles by their clusters (N,), -1 for none, seen from `viewpoint` (3,); by rules unless told."""
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
    rectangles = vehicle.fit_rectangles(np.ascontiguousarray(xyz[:, :2]), first, vehicle.HEADINGS_RAD, vehicle.NEAR_M)
    height = np.column_stack([xyz[:, :2], found.height_m[by_cluster]])
    tall = np.column_stack([found.tall[:, :2], found.tall[:, 2] - found.plane.z_m(found.tall)])
    return xyz, cluster, Seen(Standing(height, first, tall), rectangles, found.plane, viewpoint)


def clusters(xyz: Float64, params: LidarClusterParams) -> Int64:
    """Cluster obstacles (N, 3): numbers (N,), -1 for none."""
    features = xyz if params.with_height else xyz[:, :2]
    return params.grouping.clusters(features, np.hypot(xyz[:, 0], xyz[:, 1]))


_LABEL = "truck"
_LEAST_SCORE = 0.2  # What is less likely a road user doesn't take other clusters
_GAP_M = 1.8  # Stripes of one side are at most this far apart
_COLUMN_RAD = np.radians(1.3)
"""Columns of points are at most this far apart, seen from the LiDAR: farther ahead, or from nearly behind, such columns
hit a side many meters apart. There a vehicle ends where it was last seen to be as high as a truck, or right behind."""
_OFF_SIDE_M = 0.5  # Such columns lie at most this far off the side that is seen
_HIGH_M = 2.0  # No car is as high above the ground
_ASIDE_M = 0.3  # Points of a vehicle lie at most this far beside the box that what is seen of it was completed to
_LONGEST_M = 18.0  # What columns continue isn't taken to be longer [m]
_MOST = 0.8  # A cluster of which at least this share lies where the vehicle goes on is a part of it
_SOLID = ("car", "van", "truck")  # What doesn't look like a column of points, as people and two-wheelers do
_ROUNDS = 3  # The more of a side is known, the better its heading, and the more of it is found
MAX_TRUCKS = 100  # The likeliest of a frame take other clusters: each looks at all points, and no road has as many
_TURN_RAD = np.radians(np.arange(-10.0, 10.5, 1.0))


def complete_trucks(view: LidarView, viewpoint: Float64) -> LidarView:
    """Let trucks and buses take what continues them away from the viewer at `viewpoint` (2,), the likeliest first.

    Beams that graze a side hit it farther and farther apart, until each column of them is a cluster of its own. A
    cluster is taken if nearly all of it lies in line with the vehicle and no gap is wider than such columns are apart,
    unless it looks more like a vehicle itself. Boxes get as long as what they took. At most `MAX_TRUCKS` take any.
    """
    boxes = view.boxes
    if boxes.label is None or boxes.score is None:
        return view
    score, numbers = boxes.score, np.arange(len(boxes))
    owner, clustered = numbers.copy(), view.cluster >= 0
    total, is_solid = np.bincount(view.cluster[clustered], minlength=len(boxes)), np.isin(boxes.label, _SOLID)
    center, size, yaw = boxes.center_m.copy(), boxes.size_lwh_m.copy(), boxes.yaw_rad.copy()
    rows = np.flatnonzero((boxes.label == _LABEL) & (score >= _LEAST_SCORE))
    if not len(rows):
        return view
    high = np.zeros(len(view.xyz), np.bool_)  # points (N,) of something as high as a truck
    if view.plane is not None:
        height, top = view.xyz[:, 2] - view.plane.z_m(view.xyz[:, :2]), np.zeros(len(boxes) + 1)
        np.maximum.at(top, view.cluster, np.where(view.cluster >= 0, height, 0.0))
        high = top[view.cluster] > _HIGH_M
    first = np.searchsorted(view.cluster, np.arange(len(boxes) + 1))
    for at in rows[np.lexsort((rows, -score[rows]))][:MAX_TRUCKS].tolist():
        box = Footprints(center[[at], :2], size[[at], :2], yaw[[at]])
        for _ in range(_ROUNDS if owner[at] == at else 0):
            inside = view.cluster[_strip(view, high, slice(first[at], first[at + 1]), box, viewpoint)]
            share = np.bincount(inside[inside >= 0], minlength=len(boxes)) / np.maximum(total, 1)
            taken = (share >= _MOST) & (owner == numbers) & (numbers != at) & ~(is_solid & (score > score[at]))
            if not taken.any():
                break
            owner[taken[owner]] = at
            # Around all its points, turned at most a little and at least as large as before.
            parts = [view.xyz[first[part] : first[part + 1], :2] for part in np.flatnonzero(owner == at)]
            xy = np.concatenate(parts)
            rectangle = vehicle.fit_rectangles(xy, np.array([0, len(xy)]), box.yaw_rad + _TURN_RAD, vehicle.NEAR_M)
            box = vehicle.complete_known(rectangle, np.ones(1, np.bool_), viewpoint, box.size_lw_m)
        center[at, :2], size[at, :2], yaw[at] = box.center_m[0], box.size_lw_m[0], box.yaw_rad[0]
    # Clusters are numbered anew without those that were taken; points stay sorted by cluster.
    kept, cluster = np.flatnonzero(owner == numbers), np.full(len(view.cluster), -1)
    cluster[clustered] = np.searchsorted(kept, owner)[view.cluster[clustered]]
    order = np.argsort(cluster, kind="stable")
    whole_boxes = replace(boxes, center_m=center, size_lwh_m=size, yaw_rad=yaw)
    return LidarView(view.plane, view.xyz[order], cluster[order], whole_boxes[kept])


def _strip(view: LidarView, high: Bool, own: slice, box: Footprints, viewpoint: Float64) -> Int64:
    """Rows (K,) of points that lie where a vehicle with points `own` goes on; `high`: what may be a truck's."""
    axis = np.concatenate([np.cos(box.yaw_rad), np.sin(box.yaw_rad)])
    if (box.center_m[0] - viewpoint) @ axis < 0:
        axis = -axis
    center_along, center_across = _turn(box.center_m - viewpoint, axis)[:, 0]
    own_along, own_across = _turn(view.xyz[own, :2] - viewpoint, axis)
    near, far, half = float(own_along.min()), float(own_along.max()), box.size_lw_m[0, 1] / 2 + _ASIDE_M
    # All else is done with what is near: at most so far from the center.
    reach = 1e-6 + np.hypot(max(center_along - near, far - center_along, near + _LONGEST_M - center_along), half)
    (x, y), (at_x, at_y) = view.xyz[:, :2].T, box.center_m[0]
    around = np.flatnonzero((np.abs(x - at_x) <= reach) & (np.abs(y - at_y) <= reach))
    along, across = _turn(view.xyz[around, :2] - viewpoint, axis)
    beside = np.abs(across - center_across) < half
    rows = np.flatnonzero(beside & (along > far) & (along < near + _LONGEST_M))
    side = own_across[np.argmin(np.abs(own_across))] * float((own_across > 0).all() or (own_across < 0).all())
    on_side, is_high = (np.abs(across[rows] - side) < _OFF_SIDE_M) & (side != 0), high[around[rows]]
    order = np.lexsort((~is_high, ~on_side, along[rows]))
    end = _end(along[rows][order], on_side[order], is_high[order], far, float(side))
    inside: Int64 = around[beside & (along >= near) & (along <= end)]
    return inside


def _turn(xy: Float64, axis: Float64) -> Float64:
    """How far points (N, 2) are along a direction (2,) and to its left, as (2, N); that of a point is its own."""
    return np.stack([xy[:, 0] * axis[0] + xy[:, 1] * axis[1], xy[:, 1] * axis[0] - xy[:, 0] * axis[1]])


def _end(along: Float64, on_side: Bool, high: Bool, far: float, side: float) -> float:
    """Where a vehicle that was seen up to `far` ends [m], by points (N,) from there on.

    It goes on over gaps up to `_GAP_M`, or along its side over those between neighboring columns. Behind the first of
    these it ends that near to the last point that is high. What is seen through it doesn't matter.
    """
    last = end = last_high = far
    has_jumped = False
    for at, is_side, is_high in zip(along.tolist(), on_side.tolist(), high.tolist(), strict=True):
        if at - last <= _GAP_M or (is_side and abs(np.arctan2(side, last) - np.arctan2(side, at)) <= _COLUMN_RAD):
            has_jumped |= at - last > _GAP_M
            last, last_high = at, at if is_high else last_high
            end = at if is_high or at - (last_high if has_jumped else end) <= _GAP_M else end
        elif is_side:
            break
    return end
