"""Boxes of groups of points: rectangles where their shape is clear, else typical objects of their class."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fbench.pipelines.fusion.early.cloud import FusedCloud, Scene
from fbench.pipelines.fusion.early.groups import Counts, Groups, Observed
from fbench.pipelines.fusion.observations import outline_overlaps
from fbench.pipelines.fusion.sizes import LONG_M, SIZES
from fbench.pipelines.sensors.image import objects as image
from fbench.pipelines.sensors.image.objects import Cloud, score_groups
from fbench.pipelines.sensors.image.params import RadarImageParams
from fbench.pipelines.sensors.lidar.classification import Seen, Standing, classify
from fbench.pipelines.sensors.points.vehicle import HEADINGS_RAD, NEAR_M, complete_known, fit_rectangles, half_turn
from fbench.replay.data.arrays import Bool, Float64, Int64, Text
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.geometry.transforms import wrap_angle

_SIDE = 1.25  # An edge is a side where it is so many times longer than the object is wide
_WIDEST = 1.6  # So many times as wide as typical an object may be at most
_TALLEST_M = 4.5
_RAY_PENALTY = 0.05  # By so much a guess along the line of sight must cover a camera's box better than one by shape


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes of the points of groups (M,)."""

    rectangles: Float64
    """(M, 6) as `fit_rectangles` gives them, around LiDAR and stereo where there are enough points of them."""
    by_shape: Bool  # (M,) whether there were
    top_m: Float64  # (M,) height of the highest LiDAR point above the ground [m], 0 without
    bottom_m: Float64  # (M,) height of the lowest [m]


def fit_shapes(cloud: FusedCloud, groups: Groups, counts: Counts, least: float) -> Shapes:
    """Fit rectangles: around points of LiDAR where a group has `least` of them, else of LiDAR and stereo, else all."""
    by_shape = counts.dense >= least
    used = outline_points(cloud, groups, least) | ~by_shape[groups.number]
    rows, number = groups.rows[used], groups.number[used]
    first = np.searchsorted(number, np.arange(len(groups) + 1))
    rectangles = fit_rectangles(np.ascontiguousarray(cloud.xyz[rows, :2]), first, HEADINGS_RAD, NEAR_M)
    if not len(rows):
        return Shapes(rectangles, by_shape, np.zeros(0), np.zeros(0))
    top, bottom = (reduce.reduceat(cloud.height_m[rows], first[:-1]) for reduce in (np.maximum, np.minimum))
    return Shapes(rectangles, by_shape, np.where(by_shape, top, 0.0), np.where(by_shape, bottom, 0.0))


def outline_points(cloud: FusedCloud, groups: Groups, least: float) -> Bool:
    """Which points (P,) show the shapes of groups: those of LiDAR where a group has `least` of them, because errors of
    depth widen what stereo sees, else those of both.
    """
    source = cloud.source[groups.rows]
    exact = groups.sums(source == int(Source.L)) >= least
    return np.asarray((source == int(Source.L)) | ((source == int(Source.S)) & ~exact[groups.number]), np.bool_)


