"""Early fusion in images: objects of one cloud, outlined in each image that sees them, and what only cameras see."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fbench.pipelines.fusion.early.cloud import FusedCloud, Scene
from fbench.pipelines.fusion.early.fuse import Candidates, EarlyParams, choose, find_candidates
from fbench.pipelines.fusion.early.groups import Groups
from fbench.pipelines.fusion.observations import AT_MIN_SCORE, CameraObservation, inside_shares
from fbench.pipelines.fusion.reliability import CameraReliability, saturate
from fbench.pipelines.sensors.image.objects import focal_scale, outlines
from fbench.pipelines.sensors.image.stage import Rays
from fbench.pipelines.sensors.odds import log_odds, probability_of
from fbench.pipelines.sensors.points.grid import median
from fbench.pipelines.sensors.radar.stage import median_rate
from fbench.pipelines.sensors.rows import Rows, suppress
from fbench.replay.contracts.params import in_range
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.data.boxes import Boxes2D, Source, concatenate
from fbench.replay.geometry.camera import in_image, project_body, project_boxes
from fbench.replay.geometry.iou import iou_2d

_FEWEST_ECHOES = 6  # So many echoes of a radar that shows shapes outline what they are of
_PART, _REACH = 0.6, 1.8
"""What lies by this share in an object's box, and at most so many standard deviations of the camera's distance from it,
is a part of it."""
_SAME = 0.5  # Of two objects with a larger IoU the farther one would be hidden


@dataclass(frozen=True)
class EarlyImageParams(EarlyParams, prefix="fusion"):
    """How one cloud becomes objects in images."""

    camera_share: float = in_range(0.25, 0, 1)  # Boxes down to this share of a camera's `min_score` [0 to 1] count.
    echo_shapes: bool = True
    """Whether shapes of radar echoes count beside a LiDAR that delivers, as they do without one."""
    outline: Literal["points", "boxes"] | None = None
    """By what objects are outlined that no camera shows: their points, or their boxes in space; none: points in
    simulated logs, boxes in others, as few beams outline less than a vehicle."""
    margin_px: float = in_range(2.0, 0, 1e4)
    """By so much outlines around points are wider than these [px], at a focal length of 400 px."""
    measured_share: float = in_range(0.1, 0, 1)
    """By so much the outline of a camera that is sure is drawn toward that of the points [0 to 1]."""
    weak_measured_share: float = in_range(1.0, 0, 1)  # The same where the camera is least sure; in proportion between.
    unseen_by_rays: float = in_range(0.25, 0, 1)
    """Factor on the odds of an object that only a camera sees, where the rays of LiDARs go on behind it."""
    through: float = in_range(0.6, 0, 1)
    """Share of the rays through the middle of a box that go on behind the object, from which on it counts as unseen."""
    unseen_by_camera: float = in_range(0.02, 0, 1)
    """Factor on the odds of an object that the camera of an image ought to see and doesn't, beside `existence.unseen`;
    nearer to 1 the less cameras saw lately of what LiDAR and radar see, as by night."""
    camera_size_px: float = in_range(40.0, 0.1, 1e5)
    """Of objects whose outline has an area of n x n pixels a camera that sees well sees the share 1 - exp(-n / this).
    """
    most_unseen: float = in_range(1.0, 0, 1000)
    """Largest logarithm of the odds of what a camera surely ought to see and doesn't, before `unseen_by_camera`; twice
    as large where it ought to see half of such objects."""
    least_alike: float = in_range(0.25, 0, 1)
    """IoU of a box that its camera isn't sure of with the outline of an object's points, below which it doesn't show
    that object [0 to 1]."""
    least_inside: float = in_range(0.3, 0, 1)
    """Objects with less than this share of their points in an image have an outline there only by a camera's box."""


@dataclass(frozen=True, eq=False)
class Groups2D:
    """What is known of M groups of points, and which group each of S observations of cameras shows."""

    found: Candidates
    kept: Bool  # (M,) whether early fusion in 3D reports it
    distance_m: Float64  # (M,) from the body's origin to the middle [m]
    near_m: Float64  # (M,) from the body's origin to the nearest point [m]
    rate_mps: Float64  # (M,) change of the distance [m/s], positive when receding; NaN where unknown
    shown: Int64  # (S,) the group of each observation, -1: none


class EarlyImageFusion:
    """Outlines the objects of one cloud in images, and learns from it how well the cameras see."""

    def __init__(self, cameras: Sequence[str], params: EarlyImageParams) -> None:
        self._cameras, self._params, self._reliability = cameras, params, CameraReliability()

    def reset(self) -> None:
        """Forget how well the cameras see."""
        self._reliability.reset()

    def fuse(self, scene: Scene, rays: Mapping[str, Rays]) -> Boxes2D:
        """Find the objects of one frame, see `fuse_in_images`."""
        found = fuse_in_images(scene, self._cameras, rays, self._params, self._reliability.share)
        self._reliability.learn(found[np.isin(found.camera, sorted(scene.cameras))])
        return found


