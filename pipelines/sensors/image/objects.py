"""Objects that the points of LiDAR or radar show in one image."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fbench.pipelines.sensors.image import params as image
from fbench.pipelines.sensors.image.params import ImageClusterParams, LidarImageParams, RadarImageParams, ShapeParams
from fbench.pipelines.sensors.lidar.classification import measure_inside
from fbench.pipelines.sensors.lidar.clusters import Obstacles
from fbench.pipelines.sensors.points.grid import lexicographic_order, median
from fbench.pipelines.sensors.points.ground import Plane, find_ground
from fbench.pipelines.sensors.points.vehicle import NEAR_M, VehicleSize, complete, fade, fit_rectangles
from fbench.pipelines.sensors.radar.stage import Compensated, median_rate
from fbench.pipelines.sensors.rows import Rows
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.geometry.camera import project_body

_TALL = 2.5  # Points up to so many times the height of vehicles tell what goes on above it


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of all sensors of a kind that are no ground."""

    plane: Plane | None  # The ground; `None` where too few points tell
    xyz: Float64  # (N, 3) [m] in body coordinates
    height_m: Float64  # (N,) above ground [m]
    tall: Float64  # (K, 3) [m] points above the height of vehicles
    viewpoint: Float64  # (3,) where the sensors look from [m] in body coordinates
    moves: Bool  # (N,) whether a point is known to move over ground
    over_ground_mps: Float64
    """(N,) radial velocity over ground [m/s], positive when receding; NaN where it isn't measured."""
    own_mps: Float64  # (N,) the sensor's own velocity towards the points [m/s]; NaN where that isn't known
    period_mps: Float64  # (N,) velocities alias with this period [m/s]; 0: unambiguous

    def __getitem__(self, rows: Array) -> "Cloud":
        """Select points by mask or index array."""
        at = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        return Cloud(
            self.plane, self.xyz.take(at, axis=0), self.height_m.take(at), self.tall, self.viewpoint,
            self.moves.take(at), self.over_ground_mps.take(at), self.own_mps.take(at), self.period_mps.take(at),
        )  # fmt: skip

    def rate_mps(self, rows: Array | slice) -> float:
        """Change of the distance [m/s] of what points are on, positive when receding: their velocity over ground less
        the sensor's own; NaN where unknown.
        """
        own = self.own_mps[rows]
        if not np.isfinite(own).any():
            return float("nan")
        return median_rate(self.over_ground_mps[rows], self.period_mps[rows]) - median(own[~np.isnan(own)])


def empty_cloud() -> Cloud:
    """Return a cloud without points, over ground that isn't known."""
    none = np.zeros(0)
    return Cloud(None, np.zeros((0, 3)), none, np.zeros((0, 3)), np.zeros(2), none > 0, none, none, none)


def of_lidar(found: Obstacles, viewpoint: Float64) -> Cloud:
    """Cloud of what LiDARs at `viewpoint` (3,) [m] measured."""
    unknown = np.full(len(found.xyz), np.nan)
    return Cloud(
        found.plane, found.xyz, found.height_m, found.tall, viewpoint, unknown > 0, unknown, unknown, 0 * found.height_m
    )


def of_radar(echoes: Compensated | None, viewpoint: Float64, min_speed_mps: float, params: RadarImageParams) -> Cloud:
    """Cloud of what radars at `viewpoint` (3,) [m] measured; no points where they don't tell the ground. The order of
    echoes doesn't matter.
    """
    if echoes is None or not len(echoes.xyz):
        return empty_cloud()
    order = lexicographic_order(*echoes.xyz.T, echoes.range_rate_mps)
    xyz = echoes.xyz.take(order, axis=0)
    plane, near, height = find_ground(xyz, params.ground)
    if plane is None:
        return empty_cloud()
    tall = near & (height >= params.max_height_m) & (height < _TALL * params.max_height_m)
    rate = echoes.range_rate_mps[order]
    whole = Cloud(
        plane, xyz, height, xyz[tall], viewpoint, np.abs(rate) >= min_speed_mps, rate, echoes.own_mps[order],
        echoes.period_mps[order],
    )  # fmt: skip
    return whole[near & (height > params.ground.tolerance_m) & (height < params.max_height_m)]


