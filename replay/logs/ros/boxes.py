"""Boxes of vision_msgs (both generations) and radar_msgs, in the coordinate frame of their message."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.classes import labels
from fbench.replay.errors import DecodeError
from fbench.replay.logs.box_parts import checked, matrix, orientation, track_ids
from fbench.replay.logs.ros.cursor import Header
from fbench.replay.logs.ros.fields import find, get, header


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
    return checked(
        Boxes3D(
            matrix([get(pose, "position") for pose in poses], "xyz"), matrix([get(b, "size") for b in boxes], "xyz"),
            **orientation(matrix([get(pose, "orientation") for pose in poses], "xyzw")), **_columns(parts),
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
    return checked(Boxes2D(np.array([camera] * len(parts), np.str_), xyxy, **_columns(parts)))


def radar_tracks(message: Any) -> Boxes3D:
    """Return the boxes of a RadarTracks: sizes along the axes of the sensor, so yaw is 0.

    Their ids are UUIDs, in the first generation numbers.

    Raises:
        DecodeError: where a box isn't finite.
    """
    parts = get(message, "tracks")
    center, size, velocity = (matrix([get(p, n) for p in parts], "xyz") for n in ("position", "size", "velocity"))
    names = labels([str(get(part, "classification")) for part in parts])
    ids = track_ids([_id(part) for part in parts])
    return checked(Boxes3D(center, size, np.zeros(len(parts)), velocity_mps=velocity, track_id=ids, **names))


def _id(track: Any) -> object:
    uuid = find(track, "uuid")
    return find(track, "track_id") if uuid is None else bytes(get(uuid, "uuid"))


def _columns(parts: Sequence[Any]) -> dict[str, Any]:
    """Class, score and track: those of the most probable hypothesis, the first one of equals."""
    best = [_best(get(part, "results")) for part in parts]
    scored = all(name is not None for name, _ in best)
    return {
        **labels([name or "" for name, _ in best]),
        "score": np.array([score for _, score in best], np.float64) if scored else None,
        "track_id": track_ids([find(part, "id", "tracking_id") for part in parts]),
    }


def _best(results: Sequence[Any]) -> tuple[str | None, float]:
    known = [find(result, "hypothesis") or result for result in results]
    pairs = [(str(get(h, "class_id", "id")), float(get(h, "score"))) for h in known]
    return max(pairs, key=lambda pair: pair[1], default=(None, 0.0))


def _rectangle(box: Any) -> tuple[float, float, float, float]:
    center = get(box, "center")
    position = find(center, "position") or center
    x, y, theta = float(get(position, "x")), float(get(position, "y")), float(get(center, "theta"))
    w, h = float(get(box, "size_x")), float(get(box, "size_y"))
    if theta:
        c, s = abs(np.cos(theta)), abs(np.sin(theta))
        w, h = w * c + h * s, w * s + h * c
    return x - w / 2, y - h / 2, x + w / 2, y + h / 2
