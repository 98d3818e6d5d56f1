"""From one cloud and the boxes of cameras to objects."""

from dataclasses import dataclass, field

import numpy as np

from fbench.pipelines.checks import require_ranges
from fbench.pipelines.early.boxes import Placed, Shapes, View, placed, shapes
from fbench.pipelines.early.cloud import Cloud, EchoParams
from fbench.pipelines.early.density import DensityParams, clusters
from fbench.pipelines.early.existence import ExistenceParams, Witnesses, existence
from fbench.pipelines.early.groups import Counts, Groups, counted, grouped
from fbench.pipelines.early.judged import judged
from fbench.pipelines.early.scene import Scene
from fbench.pipelines.early.semantics import Labels, SemanticsParams, label_points
from fbench.pipelines.points.radar import median_rate
from fbench.replay.arrays import Array, Bool, Float64, Text
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Source


@dataclass(frozen=True)
class EarlyParams:
    """How one cloud becomes objects."""

    camera_share: float = 0.5
    """Boxes down to this share of a camera's `min_score` [0 to 1] count where the shape of their points confirms
    them."""
    echoes: EchoParams = field(default_factory=EchoParams)
    """Which standing radar echoes join the cloud."""
    semantics: SemanticsParams = field(default_factory=SemanticsParams)
    """How points take the labels of camera boxes."""
    density: DensityParams = field(default_factory=DensityParams)
    """How points are clustered."""
    existence: ExistenceParams = field(default_factory=ExistenceParams)
    """How sure it is that clusters are road users."""
    fit_points: float = 4.0
    """From so many points of LiDAR and stereo on their shape gives the box."""
    most_extent_m: float = 20.0
    """Clusters wider than this along x or y [m] that no camera sees are walls."""
    merge_m: float = 2.0
    """Of objects with centres nearer than this [m], or the centre of one in the other, the surest stays."""
    min_score: float = 0.5
    """Objects with a lower score are dropped."""

    def __post_init__(self) -> None:
        ranges = {
            "fit_points": (1.0, 1e6), "most_extent_m": (0.1, 1000.0), "merge_m": (0.0, 100.0), "min_score": (0.0, 1.0),
            "camera_share": (0.0, 1.0),
        }  # fmt: skip
        require_ranges("fusion", self, ranges)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Groups of points that may be objects (M,), and what speaks for them."""

    groups: Groups
    counts: Counts
    shape: Shapes
    label: Text
    placed: Placed
    witnesses: Witnesses
    range_rate_mps: Float64
    """(M,) median radial velocity of moving echoes [m/s], NaN without."""


def fuse(scene: Scene, params: EarlyParams) -> Boxes3D:
    """Find labelled objects with score, sources and, where radar measured it, velocity along the line of sight."""
    found = candidates(scene, params)
    score = existence(found.witnesses, params.existence)
    boxes = _boxes(scene, found, score)
    kept = _surest(boxes, score, params)
    return boxes[kept]


def candidates(scene: Scene, params: EarlyParams) -> Candidates:
    """Label, cluster and group the points of a scene, and fit a box to each group."""
    cloud = scene.cloud
    labels = label_points(scene.rig, scene.cameras, cloud, scene.plane, params.semantics)
    is_seen = labels.instance >= 0
    cluster = clusters(cloud, is_seen, params.density)
    groups = grouped(cloud, labels, cluster, params.density.weights(cloud, is_seen))
    groups = groups.select((groups.sighting >= 0) | (_extent(cloud, groups) <= params.most_extent_m))
    counts = counted(groups, cloud)
    shape = shapes(cloud, groups, counts, params.fit_points)
    by_shape, label = judged(scene, groups, shape)
    label = _labels(groups, labels, label)
    view = View(scene.rig, cloud, scene.plane, labels.sightings, scene.eye_m)
    where = placed(view, groups, shape, label, scene.lidar.size)
    witnesses = Witnesses(
        camera_score=_camera_scores(groups, labels),
        is_sure=np.array([s.is_sure for s in labels.sightings] + [False])[groups.sighting],
        overlap=where.overlap,
        height_px=groups.sums(labels.height_px[groups.rows]) / np.maximum(np.diff(groups.first), 1),
        by_shape=by_shape,
        dense=counts.dense,
        moving=counts.moving,
        has_dense=bool((cloud.source != int(Source.R)).any()),
    )
    return Candidates(groups, counts, shape, label, where, witnesses, _rates(cloud, groups, counts))


def _extent(cloud: Cloud, groups: Groups) -> Float64:
    """Larger of the extents along x and y (M,) [m]."""
    if not len(groups):
        return np.zeros(0)
    xy, first = cloud.xyz[groups.rows, :2], groups.first[:-1]
    return np.asarray((np.maximum.reduceat(xy, first) - np.minimum.reduceat(xy, first)).max(axis=1), np.float64)


def _labels(groups: Groups, labels: Labels, by_shape: Text) -> Text:
    """Labels (M,): those of cameras, else by shape."""
    names = np.array([sighting.label for sighting in labels.sightings] or [""], np.str_)
    return np.where(groups.sighting >= 0, names[groups.sighting], by_shape)


def _camera_scores(groups: Groups, labels: Labels) -> Float64:
    scores = np.array([sighting.score for sighting in labels.sightings] or [np.nan])
    return np.where(groups.sighting >= 0, scores[groups.sighting], np.nan)


def _rates(cloud: Cloud, groups: Groups, counts: Counts) -> Float64:
    """Median radial velocity (M,) [m/s] of moving echoes, NaN where fewer than two move."""
    result = np.full(len(groups), np.nan)
    for row in np.flatnonzero(counts.moving >= 2):
        points = groups.rows[groups.first[row] : groups.first[row + 1]]
        points = points[cloud.is_moving[points]]
        result[row] = median_rate(cloud.range_rate_mps[points], cloud.period_mps[points])
    return result


def _boxes(scene: Scene, found: Candidates, score: Float64) -> Boxes3D:
    center = found.placed.center_m
    bearing = np.arctan2(center[:, 1] - scene.eye_m[1], center[:, 0] - scene.eye_m[0])
    rate = found.range_rate_mps
    return Boxes3D(
        center_m=center,
        size_lwh_m=found.placed.size_lwh_m,
        yaw_rad=found.placed.yaw_rad,
        velocity_mps=np.column_stack([rate * np.cos(bearing), rate * np.sin(bearing), 0 * rate]),
        label=found.label,
        score=score,
        sources=found.counts.sources,
    )


def _surest(boxes: Boxes3D, score: Float64, params: EarlyParams) -> Array:
    """Rows of boxes that stay, by falling score; equal scores by place."""
    order = np.lexsort((*boxes.center_m.T[::-1], -score))
    order = order[score[order] >= max(params.min_score, np.finfo(np.float64).tiny)]
    same = _one_object(boxes[order], params.merge_m)
    kept: list[int] = []
    for row in range(len(order)):
        if not same[row, kept].any():
            kept.append(row)
    return order[kept]


def _one_object(boxes: Boxes3D, merge_m: float) -> Bool:
    """Tell which pairs (N, N) of boxes are one object: centres are near, or that of one lies in the other."""
    offset = boxes.center_m[None, :, :2] - boxes.center_m[:, None, :2]
    cos, sin = np.cos(boxes.yaw_rad)[:, None], np.sin(boxes.yaw_rad)[:, None]
    along = np.abs(offset[..., 0] * cos + offset[..., 1] * sin)
    across = np.abs(offset[..., 1] * cos - offset[..., 0] * sin)
    half = boxes.size_lwh_m[:, None, :2] / 2
    holds = (along <= half[..., 0]) & (across <= half[..., 1])
    near = np.hypot(offset[..., 0], offset[..., 1]) < merge_m
    return np.asarray(near | holds | holds.T, np.bool_)
