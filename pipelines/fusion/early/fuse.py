"""Early fusion in 3D: from one cloud and the boxes of cameras to objects."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from fbench.pipelines.fusion.early import groups as grouping
from fbench.pipelines.fusion.early.boxes import classify_shapes, fit_shapes, place_boxes
from fbench.pipelines.fusion.early.cloud import EchoParams, FusedCloud, Scene
from fbench.pipelines.fusion.early.density import DensityParams, cluster_cloud
from fbench.pipelines.fusion.early.groups import Counts, Groups, Observed, SemanticsParams
from fbench.pipelines.fusion.observations import AT_MIN_SCORE, are_one
from fbench.pipelines.fusion.reliability import saturate
from fbench.pipelines.sensors.odds import log_odds, probability_of
from fbench.pipelines.sensors.radar.stage import median_rate
from fbench.pipelines.sensors.rows import suppress
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.arrays import Float64, Int64, Text
from fbench.replay.data.boxes import Boxes3D, Source

_LEAST = math.log(AT_MIN_SCORE / (1 - AT_MIN_SCORE))


@dataclass(frozen=True)
class ExistenceParams(CheckedParams, prefix="fusion.existence"):
    """Evidence for a group of points, as logarithms of odds that add up: score = 1 / (1 + exp(-sum)). The shape of
    LiDAR points has odds of its own, by the LiDAR's model.
    """

    camera: float = in_range(1.3, -1000, 1000)
    """Of a box that has its detector's least score, and whose projected 3D box covers half of it."""
    camera_score: float = in_range(1.4, -1000, 1000)
    """Times how far the logarithm of the odds of the box's score is above that of the least score."""
    overlap: float = in_range(0.8, -1000, 1000)
    """Times how far the IoU of the projected 3D box with the camera's is above 0.5."""
    camera_shape: float = in_range(1.1, -1000, 1000)
    """Times the logarithm of the odds by shape, where a camera's box holds the group."""
    camera_shapeless: float = in_range(-1.6, -1000, 1000)
    """Of a group in a camera's box with too few points to have a shape."""
    camera_points: float = in_range(0.2, -1000, 1000)
    """Times the logarithm of the number of points and moving echoes, where a camera's box holds the group."""
    alone: float = in_range(0.3, -1000, 1000)  # Of a group that no camera's box holds, beside what its shape says.
    shapeless: float = in_range(-2.3, -1000, 1000)
    """Of such a group with too few points to have a shape, instead of that."""
    unconfirmed: float = in_range(-1.2, -1000, 1000)
    """Of such a group where LiDAR or stereo deliver, and ought to have seen more."""
    unseen: float = in_range(-1.8, -1000, 1000)
    """Of a group that a working camera looks at from near and doesn't report."""
    unseen_px: float = in_range(80.0, 0.1, 1e5)  # Where a car looks n pixels high, 1 - exp(-n / this) of that counts.
    moving: float = in_range(0.8, -1000, 1000)
    """Times the logarithm of the number of moving echoes, where no camera's box holds the group."""
    most_odds: float = in_range(4.0, 0, 30)
    """Largest logarithm of odds, and the negative of the smallest, that a shape can have."""


@dataclass(frozen=True)
class EarlyParams(CheckedParams, prefix="fusion"):
    """How one cloud becomes objects."""

    camera_share: float = in_range(0.5, 0, 1)
    """Boxes down to this share of a camera's `min_score` [0 to 1] count where the shape of their points confirms
    them."""
    echoes: EchoParams = field(default_factory=EchoParams)  # Which standing radar echoes join the cloud.
    semantics: SemanticsParams = field(default_factory=SemanticsParams)  # How points take the labels of camera boxes.
    density: DensityParams = field(default_factory=DensityParams)  # How points are clustered.
    existence: ExistenceParams = field(default_factory=ExistenceParams)  # How sure it is that clusters are road users.
    echo_shapes: bool = False
    """Whether shapes of radar echoes count beside a LiDAR that delivers, as they do without one. In space they don't:
    echoes place vehicles too poorly."""
    fit_points: float = in_range(4.0, 1, 1e6)  # From so many points of LiDAR and stereo on their shape gives the box.
    most_extent_m: float = in_range(20.0, 0.1, 1000)
    """Clusters wider than this along x or y [m] that no camera sees are walls."""
    merge_m: float = in_range(2.0, 0, 100)
    """Of objects with centers nearer than this [m], or the center of one in the other, the surest stays."""
    min_score: float = in_range(0.5, 0, 1)  # Objects with a lower score are dropped.


@dataclass(frozen=True, eq=False)
class Candidates:
    """M groups of points, the boxes around them, and how likely each is a road user."""

    seen: Observed
    groups: Groups
    counts: Counts
    boxes: Boxes3D  # (M) with label, score, sources and, where radar measured it, velocity along the line of sight
    label: Text  # (M,)
    score: Float64  # (M,) 0 to 1
    alone: Float64  # (M,) the same where no camera's box held it


def fuse(scene: Scene, params: EarlyParams) -> Boxes3D:
    """Find labeled objects with score, sources and, where radar measured it, velocity along the line of sight. Of
    objects in one place the surest stays. They come by falling score; equal scores by place.
    """
    found = find_candidates(scene, params)
    return found.boxes[choose(found, params)]