def fuse_in_images(
    scene: Scene, cameras: Sequence[str], rays: Mapping[str, Rays], params: EarlyImageParams, camera_share: float = 0.9
) -> Boxes2D:
    """Find labeled objects in the images of `cameras`, with score, sources, distance and range rate, by camera and
    falling score. `rays` are those of LiDARs in the images of cameras that work, and `camera_share` is the share of
    objects that cameras see at present.

    Objects are those that early fusion finds in space, and what a camera is sure of. An object has its class and
    outline from the camera that sees it, drawn toward that of its points, the more the less the camera is sure, and all
    the way where it isn't sure and sees it elsewhere. Without a camera it is outlined by its points, and so it is where
    an unsure box is hardly there at all. Of objects in one place of an image the surest stays.
    """
    found = find_candidates(scene, params)
    kept = np.zeros(len(found.groups), np.bool_)
    kept[choose(found, params)] = True
    distance = np.sqrt((found.boxes.center_m**2).sum(axis=1))
    reach = np.sqrt((scene.cloud.xyz[found.groups.rows] ** 2).sum(axis=1))
    near = np.minimum.reduceat(reach, found.groups.first[:-1]) if len(kept) else distance
    groups = Groups2D(
        found, kept, distance, near, range_rates(scene.cloud, found.groups), match_groups(found, scene.cloud)
    )
    return concatenate([
        _outline(scene, groups, name, rays.get(name), params, camera_share if name in scene.cameras else 0.0)
        for name in cameras
    ])  # fmt: skip


def match_groups(found: Candidates, cloud: FusedCloud) -> Int64:
    """Group (S,) that each observation shows: that which was made of what shows the same object, else that with most of
    its points, if no other observation of its camera has more of those; -1: none.
    """
    seen, groups = found.seen, found.groups
    made, number = np.full(len(seen.observations), -1), np.full(len(cloud), -1)
    number[groups.rows] = groups.number
    own = np.flatnonzero(groups.observation >= 0)
    made[seen.joint.number[groups.observation[own]]] = own
    result = made[seen.joint.number]
    taken = {(one.camera, int(at)) for one, at in zip(seen.observations, result, strict=True) if at >= 0}
    wanted = []
    for at in np.flatnonzero((result < 0) & ~seen.is_weak).tolist():
        rows = number[seen.taken[at]]
        if (rows >= 0).any():
            counts = np.bincount(rows[rows >= 0])
            wanted.append((-int(counts.max()), at, int(counts.argmax())))
    for _, at, row in sorted(wanted):
        place = seen.observations[at].camera, row
        if place not in taken:
            result[at] = row
            taken.add(place)
    return result


def range_rates(cloud: FusedCloud, groups: Groups) -> Float64:
    """Change of the distance (M,) [m/s] of groups, by their moving echoes where there are two, else by all; NaN without
    an echo whose radar knows how it moves itself.
    """
    result, is_echo = np.full(len(groups), np.nan), np.isfinite(cloud.range_rate_mps + cloud.own_mps)
    for row in np.unique(groups.number[is_echo[groups.rows]]).tolist():
        rows = groups.rows[groups.first[row] : groups.first[row + 1]]
        rows = rows[is_echo[rows]]
        moving = rows[cloud.is_moving[rows]]
        rows = moving if len(moving) >= 2 else rows
        result[row] = median_rate(cloud.range_rate_mps[rows], cloud.period_mps[rows]) - median(cloud.own_mps[rows])
    return result


def outline_groups(scene: Scene, found: Candidates, camera: str, params: EarlyImageParams) -> Float64:
    """Outlines (M, 4) [px] of groups in one image, NaN where nothing of one is in it: of their points of LiDAR and
    stereo where these are to show outlines and there are enough for a shape, else of their boxes in space.
    """
    groups, cloud = found.groups, scene.cloud
    result, _ = project_boxes(scene.rig, camera, found.boxes)
    if params.outline == "boxes":
        return result
    dense = cloud.source[groups.rows] != int(Source.R)
    has_shape = np.bincount(groups.number[dense], minlength=len(groups)) >= params.fit_points
    by_echoes = ~has_shape & (scene.tall_echoes is not None) & (groups.sums(~dense) >= _FEWEST_ECHOES)
    result[has_shape | by_echoes] = np.nan
    uv, _ = project_body(scene.rig, camera, cloud.xyz[groups.rows])
    is_used = ((dense & has_shape[groups.number]) | (~dense & by_echoes[groups.number])) & np.isfinite(uv).all(axis=1)
    rows, shown = groups.rows[is_used], np.unique(groups.number[is_used])
    if len(rows):
        first = np.append(np.searchsorted(groups.number[is_used], shown), len(rows))
        margin = params.margin_px * focal_scale(scene.rig.cameras[camera])
        result[shown] = outlines(scene.rig, camera, scene.plane, cloud.xyz[rows], first, margin)
    inside = groups.sums(dense & in_image(scene.rig.cameras[camera], uv))
    result[has_shape & (inside < params.least_inside * groups.sums(dense))] = np.nan
    return result


