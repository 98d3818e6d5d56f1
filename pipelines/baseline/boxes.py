"""Points of the baseline's sensors, boxes around clusters of them, and how these are merged with cameras' boxes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from fbench.pipelines.baseline import params as plain
from fbench.pipelines.baseline.params import PlainParams, PlainSensor, PlainSizeParams
from fbench.pipelines.sensors.camera.detector import CameraDetections, CameraStage
from fbench.pipelines.sensors.points.dbscan import dbscan
from fbench.pipelines.sensors.points.merged import lidar_points, radar_scans
from fbench.pipelines.sensors.points.vehicle import HEADINGS_RAD, NEAR_M, fit_rectangles
from fbench.pipelines.sensors.rows import Rows
from fbench.pipelines.sensors.stereo.stage import NOISE, StereoStage
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import Kind, LogInfo, Rig
from fbench.replay.geometry.camera import in_image, project_body, project_boxes
from fbench.replay.geometry.iou import flat_iou, upright


@dataclass(frozen=True, eq=False)
class Extents(Rows):
    """N boxes."""

    low: Float64
    """(N, 3) in body coordinates [m] that are turned by `yaw_rad` about z, or (N, 2) in an image [px]"""
    high: Float64  # The opposite corners
    distance_m: Float64  # (N,) from the body's origin [m]; NaN where nothing measured it
    range_rate_mps: Float64
    """(N,) radial velocity as measured [m/s], positive when receding; NaN where nothing measured it."""
    label: Text  # (N,) of a camera; empty where unknown
    score: Float64  # (N,) 0 to 1: a camera's, and 1 for clusters, of which the thesis knows no score
    sources: Array  # (N,) uint8, bits of `Source`
    yaw_rad: Float64  # (N,) by which the axes of boxes in space are turned; 0 in images


def make_extents(low: Float64, high: Float64, source: int | Array, **known: Any) -> Extents:
    """Return boxes of which nothing is known but what is given."""
    num = len(low)
    unknown: dict[str, Any] = dict.fromkeys(("distance_m", "range_rate_mps"), np.full(num, np.nan))
    unknown |= {"label": np.full(num, "", "U16"), "score": np.ones(num)}
    unknown["yaw_rad"] = np.zeros(num)
    unknown["sources"] = np.broadcast_to(np.asarray(source, np.uint8), num)
    return Extents(low, high, **(unknown | known))


def no_extents(num_axes: int) -> Extents:
    """Return no boxes."""
    return make_extents(np.zeros((0, num_axes)), np.zeros((0, num_axes)), 0)


def iou(a: Extents, b: Extents) -> Float64:
    """Intersection over union (N, M): of areas in an image, of volumes in space; 0 where both are empty."""
    if a.yaw_rad.any() or b.yaw_rad.any():
        start_a, start_b = (np.array([0, len(boxes)]) for boxes in (a, b))
        flat = flat_iou(upright(to_solid(a)), upright(to_solid(b)), start_a, start_b, solid=True)
        return np.maximum(flat, 0.0).reshape(len(a), len(b))
    low = np.maximum(a.low[:, None], b.low[None])
    high = np.minimum(a.high[:, None], b.high[None])
    overlap = np.prod(np.clip(high - low, 0, None), axis=2)
    size_a, size_b = (np.prod(boxes.high - boxes.low, axis=1) for boxes in (a, b))
    union = size_a[:, None] + size_b[None] - overlap
    share: Float64 = np.divide(overlap, union, out=np.zeros_like(overlap), where=union > 0)
    return share


@dataclass(frozen=True, eq=False)
class PlainCloud(Rows):
    """Points of one sensor, or of several."""

    xyz: Float64  # (N, 3) [m] in body coordinates
    range_rate_mps: Float64
    """(N,) radial velocity as measured [m/s], positive when receding; NaN where the sensor gives none."""
    source: Array  # (N,) uint8, bits of `Source`


def make_cloud(xyz: Float64, source: int, range_rate_mps: Float64 | None = None) -> PlainCloud:
    """Return points (N, 3) of one kind of sensor."""
    rate = np.full(len(xyz), np.nan) if range_rate_mps is None else range_rate_mps
    return PlainCloud(xyz, rate, np.full(len(xyz), source, np.uint8))


def join_clouds(clouds: list[PlainCloud]) -> PlainCloud:
    """Put the points of several clouds, or of none, into one."""
    return PlainCloud.join(clouds) if clouds else make_cloud(np.zeros((0, 3)), 0)


def crop(points: PlainCloud, params: plain.PlainCropParams) -> PlainCloud:
    """Leave out ground, own vehicle, and what is too high or too far."""
    range_m, z = np.hypot(points.xyz[:, 0], points.xyz[:, 1]), points.xyz[:, 2]
    near = (range_m >= params.min_range_m) & (range_m <= params.max_range_m)
    return points[near & (z >= params.low_m) & (z <= params.high_m)]


def cluster_in_space(points: PlainCloud, params: plain.PlainClusterParams) -> Int64:
    """Number the clusters (N,) of points in space; -1: none. See `dbscan` for their order."""
    return dbscan(points.xyz, params.eps_m, params.min_points)


def cluster_pixels(uv_px: Float64, depth_m: Float64, params: plain.PlainImageParams) -> Int64:
    """Number the clusters (N,) of points at places (N, 2) [px] of an image and depths (N,) [m]; -1: none."""
    features = np.column_stack([uv_px, depth_m * params.depth_px_per_m])
    return dbscan(features, params.eps_px, params.min_points)


def box_clusters(
    points: PlainCloud,
    cluster: Int64,
    places: Float64,
    params: PlainSizeParams,
    label: Text | None = None,
    *,
    oriented: bool = False,
) -> Extents:
    """Return the extents of clusters (N,) that may be vehicles.

    Args:
        points: Points whose extents in space say whether they may be vehicles.
        cluster: Number of the cluster of each; -1: none.
        places: (N, D) whose extents are returned: the points in space [m], or in an image [px].
        params: Sizes of vehicles.
        label: (number of clusters,) of each cluster; `None`: there are none.
        oriented: Whether boxes in space have the heading of the rectangle that fits a cluster best, seen from above;
            else they lie along the axes.
    """
    rows = members(cluster)
    enough = [number for number, own in enumerate(rows) if len(own) >= params.least_points]
    yaw = np.zeros(len(rows))
    if oriented:
        yaw[enough] = fit_headings(points.xyz[:, :2], [rows[number] for number in enough])

    def may_be_vehicle(number: int) -> bool:
        x, y, height = np.ptp(turn_points(points.xyz[rows[number]], -yaw[number]), axis=0)
        is_long = params.least_extent_m <= max(x, y) <= params.most_extent_m
        is_high = params.least_height_m <= height <= params.most_height_m
        return bool(is_long and is_high and min(x, y) <= params.most_width_m)

    def mean_rate(range_rate_mps: Float64) -> float:
        # In ascending order, so that rounding doesn't depend on that of the points.
        known = np.sort(range_rate_mps[np.isfinite(range_rate_mps)])
        return float(known.mean()) if len(known) else np.nan

    kept = [number for number in enough if may_be_vehicle(number)]
    if not kept:
        return no_extents(places.shape[1])
    rows, yaw = [rows[number] for number in kept], yaw[kept]
    turned = [turn_points(points.xyz[own], -angle) for own, angle in zip(rows, yaw, strict=True)]
    outlines = turned if places.shape[1] == 3 else [places[own] for own in rows]
    low, high = (np.array([reach(own, axis=0) for own in outlines]) for reach in (np.min, np.max))
    # Turned about z, so that the distance is the same.
    middle = [(own.min(axis=0) + own.max(axis=0)) / 2 for own in turned]
    return make_extents(
        low,
        high,
        np.array([np.bitwise_or.reduce(points.source[own]) for own in rows]),
        distance_m=np.sqrt(np.square(middle).sum(axis=1)),
        range_rate_mps=np.array([mean_rate(points.range_rate_mps[own]) for own in rows]),
        yaw_rad=yaw if places.shape[1] == 3 else np.zeros(len(rows)),
        **({} if label is None else {"label": label[kept]}),
    )


def turn_points(xyz: Float64, yaw_rad: float) -> Float64:
    """Turn points (N, 3) about z by an angle."""
    if not yaw_rad:
        return xyz
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = xyz.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])


def fit_headings(xy: Float64, rows: Sequence[Int64]) -> Float64:
    """Return the direction (M,) [rad], above -pi/2 and up to pi/2, of the longer side of the rectangle that fits each
    cluster best, see `fit_rectangles`. Rows of points (N, 2) of clusters aren't empty.

    The smallest rectangle would be the obvious one, but around two sides of a vehicle, which make a right triangle,
    three rectangles have the same area.
    """
    if not rows:
        return np.zeros(0)
    own = [xy[row][np.lexsort(xy[row].T)] for row in rows]  # sums don't depend on the order of points
    first = np.cumsum([0, *map(len, own)]).astype(np.int64)
    heading, low_u, high_u, low_v, high_v, _ = fit_rectangles(np.concatenate(own), first, HEADINGS_RAD, NEAR_M).T
    longest = np.where(high_u - low_u >= high_v - low_v, heading, heading + np.pi / 2)
    return np.asarray(np.pi / 2 - np.mod(np.pi / 2 - longest, np.pi), np.float64)


def members(cluster: Int64) -> list[Int64]:
    """Rows of the points of each cluster (N,), by its number, ascending."""
    order = np.argsort(cluster, kind="stable")
    bounds = np.searchsorted(cluster[order], np.arange(int(cluster.max(initial=-1)) + 2))
    return [order[start:end] for start, end in pairwise(bounds)]


UNKNOWN = "car"  # Label of what no camera names: vehicles count as one class for sensors without classes


def camera_extents(found: CameraDetections) -> Extents:
    """Boxes of one camera in its image."""
    low, high = found.xyxy_px[:, :2], found.xyxy_px[:, 2:]
    return make_extents(low, high, Source.C, label=found.label.astype("U16"), score=found.score)


def project_extents(boxes: Extents, rig: Rig, camera: str) -> tuple[Extents, Bool]:
    """Boxes in space as outlines in an image, and which of them (N,) show there."""
    outline, seen = project_boxes(rig, camera, to_solid(boxes))
    return replace(boxes, low=outline[:, :2], high=outline[:, 2:], yaw_rad=np.zeros(len(boxes)))[seen], seen


def to_solid(boxes: Extents) -> Boxes3D:
    """Boxes in space, length along their own x and width along their own y."""
    middle, cos, sin = (boxes.low + boxes.high) / 2, np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad)
    x, y, z = middle.T
    return Boxes3D(np.column_stack([cos * x - sin * y, sin * x + cos * y, z]), boxes.high - boxes.low, boxes.yaw_rad)


def label_boxes(boxes: Extents, rig: Rig, cameras: Mapping[str, CameraDetections], min_iou: float) -> Extents:
    """Give boxes in space the label of the camera's box that their outline in the image overlaps most.

    In the thesis a camera's boxes have no third dimension, so here they name what other sensors place, and what a
    camera alone sees isn't there. Overlaps below `min_iou` don't count; of several cameras the first counts.
    """
    label, sources = boxes.label.copy(), boxes.sources.copy()
    for camera in sorted(cameras):
        own = camera_extents(cameras[camera])
        outline, seen = project_extents(boxes, rig, camera)
        if not len(own) or not len(outline):
            continue
        overlap = iou(outline, own)
        best = np.argmax(overlap, axis=1)
        fits = overlap[np.arange(len(outline)), best] >= min_iou
        rows = np.flatnonzero(seen)[fits]
        label[rows] = np.where(label[rows] == "", own.label[best[fits]], label[rows])
        sources[rows] |= int(Source.C)
    return replace(boxes, label=label, sources=sources)


def label_points(xyz: Float64, rig: Rig, cameras: Mapping[str, CameraDetections]) -> Text:
    """Labels (N,) of the cameras' boxes into which points (N, 3) in body coordinates project; empty: none. Where boxes
    overlap the one with the highest score counts; of several cameras the first.
    """
    label: Text = np.full(len(xyz), "", "U16")
    for camera in sorted(cameras):
        found = cameras[camera]
        uv, _ = project_body(rig, camera, xyz)
        inside = in_image(rig.cameras[camera], uv)
        for box in np.argsort(-found.score, kind="stable"):
            left, top, right, bottom = found.xyxy_px[box]
            hit = inside & (uv[:, 0] >= left) & (uv[:, 0] <= right) & (uv[:, 1] >= top) & (uv[:, 1] <= bottom)
            label[hit & (label == "")] = found.label[box]
    return label


def cluster_labels(cluster: Int64, label: Text, least_share: float) -> Text:
    """Most frequent label of each cluster's points (N,), the first by name on ties; empty below `least_share`."""
    rows = members(cluster)
    result: Text = np.full(len(rows), "", "U16")
    for number, own in enumerate(label[own] for own in rows):
        names, count = np.unique(own[own != ""], return_counts=True)
        if len(names) and count.sum() >= least_share * len(own):
            result[number] = names[np.argmax(count)]
    return result