def place_boxes(scene: Scene, seen: Observed, groups: Groups, shape: Shapes, label: Text) -> tuple[Boxes3D, Float64]:
    """Complete what is seen of groups to objects of their label's typical size.

    Which of the edges that are seen are sides follows from their lengths only where one is long enough. For what a
    camera sees there are four guesses: either edge of the rectangle may be the side, and either heading that looks as
    wide as the camera's box, with the object put behind its near side along the line of sight. The one that covers the
    camera's box best is taken. Also returns the IoU (M,) of the projected boxes with the camera's, NaN without.
    """
    # What a camera takes for a truck may be as low as a van.
    car = scene.shapes.size
    typical = {name: SIZES[name].lwh_m for name in SIZES} | {"car": (car.length_m, car.width_m, car.height_m)}
    lwh = np.array([typical[str(name)] for name in label], np.float64).reshape(-1, 3)
    for row in np.flatnonzero((groups.observation >= 0) & (label != "car")).tolist():
        lwh[row] = seen.observations[groups.observation[row]].size_lwh_m
    lwh[:, 2] = np.maximum(lwh[:, 2], np.minimum(shape.top_m, _TALLEST_M))
    by_ray = np.zeros((len(groups), 2, 5))
    for row in np.flatnonzero((groups.observation >= 0) | ~shape.by_shape).tolist():
        by_ray[row] = _guess_along_ray(scene, seen, groups, row, lwh[row, :2])
    by_shape = []
    extent = shape.rectangles[:, [2, 4]] - shape.rectangles[:, [1, 3]]
    longer_is_side = extent.max(axis=1) > _SIDE * lwh[:, 1]
    for swapped in (False, True):  # True: the less likely edge is the side
        along_first = (extent[:, 0] > extent[:, 1]) == (longer_is_side != swapped)
        whole = complete_known(shape.rectangles, along_first, scene.eye_m, lwh[:, :2])
        by_shape.append(np.column_stack([whole.center_m, whole.size_lw_m, whole.yaw_rad]))
    table = np.concatenate([np.stack(by_shape, axis=1), by_ray], axis=1)
    z = _middle_z(scene, groups, table[:, :, :2], lwh[:, 2])
    overlap = _overlaps(scene, seen, groups, table, z, lwh[:, 2])
    impossible = ~shape.by_shape[:, None] | (table[:, :2, 3] > _WIDEST * lwh[:, 1:2])
    penalty = np.column_stack([np.where(impossible, np.inf, 0.0), np.full((len(groups), 2), _RAY_PENALTY)])
    worth = overlap - penalty
    has_camera = groups.observation >= 0
    choice = np.where(has_camera, np.argmax(worth, axis=1), np.where(shape.by_shape, 0, 2))
    rows = np.arange(len(groups))
    best = table[rows, choice]
    center, size = np.column_stack([best[:, :2], z[rows, choice]]), np.column_stack([best[:, 2:4], lwh[:, 2]])
    return Boxes3D(center, size, best[:, 4]), np.where(has_camera, overlap[rows, choice], np.nan)


