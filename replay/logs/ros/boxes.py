"""Boxes of vision_msgs (both generations) and radar_msgs, in the coordinate frame of their message."""

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.boxes import Boxes2D, Boxes3D, finite
from fbench.replay.classes import labels
from fbench.replay.errors import DecodeError
from fbench.replay.logs.ros.cursor import Header
from fbench.replay.logs.ros.fields import find, get, header

B = TypeVar("B", Boxes2D, Boxes3D)
_INT64 = range(-(2**63), 2**63)


def frame_of(message: Any, whole: Header, encoding: str) -> str:
    """Coordinate frame of an array of detections: that of its header, else the one that all detections name.

    Raises:
        DecodeError: where detections name several.
    """
    frames = {name for part in get(message, "detections") if (name := header(part, encoding).frame_id)}
    frames = frames | {whole.frame_id} if whole.frame_id else frames
    if len(frames) > 1:
        raise DecodeError(f"boxes are in several coordinate frames: {', '.join(sorted(frames))}")
    return next(iter(frames), "")


def detections3d(message: Any) -> Boxes3D:
    """Return the boxes of a Detection3DArray; an orientation of zeros, which means that none was given, is yaw 0.

    Raises:
        DecodeError: where a box isn't finite.
    """
    parts = get(message, "detections")
    boxes = [get(part, "bbox") for part in parts]
    poses = [get(box, "center") for box in boxes]
    yaw, pitch, roll = _angles(_matrix([get(pose, "orientation") for pose in poses], "xyzw"))
    upright = not (pitch.any() or roll.any())
    return _checked(
        Boxes3D(
            _matrix([get(pose, "position") for pose in poses], "xyz"), _matrix([get(b, "size") for b in boxes], "xyz"),
            yaw, None if upright else roll, None if upright else pitch, **_columns(parts),
        )
    )  # fmt: skip


def detections2d(message: Any, camera: str) -> Boxes2D:
    """Return the boxes of a Detection2DArray, turned ones as the rectangle around them.

    vision_msgs doesn't say where pixels have their centres: values are taken as they are, centres at integers.

    Raises:
        DecodeError: where a box isn't finite.
    """
    parts = get(message, "detections")
    xyxy = np.array([_rectangle(get(part, "bbox")) for part in parts], np.float64).reshape(-1, 4)
    return _checked(Boxes2D(np.array([camera] * len(parts), np.str_), xyxy, **_columns(parts)))


def radar_tracks(message: Any) -> Boxes3D:
    """Return the boxes of a RadarTracks: sizes along the axes of the sensor, so yaw is 0.

    Their ids are 128 bits of chance, so that there is no `track_id`, save in the first generation.

    Raises:
        DecodeError: where a box isn't finite.
    """
    parts = get(message, "tracks")
    center, size, velocity = (_matrix([get(p, n) for p in parts], "xyz") for n in ("position", "size", "velocity"))
    names = labels([str(get(part, "classification")) for part in parts])
    ids = _track_ids([find(part, "track_id") for part in parts])
    return _checked(Boxes3D(center, size, np.zeros(len(parts)), velocity_mps=velocity, track_id=ids, **names))


def _columns(parts: Sequence[Any]) -> dict[str, Any]:
    """Class, score and track: those of the most probable hypothesis, the first one of equals."""
    best = [_best(get(part, "results")) for part in parts]
    scored = all(name is not None for name, _ in best)
    return {
        **labels([name or "" for name, _ in best]),
        "score": np.array([score for _, score in best], np.float64) if scored else None,
        "track_id": _track_ids([find(part, "id", "tracking_id") for part in parts]),
    }


def _best(results: Sequence[Any]) -> tuple[str | None, float]:
    known = [find(result, "hypothesis") or result for result in results]
    pairs = [(str(get(h, "class_id", "id")), float(get(h, "score"))) for h in known]
    return max(pairs, key=lambda pair: pair[1], default=(None, 0.0))


def _track_ids(ids: Sequence[Any]) -> Int64 | None:
    """Tracks as numbers, `None` where not all of them are: other texts can't be kept as numbers."""
    texts = ["" if id_ is None else str(id_) for id_ in ids]
    if not all(text.isascii() and text.removeprefix("-").isdigit() and len(text) <= 20 for text in texts):
        return None
    numbers = [int(text) for text in texts]
    return np.array(numbers, np.int64) if all(n in _INT64 for n in numbers) else None


def _rectangle(box: Any) -> tuple[float, float, float, float]:
    center = get(box, "center")
    position = find(center, "position") or center
    x, y, theta = float(get(position, "x")), float(get(position, "y")), float(get(center, "theta"))
    w, h = float(get(box, "size_x")), float(get(box, "size_y"))
    if theta:
        c, s = abs(np.cos(theta)), abs(np.sin(theta))
        w, h = w * c + h * s, w * s + h * c
    return x - w / 2, y - h / 2, x + w / 2, y + h / 2


def _matrix(parts: Sequence[Any], names: str) -> Float64:
    return np.array([[get(part, name) for name in names] for part in parts], np.float64).reshape(-1, len(names))


def _angles(xyzw: Float64) -> tuple[Float64, Float64, Float64]:
    """Yaw, pitch, roll (N,) of quaternions (N, 4) with R = Rz(yaw) Ry(pitch) Rx(roll); roll is 0 at pitch +-90 deg."""
    largest = np.abs(xyzw).max(axis=1, keepdims=True)
    given = np.where(largest == 0, [0.0, 0.0, 0.0, 1.0], xyzw / np.where(largest > 0, largest, 1.0))
    x, y, z, w = (given / np.sqrt((given**2).sum(axis=1, keepdims=True))).T
    r00, r10, r20 = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    r21, r22 = 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    across = np.hypot(r00, r10)
    locked = across < 1e-9
    yaw = np.where(locked, np.arctan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z)), np.arctan2(r10, r00))
    return yaw, np.arctan2(-r20, across), np.where(locked, 0.0, np.arctan2(r21, r22))


def _checked(boxes: B) -> B:
    good, scored = finite(boxes)
    if not (good & scored).all():
        raise DecodeError(f"box {int(np.argmin(good & scored))} isn't finite")
    return boxes
