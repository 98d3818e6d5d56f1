"""The kept frames of all runs: pictures, points and boxes, for the script that draws them."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.boxes import MAX_MAGNITUDE, Boxes, Boxes2D, Boxes3D, finite
from fbench.replay.data.rig import Kind, Rig
from fbench.replay.geometry.camera import is_pinhole, project_body, project_boxes, project_edges, rays
from fbench.replay.geometry.iou import corners
from fbench.replay.geometry.transforms import transform
from fbench.replay.runs.folder import Run
from fbench.replay.runs.media import MediaFrame, Points
from fbench.reports.html.overview import row_numbers, timeline

Outlines: TypeAlias = list[dict[str, dict[str, Any]]]


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
    return [
        _common(boxes, i)
        | (next(geometry) if drawable[i] else {"invalid": True, "seen": {}, "distance": None, "speed": None})
        for i in range(len(boxes))
    ]


def _common(boxes: Boxes, i: int) -> dict[str, Any]:
    track_id = _value(boxes.track_id, i)
    return {
        "label": _value(boxes.label, i) or "",
        "id": None if track_id is None or track_id < 0 else track_id,
        "score": _value(boxes.score, i),
        "sources": _value(boxes.sources, i) or 0,
        "predicted": bool(_value(boxes.predicted, i)),
        "ignore": bool(_value(boxes.ignore, i)),
    }


def _value(array: Array | None, i: int) -> Any:
    return None if array is None else array[i].item()


def _rows_3d(boxes: Boxes3D, rig: Rig, cameras: list[str]) -> list[dict[str, Any]]:
    eight = corners(boxes)
    distance = np.sqrt(np.sum(boxes.center_m**2, axis=1))
    seen: Outlines = [{} for _ in range(len(boxes))]
    for name in cameras:
        _add_outlines(seen, rig, name, boxes)
    rows: list[dict[str, Any]] = [
        {"corners": np.round(eight[i], 2).ravel().tolist(), "distance": float(distance[i]), "seen": seen[i]}
        for i in range(len(boxes))
    ]
    if boxes.velocity_mps is not None:
        for row, v in zip(rows, boxes.velocity_mps, strict=True):
            row |= {"velocity": v[:2].tolist(), "speed": float(np.hypot(v[0], v[1]))}
    return rows


def _add_outlines(seen: Outlines, rig: Rig, name: str, boxes: Boxes3D) -> None:
    """Add rectangle and wire frame in camera `name`; nothing where its distortion isn't modeled.

    Where a lens bends straight lines, each of the 12 edges is a `curve` of several points.
    """
    try:
        rectangles, visible = project_boxes(rig, name, boxes)
        wires = project_body(rig, name, corners(boxes).reshape(-1, 3))[0].reshape(-1, 16)
        straight = is_pinhole(rig.cameras[name])
        curves = None if straight else project_edges(rig, name, boxes).reshape(len(boxes), 12, -1)
    except LogError:
        return
    for i in np.flatnonzero(visible):
        wire = np.round(wires[i], 1).tolist() if np.isfinite(wires[i]).all() else None
        outline = {"rect": np.round(rectangles[i], 1).tolist(), "wire": wire}
        if curves is not None and np.isfinite(curves[i]).all():
            outline["curves"] = np.round(curves[i], 1).tolist()
        seen[int(i)][name] = outline


def _rows_2d(boxes: Boxes2D, rig: Rig) -> list[dict[str, Any]]:
    rows = []
    for i in range(len(boxes)):
        camera, rect = str(boxes.camera[i]), boxes.xyxy_px[i]
        distance, rate = _value(boxes.distance_m, i), _value(boxes.range_rate_mps, i)
        row = {
            "seen": {camera: {"rect": np.round(rect, 1).tolist(), "wire": None}},
            "distance": distance,
            "speed": rate,
        }
        rows.append(row | _place(rig, camera, rect, distance, rate))
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


MAX_POINTS = 4000  # Of one cloud; more can't be told apart at the size of the view
MAX_BARE = 40  # Frames that are shown by their boxes alone
_CM = 100.0
_NO_SPEED = -32768


@dataclass
class _Pool:
    """Contents that several runs share, such as images of one log, are stored once."""

    numbers: dict[str, int] = field(default_factory=dict)

    def add(self, content: bytes) -> int:
        text = base64.b64encode(content).decode("ascii")
        return self.numbers.setdefault(text, len(self.numbers))


def scenes(runs: Sequence[Run], labels: Sequence[str]) -> dict[str, Any]:
    """Return timelines and kept frames of all runs.

    Pictures are JPEG and clouds little-endian int16 (x, y, z [cm] in body coordinates, radial velocity [cm/s]), both
    in base64, in pools that the frames refer to by number.
    """
    pictures, clouds = _Pool(), _Pool()
    content = [_run(run, label, pictures, clouds) for run, label in zip(runs, labels, strict=True)]
    return {"runs": content, "pictures": list(pictures.numbers), "clouds": list(clouds.numbers)}


def shown_frames(run: Run) -> tuple[MediaFrame, ...]:
    """The frames that a run kept; where it kept none, as of a log without measurements, some with boxes."""
    if run.media or not run.frames:
        return run.media
    boxes = np.concatenate([run.tracks.frames, run.detections.frames]).astype(np.int64)
    found = {int(index) for index in np.unique(boxes)}
    some = [f.index for f in run.frames if f.index in found or f.truth_stamp_ns is not None]
    return tuple(MediaFrame(index) for index in some[:: max(1, -(-len(some) // MAX_BARE))])


def _run(run: Run, label: str, pictures: _Pool, clouds: _Pool) -> dict[str, Any]:
    rig, rows = run.manifest.rig, row_numbers(run)
    return {
        "label": label,
        "timeline": timeline(run),
        "cameras": {name: list(camera.size_wh) for name, camera in sorted(rig.cameras.items())},
        "frames": [
            {"index": rows[kept.index], **_frame(run, rig, kept, pictures, clouds)}
            for kept in shown_frames(run)
            if kept.index in rows
        ],
    }


def _frame(run: Run, rig: Rig, kept: MediaFrame, pictures: _Pool, clouds: _Pool) -> dict[str, Any]:
    cameras = [name for name in sorted(kept.pictures) if name in rig.cameras and name in rig.mounts]
    truth: Boxes | None = run.truth3d(kept.index)
    truth = run.truth2d(kept.index) if truth is None else truth
    return {
        "pictures": {name: pictures.add(picture.jpeg) for name, picture in sorted(kept.pictures.items())},
        "clouds": [_cloud(rig, name, points, clouds) for name, points in sorted(kept.points.items())],
        "labelled": truth is not None,
        "truth": box_rows(truth, rig, cameras),
        "detections": box_rows(run.detections.at(kept.index), rig, cameras),
        "tracks": box_rows(run.tracks.at(kept.index), rig, cameras),
    }


def _cloud(rig: Rig, name: str, points: Points, clouds: _Pool) -> dict[str, Any]:
    kind: Kind = rig.mounts[name].kind if name in rig.mounts else "lidar"
    return {"sensor": name, "kind": kind, "cloud": clouds.add(_pack(points))}


def _pack(points: Points) -> bytes:
    """Rows x, y, z, radial velocity in hundredths; -32768 where there is no velocity."""
    num = len(points.xyz)
    rows = np.arange(min(num, MAX_POINTS)) * num // max(1, min(num, MAX_POINTS))
    table = np.concatenate([points.xyz[rows], points.speed_mps[rows, None]], axis=1).astype(np.float64)
    whole = np.clip(np.round(table * _CM), -32767, 32767)
    return np.where(np.isfinite(table), whole, _NO_SPEED).astype("<i2").tobytes()