def add_camera(sources: Array, label: Text) -> Array:
    """Add the camera to the sources (N,) of what it named."""
    return np.asarray(np.where(label != "", sources | int(Source.C), sources), np.uint8)


def merge_boxes(parts: Sequence[Extents], min_iou: float) -> Extents:
    """Merge the boxes of sensors, one sensor after the other, into those that are there already.

    A box joins the one that it overlaps most, the first of several, where that is at least `min_iou`; else it stays by
    itself. Boxes of one sensor aren't merged with each other, but several of them may join the same box. A box that
    others joined keeps its outline; label, distance and range rate are the first that are known, the score is the
    highest. So the order of sensors matters: the thesis takes outline and class from the camera and distance from
    LiDAR, which therefore come first.
    """
    result = parts[0]
    for part in parts[1:]:
        if not len(result) or not len(part):
            result = Extents.join([result, part])
            continue
        overlap = iou(part, result)
        partner = np.argmax(overlap, axis=1)
        joins = overlap[np.arange(len(part)), partner] >= min_iou
        result = Extents.join([_complete(result, part[joins], partner[joins]), part[~joins]])
    return result


def _complete(boxes: Extents, others: Extents, partner: Int64) -> Extents:
    distance, rate, label = boxes.distance_m.copy(), boxes.range_rate_mps.copy(), boxes.label.copy()
    score, sources = boxes.score.copy(), boxes.sources.copy()
    for row, at in enumerate(partner):
        distance[at] = others.distance_m[row] if np.isnan(distance[at]) else distance[at]
        rate[at] = others.range_rate_mps[row] if np.isnan(rate[at]) else rate[at]
        label[at] = label[at] or others.label[row]
        score[at] = max(score[at], others.score[row])
        sources[at] |= others.sources[row]
    return replace(boxes, distance_m=distance, range_rate_mps=rate, label=label, score=score, sources=sources)