def _guess_along_ray(scene: Scene, seen: Observed, groups: Groups, row: int, length_width: Float64) -> Float64:
    """Two guesses (2, 5) of an object whose near side is the nearest tenth of a group's points: place, size, heading.
    The direction is that of a camera's box, where it shows the whole object.
    """
    one = seen.observations[groups.observation[row]] if groups.observation[row] >= 0 else None
    eye = (scene if one is None else one).eye_m[:2]
    ray = scene.cloud.xyz[groups.rows[groups.first[row] : groups.first[row + 1]], :2] - eye
    distance, azimuth = np.sort(np.hypot(ray[:, 0], ray[:, 1])), np.arctan2(ray[:, 1], ray[:, 0])
    near = float(distance[len(distance) // 10])
    bearing = float(azimuth[0] + np.median(wrap_angle(azimuth - azimuth[0])))
    depth, beside, aspect = float(length_width.sum()) / 4, 0.0, np.array([-bearing, -bearing])
    if one is not None:
        bearing = bearing if one.cut and not one.beside_m else one.bearing_rad
        depth, beside = one.depth_m, one.beside_m
        aspect = np.array([-one.aspect_rad, one.aspect_rad])
    forward, left = np.array([np.cos(bearing), np.sin(bearing)]), np.array([-np.sin(bearing), np.cos(bearing)])
    center = eye + forward * (near + depth) + left * beside
    return np.column_stack([np.tile([*center, *length_width], (2, 1)), half_turn(bearing + aspect)])


def _middle_z(scene: Scene, groups: Groups, center: Float64, height_m: Float64) -> Float64:
    """Height of the middles (M, 4) [m] of boxes at (M, 4, 2): on the ground, where that isn't known, of the points."""
    if scene.plane is not None:
        return scene.plane.z_m(center.reshape(-1, 2)).reshape(center.shape[:2]) + height_m[:, None] / 2
    z = scene.cloud.xyz[groups.rows, 2]
    middle = [np.median(z[begin:end]) for begin, end in pairwise(groups.first)]
    return np.repeat(np.array(middle, np.float64)[:, None], center.shape[1], axis=1)


def _overlaps(scene: Scene, seen: Observed, groups: Groups, table: Float64, z: Float64, height_m: Float64) -> Float64:
    """IoU (M, 4) of guessed boxes in the image with the camera's boxes; 0 where no camera saw the group."""
    result = np.zeros(table.shape[:2])
    cameras = np.array([s.camera for s in seen.observations] or [""])[groups.observation]
    for name in np.unique(cameras[groups.observation >= 0]):
        rows = np.flatnonzero((cameras == name) & (groups.observation >= 0))
        flat = table[rows].reshape(-1, 5)
        size = np.column_stack([flat[:, 2:4], np.repeat(height_m[rows], table.shape[1])])
        boxes = Boxes3D(np.column_stack([flat[:, :2], z[rows].ravel()]), size, flat[:, 4])
        shown = np.array([seen.observations[i].xyxy_px for i in groups.observation[rows]])
        overlap = outline_overlaps(scene.rig, str(name), boxes, shown.repeat(table.shape[1], axis=0))
        result[rows] = overlap.reshape(len(rows), -1)
    return result


def classify_shapes(
    scene: Scene, groups: Groups, shape: Shapes, least: float, echo_shapes: bool
) -> tuple[Float64, Text]:
    """Probability (M,) that groups are road users by the shape of their points as `fit_shapes` uses them, NaN where
    they are too few, and labels (M,) by shape. Where LiDARs deliver, shapes of echoes count with
    `echo_shapes` only, and those of stereo say nothing: what isn't noise LiDARs see, too.
    """
    label = np.full(len(groups), "car", "<U16")
    is_lidar = scene.cloud.source == int(Source.L)
    enough = groups.sums(is_lidar[groups.rows]) >= least
    rows = np.flatnonzero(shape.by_shape & (enough | ~is_lidar.any()))
    probability = np.full(len(groups), np.nan)
    if echo_shapes or not is_lidar.any():
        probability = _classify_echoes(scene, groups, shape)
    if scene.plane is None or not len(rows):
        return probability, label
    seen = Seen(_sort_points(scene, groups, rows, least), shape.rectangles[rows], scene.plane, scene.eye_m)
    how = scene.shapes
    boxes = classify(seen, how.judge, how.size, how.sizes, how.shape)
    if boxes.score is not None:
        probability[rows] = boxes.score
    long = np.hypot(*(shape.rectangles[:, [2, 4]] - shape.rectangles[:, [1, 3]]).T) > LONG_M
    label[long] = "truck"
    if boxes.label is not None:
        label[rows] = boxes.label
    return probability, label


_ECHO_WEIGHT, _LEAST_BY_ECHOES = 0.7, 0.3
"""How far shapes of echoes are believed; less than the second says nothing: many vehicles look odd to a radar."""


def _classify_echoes(scene: Scene, groups: Groups, shape: Shapes) -> Float64:
    """Probability (M,) that what a camera sees, and LiDAR and stereo too little of, is a vehicle by the shape of its
    radar echoes, NaN where they say nothing, or are too few in a frame to show shapes.
    """
    result = np.full(len(groups), np.nan)
    if scene.tall_echoes is None:
        return result
    is_judged = (groups.observation >= 0) & ~shape.by_shape
    used = is_judged[groups.number] & (scene.cloud.source[groups.rows] == int(Source.R))
    rows, number = groups.rows[used], groups.number[used]
    if not len(rows):
        return result
    judged, cluster = np.unique(number, return_inverse=True)
    cloud, none = scene.cloud[rows], np.zeros(len(rows))
    own = Cloud(
        scene.plane, cloud.xyz, cloud.height_m, scene.tall_echoes, scene.eye_m, cloud.is_moving, none, none, none
    )
    score = _ECHO_WEIGHT * score_groups(image.Groups.of(own, cluster), RadarImageParams().shape)
    result[judged] = np.where(score >= _LEAST_BY_ECHOES, score, np.nan)
    return result


def _sort_points(scene: Scene, groups: Groups, chosen: Int64, least: float) -> Standing:
    """Points of LiDAR and stereo as they are classified: sorted by chosen group, those of no such group first. Points
    of stereo that show no shape are in neither.
    """
    cloud, number = scene.cloud, np.full(len(scene.cloud), -1)
    place = np.full(len(groups), -1)
    place[chosen] = np.arange(len(chosen))
    number[groups.rows] = place[groups.number]
    is_used = cloud.source != int(Source.R)
    is_used[groups.rows] = outline_points(cloud, groups, least)
    rows = np.flatnonzero(is_used)
    rows = rows[np.argsort(number[rows], kind="stable")]
    first = np.searchsorted(number[rows], np.arange(len(chosen) + 1))
    tall = scene.tall.copy()
    if scene.plane is not None:
        tall[:, 2] -= scene.plane.z_m(tall)
    return Standing(np.column_stack([cloud.xyz[rows, :2], cloud.height_m[rows]]), first, tall)
