"""What cameras say of boxes and points in space."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fbench.pipelines.camera.detector import CameraDetections
from fbench.pipelines.plain.clusters import members
from fbench.pipelines.plain.extents import Extents, extents, iou
from fbench.replay.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Rig, Source
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