def choose(found: Candidates, params: EarlyParams) -> Int64:
    """Rows (K,) of candidates that are likely enough and surer than others in their place, by falling score."""
    order = np.lexsort((*found.boxes.center_m.T[::-1], -found.score))
    order = order[found.score[order] >= max(params.min_score, np.finfo(np.float64).tiny)]
    return order[suppress(are_one(found.boxes[order], params.merge_m))]


def find_candidates(scene: Scene, params: EarlyParams) -> Candidates:
    """Give points the labels of camera boxes, cluster them and fit a box to each group, whose probability to be a road
    user follows from its shape, its points and the camera.
    """
    cloud = scene.cloud
    seen = grouping.label_points(scene.rig, scene.cameras, cloud, scene.plane, params.semantics)
    is_seen = seen.instance >= 0
    cluster = cluster_cloud(cloud, is_seen, params.density)
    groups = grouping.group_points(cloud, seen, cluster, params.density.weights(cloud, is_seen))
    if len(groups):  # what no camera sees and is wide are walls
        xy, first = cloud.xyz[groups.rows, :2], groups.first[:-1]
        extent = (np.maximum.reduceat(xy, first) - np.minimum.reduceat(xy, first)).max(axis=1)
        groups = groups.select((groups.observation >= 0) | (extent <= params.most_extent_m))
    counts = grouping.count_points(groups, cloud)
    shape = fit_shapes(cloud, groups, counts, params.fit_points)
    by_shape, label = classify_shapes(scene, groups, shape, params.fit_points, params.echo_shapes)
    names = np.array([one.label for one in seen.observations] or [""], np.str_)
    label = np.where(groups.observation >= 0, names[groups.observation], label)
    boxes, overlap = place_boxes(scene, seen, groups, shape, label)
    score, alone = _existence(scene, seen, groups, counts, by_shape, overlap, params.existence)
    bearing = np.arctan2(boxes.center_m[:, 1] - scene.eye_m[1], boxes.center_m[:, 0] - scene.eye_m[0])
    rate = _rates(cloud, groups, counts)
    found = replace(
        boxes,
        velocity_mps=np.column_stack([rate * np.cos(bearing), rate * np.sin(bearing), 0 * rate]),
        label=label,
        score=score,
        sources=counts.sources,
    )
    return Candidates(seen, groups, counts, found, label, score, alone)


def _existence(
    scene: Scene,
    seen: Observed,
    groups: Groups,
    counts: Counts,
    by_shape: Float64,
    overlap: Float64,
    params: ExistenceParams,
) -> tuple[Float64, Float64]:
    """Probability (M,) of groups, given that by shape (M,) and the boxes' IoU (M,), NaN where there is none; and that
    without the cameras' boxes.
    """
    camera_score = np.append(seen.joint.score, np.nan)[groups.observation]
    is_sure = np.append(seen.joint.is_sure, False)[groups.observation]
    height_px = groups.sums(seen.height_px[groups.rows]) / np.maximum(np.diff(groups.first), 1)
    has_dense = bool((scene.cloud.source != int(Source.R)).any())
    lidar, stereo = ((counts.sources & int(bit)) > 0 for bit in (Source.L, Source.S))
    only_stereo = stereo & ~lidar & bool((scene.cloud.source == int(Source.L)).any())
    shape_odds, has_shape = _limit_odds(by_shape, params.most_odds), np.isfinite(by_shape)
    with_camera = (
        params.camera
        + params.camera_score * (_limit_odds(camera_score, params.most_odds) - _LEAST)
        + params.overlap * (overlap - 0.5)
        + np.where(has_shape, params.camera_shape * shape_odds, params.camera_shapeless)
        + params.camera_points * np.log1p(counts.dense + counts.moving)
    )
    alone = (
        np.where(has_shape, params.alone + shape_odds, params.shapeless + params.unconfirmed * has_dense)
        + params.unseen * saturate(height_px, params.unseen_px)
        + params.moving * np.log1p(counts.moving)
    )
    confirmed = np.where(is_sure, with_camera, np.where(has_shape, np.fmax(with_camera, alone), alone))
    total = np.where(np.isfinite(camera_score), confirmed, alone)
    for odds in (total, alone):
        odds[only_stereo & (counts.moving == 0)] = -np.inf  # LiDARs see whatever stereo sees and isn't noise
    return probability_of(np.clip(total, -30.0, 30.0)), probability_of(np.clip(alone, -30.0, 30.0))


def _limit_odds(probability: Float64, most: float) -> Float64:
    return np.asarray(np.clip(log_odds(probability, 1e-9), -most, most), np.float64)


def _rates(cloud: FusedCloud, groups: Groups, counts: Counts) -> Float64:
    """Median radial velocity (M,) [m/s] of moving echoes, NaN where fewer than two move."""
    result = np.full(len(groups), np.nan)
    for row in np.flatnonzero(counts.moving >= 2):
        points = groups.rows[groups.first[row] : groups.first[row + 1]]
        points = points[cloud.is_moving[points]]
        result[row] = median_rate(cloud.range_rate_mps[points], cloud.period_mps[points])
    return result
