"""Early fusion in 3D: from one cloud and the boxes of cameras to objects."""

import math
from dataclasses import dataclass, field

import numpy as np

from fbench.pipelines.fusion.early.boxes import Placed, Shapes, View, judged, placed, shapes
from fbench.pipelines.fusion.early.cloud import EchoParams, FusedCloud, Scene
from fbench.pipelines.fusion.early.density import DensityParams, clusters
from fbench.pipelines.fusion.early.groups import Counts, Groups, Labels, SemanticsParams, counted, grouped, label_points
from fbench.pipelines.fusion.observations import AT_MIN_SCORE
from fbench.pipelines.params import require_ranges
from fbench.pipelines.sensors.radar.radar import median_rate
from fbench.replay.data.arrays import Array, Bool, Float64, Text
from fbench.replay.data.boxes import Boxes3D, Source

_LEAST = math.log(AT_MIN_SCORE / (1 - AT_MIN_SCORE))


@dataclass(frozen=True)
class ExistenceParams:
    """What speaks for a group of points, as logarithms of odds that add up: score = 1 / (1 + exp(-sum)).

    The shape of LiDAR points has odds of its own, by the LiDAR's model.
    """

    camera: float = 1.3
    """Of a box that has its detector's least score, and whose projected 3D box covers half of it."""
    camera_score: float = 1.4
    """Times how far the logarithm of the odds of the box's score is above that of the least score."""
    overlap: float = 0.8
    """Times how far the IoU of the projected 3D box with the camera's is above 0.5."""
    camera_shape: float = 1.1
    """Times the logarithm of the odds by shape, where a camera's box holds the group."""
    camera_shapeless: float = -1.6
    """Of a group in a camera's box with too few points to have a shape."""
    camera_points: float = 0.2
    """Times the logarithm of the number of points and moving echoes, where a camera's box holds the group."""
    alone: float = 0.3
    """Of a group that no camera's box holds, beside what its shape says."""
    shapeless: float = -2.3
    """Of such a group with too few points to have a shape, instead of that."""
    unconfirmed: float = -1.2
    """Of such a group where LiDAR or stereo deliver, and ought to have seen more."""
    unseen: float = -1.8
    """Of a group that a working camera looks at from near and doesn't report."""
    unseen_px: float = 80.0
    """Where a car looks n pixels high, 1 - exp(-n / this) of that counts."""
    moving: float = 0.8
    """Times the logarithm of the number of moving echoes, where no camera's box holds the group."""
    most_odds: float = 4.0
    """Largest logarithm of odds, and the negative of the smallest, that a shape can have."""

    def __post_init__(self) -> None:
        names = (
            "camera", "camera_score", "overlap", "camera_shape", "camera_shapeless", "camera_points", "alone",
            "shapeless", "unconfirmed", "unseen", "moving",
        )  # fmt: skip
        require_ranges("fusion.existence", self, {"most_odds": (0.0, 30.0), "unseen_px": (0.1, 1e5)})
        require_ranges("fusion.existence", self, dict.fromkeys(names, (-1000.0, 1000.0)))


@dataclass(frozen=True, eq=False)
class Witnesses:
    """What speaks for groups (M,)."""

    camera_score: Float64
    """Of the camera's box, NaN without."""
    is_sure: Bool
    """Whether the camera alone would report it."""
    overlap: Float64
    """IoU of the projected 3D box with the camera's, NaN without."""
    height_px: Float64
    """How high a car there looks in a working camera [px], 0 out of view."""
    by_shape: Float64
    """Probability of a road user by the shape of LiDAR and stereo points, NaN where they are too few."""
    dense: Float64
    """Points of LiDAR and stereo."""
    moving: Float64
    """Moving echoes."""
    has_dense: bool
    """Whether LiDAR or stereo delivered anything in this frame."""


def existence(seen: Witnesses, params: ExistenceParams) -> Float64:
    """Probability (M,) that groups are road users."""
    by_shape, has_shape = _odds(seen.by_shape, params.most_odds), np.isfinite(seen.by_shape)
    with_camera = (
        params.camera
        + params.camera_score * (_odds(seen.camera_score, params.most_odds) - _LEAST)
        + params.overlap * (seen.overlap - 0.5)
        + np.where(has_shape, params.camera_shape * by_shape, params.camera_shapeless)
        + params.camera_points * np.log1p(seen.dense + seen.moving)
    )
    alone = (
        np.where(has_shape, params.alone + by_shape, params.shapeless + params.unconfirmed * seen.has_dense)
        + params.unseen * (1 - np.exp(-seen.height_px / params.unseen_px))
        + params.moving * np.log1p(seen.moving)
    )
    confirmed = np.where(seen.is_sure, with_camera, np.where(has_shape, np.fmax(with_camera, alone), alone))
    total = np.where(np.isfinite(seen.camera_score), confirmed, alone)
    return np.asarray(1 / (1 + np.exp(-np.clip(total, -30.0, 30.0))), np.float64)


def _odds(probability: Float64, most: float) -> Float64:
    """Logarithm of odds (M,), NaN where the probability is."""
    safe = np.clip(probability, 1e-9, 1 - 1e-9)
    return np.asarray(np.clip(np.log(safe / (1 - safe)), -most, most), np.float64)


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


def _extent(cloud: FusedCloud, groups: Groups) -> Float64:
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


def _rates(cloud: FusedCloud, groups: Groups, counts: Counts) -> Float64:
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