@dataclass(frozen=True, eq=False)
class Shown(Rows):
    """N objects in one image."""

    xyxy_px: Float64  # (N, 4) left, top, right, bottom [px]
    label: Text  # (N,)
    score: Float64  # (N,) 0 to 1
    distance_m: Float64  # (N,) from the body's origin to the middle [m]
    near_m: Float64  # (N,) from the body's origin to the nearest point [m]; NaN where no points show it
    rate_mps: Float64  # (N,) change of the distance [m/s], positive when receding; NaN where unknown
    sources: Array  # (N,) uint8 bits of `Source`


def _outline(
    scene: Scene, groups: Groups2D, camera: str, rays: Rays | None, params: EarlyImageParams, camera_share: float
) -> Boxes2D:
    around = outline_groups(scene, groups.found, camera, params)
    found = groups.found
    every, kept = found.seen.observations, np.append(groups.kept, False)  # the last: of no group
    rows = np.flatnonzero([one.camera == camera for one in every])
    unseen = groups.kept & np.isfinite(around).all(axis=1)
    able = rows[~found.seen.is_weak[rows]]
    shown = groups.shown.copy()
    shown[able] = _take_over([every[at] for at in able], groups.shown[able], kept, around, unseen)
    shown = shown[rows]
    is_sure = np.array([every[at].is_sure for at in rows], np.bool_)
    # A post in a chance box of a truck is no truck.
    apart = ~is_sure & (_agreement([every[at] for at in rows], shown, around) < params.least_alike)
    likely, sources = found.score.copy(), found.counts.sources.copy()
    likely[shown[apart]] = found.alone[shown[apart]]
    sources[shown[apart]] &= ~np.uint8(Source.C)
    shown[apart] = -1
    unseen &= likely >= params.min_score
    is_used = is_sure | kept[shown]
    rows, shown, is_sure = rows[is_used], shown[is_used], is_sure[is_used]
    by_camera = _take_cameras(scene, groups, [every[at] for at in rows], shown, around, rays, params)
    unseen[shown[shown >= 0]] = False
    sides = around[unseen, 2:] - around[unseen, :2]
    looked = camera_share * saturate(np.sqrt(sides.prod(axis=1)), params.camera_size_px)
    doubt = np.log(np.maximum(1 - (1 - params.unseen_by_camera) * looked, 1e-9))
    odds = np.minimum(log_odds(likely[unseen], 1e-9), params.most_unseen / np.maximum(looked, 1e-9))
    score = probability_of(odds + doubt)
    by_points = Shown(
        around[unseen], found.label[unseen], score, groups.distance_m[unseen], groups.near_m[unseen],
        groups.rate_mps[unseen], sources[unseen],
    )  # fmt: skip
    result, is_whole = Shown.join([by_camera, by_points]), is_sure & (shown >= 0)
    std = np.array([every[at].std for at in rows[is_whole]], np.float64)
    is_part = _find_parts(result, by_camera[is_whole], std) & ~np.append(is_sure, np.zeros(len(by_points), np.bool_))
    result = result[~is_part]
    result = result[np.lexsort((*result.xyxy_px.T[::-1], -result.score))]
    result = result[result.score >= params.min_score]
    result = result[suppress(iou_2d(result.xyxy_px, result.xyxy_px) > _SAME)]
    return Boxes2D(
        camera=np.full(len(result), camera),
        xyxy_px=result.xyxy_px,
        label=result.label,
        score=result.score,
        distance_m=result.distance_m,
        range_rate_mps=result.rate_mps,
        sources=result.sources,
    )


def _agreement(seen: Sequence[CameraObservation], group: Int64, around: Float64) -> Float64:
    """How far boxes (N,) of one camera show the groups that they took, 0 to 1: the share of the width of the group's
    outline that is in the box, times the IoU of their heights. Of what is partly hidden points show less of the width
    than the box. NaN without a group, or an outline of it.
    """
    box = np.array([one.xyxy_px for one in seen], np.float64).reshape(-1, 4)
    outline = np.concatenate([around, np.full((1, 4), np.nan)])[group]
    common = np.minimum(box[:, 2:], outline[:, 2:]) - np.maximum(box[:, :2], outline[:, :2])
    width, height = np.maximum(common, 0.0).T
    either = np.maximum(box[:, 3], outline[:, 3]) - np.minimum(box[:, 1], outline[:, 1])
    share = width / np.maximum(outline[:, 2] - outline[:, 0], 1e-9)
    return np.asarray(share * height / np.maximum(either, 1e-9), np.float64)


