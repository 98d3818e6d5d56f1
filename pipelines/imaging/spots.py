"""Objects that the points of one kind of sensor show in one image."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.imaging.cloud import Cloud
from fbench.pipelines.imaging.outline import outlines
from fbench.pipelines.imaging.params import FOCAL_PX, ShapeParams
from fbench.pipelines.imaging.shape import Groups, footprints, likeness
from fbench.pipelines.points.image_clusters import ImageClusterParams, cluster_in_image
from fbench.pipelines.points.ordering import median
from fbench.pipelines.points.radar import median_rate
from fbench.replay.arrays import Array, Float64, Int64
from fbench.replay.data import CameraModel, Rig
from fbench.replay.geometry.camera import project_body

_BESIDE = 0.5
"""Points up to this share of the image's size beside it take part: of what the border cuts off they tell the rest."""


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a cloud as one camera sees them, those of a cluster one after another, those of none first."""

    uv_px: Float64
    """(N, 2) [px], in the image or beside it."""
    depth_m: Float64
    """(N,) along the optical axis [m]."""
    cluster: Int64
    """(N,) number of the cluster, a row of `Spots`; -1: none."""
    cloud: Cloud
    """The same points (N) in space."""

    def rows(self, rows: Array) -> "Points":
        """Select points by mask or index array."""
        return Points(self.uv_px[rows], self.depth_m[rows], self.cluster[rows], self.cloud.rows(rows))


@dataclass(frozen=True, eq=False)
class Spots:
    """M objects in one image."""

    xyxy_px: Float64
    """(M, 4) left, top, right, bottom [px]; NaN where nothing of it is in the image."""
    score: Float64
    """(M,) 0 to 1: how much it looks like a vehicle."""
    center_m: Float64
    """(M, 3) middle of the vehicle [m] in body coordinates."""
    size_lwh_m: Float64
    """(M, 3) its length, width and height [m]."""
    depth_m: Float64
    """(M,) of its near side along the optical axis [m]."""
    rate_mps: Float64
    """(M,) change of its distance [m/s], positive when receding; NaN where unknown."""
    num_points: Int64
    """(M,)."""

    def __len__(self) -> int:
        return len(self.score)

    @property
    def distance_m(self) -> Float64:
        """(M,) from the body's origin to the middle [m]."""
        return np.asarray(np.sqrt((self.center_m**2).sum(axis=1)), np.float64)

    def rows(self, rows: Array) -> "Spots":
        """Select objects by mask or index array."""
        return Spots(
            self.xyxy_px[rows], self.score[rows], self.center_m[rows], self.size_lwh_m[rows], self.depth_m[rows],
            self.rate_mps[rows], self.num_points[rows],
        )  # fmt: skip


@dataclass(frozen=True)
class SpotParams:
    """What differs between kinds of sensors."""

    cluster: ImageClusterParams
    shape: ShapeParams
    margin_px: float


def focal_scale(camera: CameraModel) -> float:
    """Return how many pixels of an image one pixel of the parameters is."""
    return float(camera.K[0, 0]) / FOCAL_PX


def no_spots() -> Spots:
    """Return no objects."""
    none = np.zeros(0)
    return Spots(np.zeros((0, 4)), none, np.zeros((0, 3)), np.zeros((0, 3)), none, none, np.zeros(0, np.int64))


def spots(rig: Rig, camera: str, cloud: Cloud, params: SpotParams) -> tuple[Points, Spots]:
    """Cluster the points of a cloud over u, v and depth in one image, and judge the clusters.

    What moves is clustered apart from what stands still. The order of points doesn't matter.
    """
    points = _projected(rig, camera, cloud, params)
    member = points.cluster >= 0
    if not member.any() or cloud.plane is None:
        return points, no_spots()
    groups = Groups.of(points.cloud.rows(member), points.cluster[member])
    margin = params.margin_px * focal_scale(rig.cameras[camera])
    whole = footprints(groups)
    depth = np.minimum.reduceat(points.depth_m[member], groups.first[:-1])
    found = Spots(
        xyxy_px=outlines(rig, camera, groups, points.uv_px[member], points.depth_m[member], margin),
        score=likeness(groups, params.shape),
        center_m=whole.center_m,
        size_lwh_m=whole.size_lwh_m,
        depth_m=depth,
        rate_mps=_rates(groups),
        num_points=np.diff(groups.first),
    )
    return points, found


def _projected(rig: Rig, camera: str, cloud: Cloud, params: SpotParams) -> Points:
    """Points in the image and beside it with their clusters."""
    model = rig.cameras[camera]
    uv, depth = project_body(rig, camera, cloud.xyz)
    size = np.array(model.size_wh, np.float64)
    low, high = -_BESIDE * size, (1 + _BESIDE) * size
    u, v = uv.T
    seen = np.flatnonzero((u > low[0]) & (u < high[0]) & (v > low[1]) & (v < high[1]))  # NaN isn't
    cloud, uv, depth = cloud.rows(seen), uv.take(seen, axis=0), depth.take(seen)
    cluster, scaled = np.full(len(uv), -1), uv / focal_scale(model)
    for part in (cloud.moves, ~cloud.moves):
        found = cluster_in_image(scaled[part], depth[part], params.cluster)
        cluster[part] = np.where(found < 0, -1, found + cluster.max(initial=-1) + 1)
    order = np.argsort(cluster, kind="stable")
    return Points(uv.take(order, axis=0), depth.take(order), cluster.take(order), cloud.rows(order))


def _rates(groups: Groups) -> Float64:
    """Change of the distance (M,) [m/s] of each group: its velocity over ground less the sensor's own."""
    cloud, result = groups.cloud, np.full(len(groups), np.nan)
    for at in range(len(groups)):
        rows = slice(int(groups.first[at]), int(groups.first[at + 1]))
        own = cloud.own_mps[rows]
        known = own[~np.isnan(own)]
        if np.isfinite(known).any():
            result[at] = median_rate(cloud.over_ground_mps[rows], cloud.period_mps[rows]) - median(known)
    return result
