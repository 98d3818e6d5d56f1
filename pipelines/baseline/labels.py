"""Labels of boxes and points from cameras, and boxes merged pairwise in the order of the sensors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fbench.pipelines.baseline.boxes import Extents, extents, iou, joined, members
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import in_image, project_body, project_boxes

UNKNOWN = "car"
"""Label of what no camera names: vehicles count as one class for sensors without classes."""


def camera_extents(found: CameraDetections) -> Extents:
    """Boxes of one camera in its image."""
    low, high = found.xyxy_px[:, :2], found.xyxy_px[:, 2:]
    return extents(low, high, Source.C, label=found.label.astype("U16"), score=found.score)


def projected(boxes: Extents, rig: Rig, camera: str) -> tuple[Extents, Bool]:
    """Boxes in space as outlines in an image, and which of them (N,) show there."""
    outline, seen = project_boxes(rig, camera, solid(boxes))
    return replace(boxes, low=outline[:, :2], high=outline[:, 2:])[seen], seen


def solid(boxes: Extents) -> Boxes3D:
    """Boxes in space, length along x and width along y, all with heading 0."""
    return Boxes3D((boxes.low + boxes.high) / 2, boxes.high - boxes.low, np.zeros(len(boxes)))


def named(boxes: Extents, rig: Rig, cameras: Mapping[str, CameraDetections], min_iou: float) -> Extents:
    """Give boxes in space the label of the camera's box that their outline in the image overlaps most.

    In the thesis a camera's boxes have no third dimension, so here they name what other sensors place, and what a
    camera alone sees isn't there. Overlaps below `min_iou` don't count; of several cameras the first counts.
    """
    label, sources = boxes.label.copy(), boxes.sources.copy()
    for camera in sorted(cameras):
        own = camera_extents(cameras[camera])
        outline, seen = projected(boxes, rig, camera)
        if not len(own) or not len(outline):
            continue
        overlap = iou(outline, own)
        best = np.argmax(overlap, axis=1)
        fits = overlap[np.arange(len(outline)), best] >= min_iou
        rows = np.flatnonzero(seen)[fits]
        label[rows] = np.where(label[rows] == "", own.label[best[fits]], label[rows])
        sources[rows] |= int(Source.C)
    return replace(boxes, label=label, sources=sources)


def painted(xyz: Float64, rig: Rig, cameras: Mapping[str, CameraDetections]) -> Text:
    """Labels (N,) of the cameras' boxes into which points (N, 3) in body coordinates project; empty: none.

    Where boxes overlap the one with the highest score counts; of several cameras the first.
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
    """Label of each cluster: the most frequent one among its points (N,), the first by name on ties; empty where fewer
    than `least_share` of its points carry any.
    """
    rows = members(cluster)
    result: Text = np.full(len(rows), "", "U16")
    for number, own in enumerate(label[own] for own in rows):
        names, count = np.unique(own[own != ""], return_counts=True)
        if len(names) and count.sum() >= least_share * len(own):
            result[number] = names[np.argmax(count)]
    return result


def with_camera(sources: Array, label: Text) -> Array:
    """Add the camera to the sources (N,) of what it named."""
    return np.asarray(np.where(label != "", sources | int(Source.C), sources), np.uint8)


def merged(parts: Sequence[Extents], min_iou: float) -> Extents:
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
            result = joined([result, part])
            continue
        overlap = iou(part, result)
        partner = np.argmax(overlap, axis=1)
        joins = overlap[np.arange(len(part)), partner] >= min_iou
        result = joined([_with(result, part[joins], partner[joins]), part[~joins]])
    return result


def _with(boxes: Extents, others: Extents, partner: Int64) -> Extents:
    """Add what others know to the boxes (M,) that they join."""
    distance, rate, label = boxes.distance_m.copy(), boxes.range_rate_mps.copy(), boxes.label.copy()
    score, sources = boxes.score.copy(), boxes.sources.copy()
    for row, at in enumerate(partner):
        distance[at] = others.distance_m[row] if np.isnan(distance[at]) else distance[at]
        rate[at] = others.range_rate_mps[row] if np.isnan(rate[at]) else rate[at]
        label[at] = label[at] or others.label[row]
        score[at] = max(score[at], others.score[row])
        sources[at] |= others.sources[row]
    return replace(boxes, distance_m=distance, range_rate_mps=rate, label=label, score=score, sources=sources)