_HEADINGS_RAD = np.radians(np.arange(0.0, 90.0, 3.0))
_OVER_MARGIN_M = 0.3
_CAR = VehicleSize()


@dataclass(frozen=True, eq=False)
class Groups:
    """M groups of points, one after another."""

    cloud: Cloud  # Their points (N)
    first: Int64  # (M + 1,) rows where groups begin, and the end
    rectangles: Float64  # (M, 6) around them as seen from above, as `fit_rectangles` gives them

    @classmethod
    def of(cls, cloud: Cloud, cluster: Int64) -> "Groups":
        """Groups of points whose clusters (N,) ascend from 0."""
        first = np.append(np.flatnonzero(np.diff(cluster, prepend=-1)), len(cluster))
        return cls(cloud, first, fit_rectangles(np.ascontiguousarray(cloud.xyz[:, :2]), first, _HEADINGS_RAD, NEAR_M))

    def __len__(self) -> int:
        return len(self.first) - 1

    @property
    def top_m(self) -> Float64:
        """(M,) height above ground of the highest point [m]."""
        return np.asarray(np.maximum.reduceat(self.cloud.height_m, self.first[:-1]), np.float64)

    @property
    def bottom_m(self) -> Float64:
        """(M,) the same of the lowest point."""
        return np.asarray(np.minimum.reduceat(self.cloud.height_m, self.first[:-1]), np.float64)

    @property
    def moves(self) -> Bool:
        """(M,) whether their points move."""
        return np.asarray(self.cloud.moves[self.first[:-1]], np.bool_)


def score_groups(groups: Groups, params: ShapeParams) -> Float64:
    """Score groups in [0, 1], as the product of all that is known about vehicles. Of those that move only their size
    and number of points are asked: what moves is no wall and no tree.
    """
    shorter, longer = np.sort(groups.rectangles[:, [2, 4]] - groups.rectangles[:, [1, 3]], axis=1).T
    score = fade(np.diff(groups.first), *params.num_points)
    score *= fade(longer, *params.most_length_m) * fade(shorter, *params.most_width_m)
    still = fade(longer, *params.least_extent_m) * fade(groups.rectangles[:, 5], *params.filling_m)
    still *= fade(groups.bottom_m, *params.bottom_m) * fade(groups.top_m, *params.top_m)
    still *= np.where(shorter < params.thin_m, fade(groups.top_m, *params.least_top_m), 1.0)
    score = np.where(groups.moves, score, score * still * params.still)
    likely = np.flatnonzero((score > 0) & ~groups.moves)
    over = measure_inside(groups.cloud.tall, groups.rectangles[likely], _OVER_MARGIN_M)
    score[likely] *= fade(over[:, 0], *params.num_over)
    return np.asarray(score, np.float64)


def outlines(rig: Rig, camera: str, plane: Plane | None, xyz: Float64, first: Int64, margin_px: float) -> Float64:
    """Rectangles (M, 4) [px] around groups of points (N, 3) in body coordinates, at least one each, that begin at rows
    `first` (M + 1,), in an image, clipped to it.

    They reach down to the ground under the nearest point, and are wider than the points by a margin [px]: what is
    between two beams isn't seen. NaN where nothing of one is in the image.
    """
    uv, depth = project_body(rig, camera, xyz)
    begin = first[:-1]
    low = np.minimum.reduceat(uv, begin) - margin_px
    high = np.maximum.reduceat(uv, begin) + margin_px
    number = np.repeat(np.arange(len(begin)), np.diff(first))
    foot = xyz[np.lexsort((depth, number))[begin]].copy()
    if plane is not None:
        foot[:, 2] = plane.z_m(foot)
    high[:, 1] = np.fmax(high[:, 1] - margin_px, project_body(rig, camera, foot)[0][:, 1])  # NaN isn't seen
    width, height = rig.cameras[camera].size_wh
    low = np.maximum(low, -0.5)
    high = np.minimum(high, [width - 0.5, height - 0.5])
    result = np.concatenate([low, high], axis=1)
    result[~np.all(high > low, axis=1)] = np.nan
    return result


_BESIDE = 0.5
"""Points up to this share of the image's size beside it take part: of what the border cuts off they tell the rest."""