KINDS: tuple[Kind, ...] = ("lidar", "radar")
"""Sensors that measure points; stereo, which makes them of images, comes on top."""


@dataclass(frozen=True, eq=False)
class PlainObservations:
    """Observations of the sensors of one frame."""

    cameras: Mapping[str, CameraDetections]  # By camera name; a camera that failed isn't in it
    clouds: Mapping[PlainSensor, PlainCloud]
    """By kind of sensor, in the order LiDAR, radar, stereo; empty where it didn't deliver."""
    faults: tuple[Fault, ...]
    missing: Mapping[str, str]  # Cameras whose depth is noise


class PlainSensors:
    """The sensors that parameters name. Raises ConfigError or ModelError where weights are missing or unusable."""

    def __init__(self, params: PlainParams) -> None:
        self._params, self.cameras = params, CameraStage(params.camera)
        self.with_camera = "camera" in params.uses  # Whether boxes have labels

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take the sensors. Raises ConfigError where a setting is no camera's, LogError without a stereo pair."""
        params = self._params
        unused = [kind for kind in ("camera", *KINDS) if kind not in params.uses]
        settings = SensorSettings(params, rig, unused)
        for kind in KINDS:  # whose points have common parameters
            settings.own(kind, getattr(params, kind), ())
        if self.with_camera:
            self.cameras.start(rig, log_info, settings)
        self._rig, self._ranges_m = rig, dict.fromkeys(rig.sensors("lidar"), (0.0, np.inf))
        self._stereo = StereoStage(rig, log_info.name, params.depth) if "stereo" in params.uses else None
        pair = () if self._stereo is None else (self._stereo.pair.left, self._stereo.pair.right)
        points = (name for kind in KINDS if kind in params.uses for name in rig.sensors(kind))
        self.required = tuple(sorted({*self.cameras.used, *points, *pair}))  # Sensors that results rest on

    def view(self, frame: Frame, clock: StageClock) -> PlainObservations:
        """Return what is seen in one frame; what a missing sensor would have given isn't there."""
        params, faults, missing = self._params, list[Fault](), dict[str, str]()
        cameras = self.cameras.view(frame, clock, faults)
        found = dict[PlainSensor, PlainCloud]()
        with clock.stage("calibrate"):
            if "lidar" in params.uses:
                points = lidar_points(self._rig, frame, self._ranges_m)
                found["lidar"] = make_cloud(np.zeros((0, 3)) if points is None else points, Source.L)
            if "radar" in params.uses:
                scans = radar_scans(self._rig, frame, {}) or ()
                found["radar"] = join_clouds([make_cloud(s.xyz, Source.R, s.radial_velocity_mps) for s in scans])
        if self._stereo is not None:
            view, pair = self._stereo.view(frame, clock, faults), self._stereo.pair
            found["stereo"] = make_cloud(view.xyz, Source.S)
            missing |= dict.fromkeys((pair.left, pair.right), NOISE) if view.is_off else {}
        with clock.stage("preprocess"):
            clouds = {kind: crop(cloud, getattr(params, kind).crop) for kind, cloud in found.items()}
        return PlainObservations(cameras, clouds, tuple(faults), missing)