def _find_parts(objects: Shown, whole: Shown, std: Float64) -> Bool:
    """Which objects (N,) lie in what a sure camera and other sensors show (M) and are about as far away, given the
    standard deviations (M,) of the logarithms of distances that the camera guesses.
    """
    share = inside_shares(objects.xyxy_px, whole.xyxy_px)
    off = np.abs(np.log(np.maximum(objects.near_m[:, None], 0.1) / np.maximum(whole.near_m, 0.1)))
    return np.asarray(((share > _PART) & (off < _REACH * std)).any(axis=1), np.bool_)


def _take_over(seen: Sequence[CameraObservation], group: Int64, kept: Bool, around: Float64, is_free: Bool) -> Int64:
    """Group (N,) that each box of one camera shows. One whose own group isn't kept, because a surer one is in its
    place, shows that one where their outlines agree, the most alike pairs first.
    """
    result, free = group.copy(), np.flatnonzero(is_free)
    free = free[~np.isin(free, group)]
    box = np.array([one.xyxy_px for one in seen], np.float64).reshape(-1, 4)
    overlap = iou_2d(box, around[free])
    overlap[kept[group]] = 0.0
    for at in np.argsort(-overlap, axis=None, kind="stable").tolist():
        row, column = divmod(at, max(len(free), 1))
        if overlap[row, column] <= _SAME:
            break
        result[row], overlap[row], overlap[:, column] = free[column], 0.0, 0.0
    return result


def _take_cameras(
    scene: Scene,
    groups: Groups2D,
    seen: Sequence[CameraObservation],
    group: Int64,
    around: Float64,
    rays: Rays | None,
    params: EarlyImageParams,
) -> Shown:
    """What one camera sees (N), where it shows groups (N,), -1: none, with the outlines (M, 4) `around` all of them."""
    box = np.array([one.xyxy_px for one in seen], np.float64).reshape(-1, 4)
    score = np.array([one.score for one in seen], np.float64)
    alone, likely = np.where([one.is_sure for one in seen], score, 0.0), np.append(groups.found.score, 0.0)[group]
    by_lidar = np.append(groups.found.counts.sources & int(Source.L), 0)[group] > 0
    for at in np.flatnonzero(~by_lidar).tolist():
        if rays is not None and _is_seen_through(scene, seen[at], rays, params.through):
            doubt = np.log(max(params.unseen_by_rays, 1e-9))
            alone[at], likely[at] = (probability_of(log_odds(p, 1e-9) + doubt) for p in (alone[at], likely[at]))
    drawn = np.append(groups.kept, False)[group]
    sure = np.minimum(score / AT_MIN_SCORE, 1.0)
    share = np.where(drawn, sure * params.measured_share + (1 - sure) * params.weak_measured_share, 0.0)
    target = np.concatenate([around, np.zeros((1, 4))])[group]
    share[drawn & (sure < 1) & (_agreement(seen, group, around) <= _SAME)] = 1.0  # between two places is neither
    moved = box + share[:, None] * (target - box)
    guess = np.array([_distance_m(scene, one) for one in seen], np.float64)
    return Shown(
        np.where(np.isfinite(moved), moved, box),
        np.array([one.label for one in seen], np.str_),
        np.maximum(alone, likely),
        np.where(group >= 0, np.append(groups.distance_m, 0.0)[group], guess),
        np.append(groups.near_m, np.nan)[group],
        np.append(groups.rate_mps, np.nan)[group],
        np.append(groups.found.counts.sources, np.uint8(Source.C))[group] | np.uint8(Source.C),
    )


def _place(scene: Scene, one: CameraObservation, distance_m: float) -> Float64:
    """Place (3,) so far from a camera [m] in the direction of its box, on the ground or as high as the camera."""
    xy = one.eye_m[:2] + distance_m * np.array([np.cos(one.bearing_rad), np.sin(one.bearing_rad)])
    z = one.eye_m[2] if scene.plane is None else scene.plane.z_m(xy[None])[0] + one.size_lwh_m[2] / 2
    return np.array([*xy, z])


def _distance_m(scene: Scene, one: CameraObservation) -> float:
    """Distance from the body's origin [m] that a camera guesses."""
    return float(np.sqrt((_place(scene, one, one.near_m + one.depth_m) ** 2).sum()))


def _is_seen_through(scene: Scene, one: CameraObservation, rays: Rays, share: float) -> bool:
    """Whether rays go on behind what a camera sees, wherever it may be."""
    depth = float(project_body(scene.rig, one.camera, _place(scene, one, one.near_m)[None])[1][0])
    return rays.go_through(one.xyxy_px, depth, one.std, share)