@dataclass(frozen=True, eq=False)
class Points(Rows):
    """Points of a cloud as one camera sees them, those of a cluster one after another, those of none first."""

    uv_px: Float64  # (N, 2) [px], in the image or beside it
    depth_m: Float64  # (N,) along the optical axis [m]
    cluster: Int64  # (N,) number of the cluster, a row of `Spots`; -1: none
    cloud: Cloud  # The same points (N) in space


@dataclass(frozen=True, eq=False)
class Spots(Rows):
    """M objects in one image."""

    xyxy_px: Float64  # (M, 4) left, top, right, bottom [px]; NaN where nothing of it is in the image
    score: Float64  # (M,) 0 to 1: how much it looks like a vehicle
    center_m: Float64  # (M, 3) middle of the vehicle [m] in body coordinates
    size_lwh_m: Float64  # (M, 3) its length, width and height [m]
    depth_m: Float64  # (M,) of its near side along the optical axis [m]
    rate_mps: Float64  # (M,) change of its distance [m/s], positive when receding; NaN where unknown
    num_points: Int64  # (M,)

    @property
    def distance_m(self) -> Float64:
        """(M,) from the body's origin to the middle [m]."""
        return np.asarray(np.sqrt((self.center_m**2).sum(axis=1)), np.float64)


def focal_scale(camera: CameraModel) -> float:
    """Return how many pixels of an image one pixel of the parameters is."""
    return float(camera.K[0, 0]) / image.FOCAL_PX


def spots(rig: Rig, camera: str, cloud: Cloud, params: LidarImageParams | RadarImageParams) -> Spots:
    """Cluster the points of a cloud over u, v and depth in one image, and judge the clusters. What moves is clustered
    apart from what stands still. The order of points doesn't matter.
    """
    points = _cluster(rig, camera, cloud, params.cluster)
    member = points.cluster >= 0
    if not member.any() or cloud.plane is None:
        none, places = np.zeros(0), np.zeros((0, 3))
        return Spots(np.zeros((0, 4)), none, places, places, none, none, np.zeros(0, np.int64))
    groups = Groups.of(points.cloud[member], points.cluster[member])
    margin = params.margin_px * focal_scale(rig.cameras[camera])
    # What is seen of each group is completed to a vehicle that stands on the ground.
    whole, height = complete(groups.rectangles, cloud.viewpoint, _CAR), np.maximum(groups.top_m, _CAR.height_m)
    center = np.column_stack([whole.center_m, cloud.plane.z_m(whole.center_m) + height / 2])
    depth = np.minimum.reduceat(points.depth_m[member], groups.first[:-1])
    return Spots(
        xyxy_px=outlines(rig, camera, cloud.plane, groups.cloud.xyz, groups.first, margin),
        score=score_groups(groups, params.shape),
        center_m=center,
        size_lwh_m=np.column_stack([whole.size_lw_m, height]),
        depth_m=depth,
        rate_mps=np.array([groups.cloud.rate_mps(slice(*rows)) for rows in pairwise(groups.first.tolist())]),
        num_points=np.diff(groups.first),
    )


def _cluster(rig: Rig, camera: str, cloud: Cloud, params: ImageClusterParams) -> Points:
    """The points that a camera sees or that lie a little beside, in clusters."""
    uv, depth = project_body(rig, camera, cloud.xyz)
    size = np.array(rig.cameras[camera].size_wh, np.float64)
    low, high = -_BESIDE * size, (1 + _BESIDE) * size
    u, v = uv.T
    seen = np.flatnonzero((u > low[0]) & (u < high[0]) & (v > low[1]) & (v < high[1]))  # NaN isn't
    points = Points(uv.take(seen, axis=0), depth.take(seen), np.full(len(seen), -1), cloud[seen])
    cluster, scaled = points.cluster, points.uv_px / focal_scale(rig.cameras[camera])
    for part in (points.cloud.moves, ~points.cloud.moves):
        found = image.cluster_in_image(scaled[part], points.depth_m[part], params)
        cluster[part] = np.where(found < 0, -1, found + cluster.max(initial=-1) + 1)
    return points[np.argsort(cluster, kind="stable")]
