"""Boxes as rows of plain values, for pages and viewers."""

from typing import Any

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.boxes import MAX_MAGNITUDE, Boxes, Boxes2D, Boxes3D, finite
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import is_pinhole, project_body, project_boxes, project_edges, rays
from fbench.replay.geometry.iou import corners
from fbench.replay.geometry.transforms import transform


def box_rows(boxes: Boxes | None, rig: Rig, cameras: list[str]) -> list[dict[str, Any]]:
    """Return one mapping a box: what it is, `distance` [m], `speed` [m/s] and its outline `seen` in each camera [px].

    What isn't finite, or is beyond all bounds, can't be drawn: such boxes are marked `invalid` and have no geometry.
    3D boxes carry their `corners` (24 numbers, body coordinates) and speed over ground; 2D boxes the range rate,
    positive when receding, and their `place` where they have a distance.
    """
    if boxes is None or not len(boxes):
        return []
    drawable, _ = finite(boxes)
    sound = boxes[drawable]
    geometry = iter(_rows_3d(sound, rig, cameras) if isinstance(sound, Boxes3D) else _rows_2d(sound, rig))

    def column(values: Array | None, absent: object) -> list[Any]:
        return [absent] * len(boxes) if values is None else values.tolist()

    columns = {
        "label": column(boxes.label, ""),
        "id": [None if track_id < 0 else track_id for track_id in column(boxes.track_id, -1)],
        "score": column(boxes.score, None),
        "sources": column(boxes.sources, 0),
        "predicted": column(boxes.predicted, False),
        "ignore": column(boxes.ignore, False),
    }
    rows = (dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True))
    nowhere = {"invalid": True, "seen": {}, "distance": None, "speed": None}
    return [row | (next(geometry) if can_draw else nowhere) for row, can_draw in zip(rows, drawable, strict=True)]


def _rows_3d(boxes: Boxes3D, rig: Rig, cameras: list[str]) -> list[dict[str, Any]]:
    eight = corners(boxes)
    distance = np.sqrt(np.sum(boxes.center_m**2, axis=1))
    rows: list[dict[str, Any]] = [
        {"corners": np.round(own, 2).ravel().tolist(), "distance": float(away), "seen": {}}
        for own, away in zip(eight, distance, strict=True)
    ]
    for name in cameras:
        try:
            rectangles, visible = project_boxes(rig, name, boxes)
            wires = project_body(rig, name, eight.reshape(-1, 3))[0].reshape(-1, 16)
            straight = is_pinhole(rig.cameras[name])
            # Where a lens bends straight lines, each of the 12 edges is a curve of several points.
            curves = None if straight else project_edges(rig, name, boxes).reshape(len(boxes), 12, -1)
        except LogError:
            continue  # its distortion isn't modeled
        for i in np.flatnonzero(visible):
            wire = np.round(wires[i], 1).tolist() if np.isfinite(wires[i]).all() else None
            outline = rows[i]["seen"][name] = {"rect": np.round(rectangles[i], 1).tolist(), "wire": wire}
            if curves is not None and np.isfinite(curves[i]).all():
                outline["curves"] = np.round(curves[i], 1).tolist()
    if boxes.velocity_mps is not None:
        for row, v in zip(rows, boxes.velocity_mps, strict=True):
            row |= {"velocity": v[:2].tolist(), "speed": float(np.hypot(v[0], v[1]))}
    return rows


def _rows_2d(boxes: Boxes2D, rig: Rig) -> list[dict[str, Any]]:
    rows = []
    for i in range(len(boxes)):
        camera, rect = str(boxes.camera[i]), boxes.xyxy_px[i]
        distance = None if boxes.distance_m is None else float(boxes.distance_m[i])
        rate = None if boxes.range_rate_mps is None else float(boxes.range_rate_mps[i])
        seen = {camera: {"rect": np.round(rect, 1).tolist(), "wire": None}}
        rows.append({"seen": seen, "distance": distance, "speed": rate, **_place(rig, camera, rect, distance, rate)})
    return rows


def _place(rig: Rig, name: str, rect: Float64, distance: float | None, rate: float | None) -> dict[str, Any]:
    """Return where a 2D box of known distance lies in body coordinates, and its radial velocity there.

    It is the point on the ray through the middle of the rectangle that is `distance` away from the body's origin.
    """
    if distance is None or not 0 < distance < MAX_MAGNITUDE or name not in rig.cameras or name not in rig.mounts:
        return {}
    camera, body_T_camera = rig.cameras[name], rig.body_T_sensor(name)
    try:
        ahead = rays(camera, (rect[None, :2] + rect[None, 2:]) / 2)
    except LogError:
        return {}
    if not np.isfinite(ahead).all():
        return {}
    origin = body_T_camera[:3, 3]
    ray = transform(body_T_camera, ahead)[0] - origin
    along = float(np.sum(origin * ray))
    beyond = distance**2 - float(np.sum(origin**2))
    if beyond <= 0:
        return {}
    place = origin + (np.sqrt(along**2 + beyond) - along) * ray
    velocity = None if rate is None else (place[:2] / distance * rate).tolist()
    return {"place": place.tolist(), "velocity": velocity}
