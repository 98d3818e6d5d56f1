"""Columns of boxes, from what messages of several programs hold."""

import re
from collections.abc import Sequence
from hashlib import blake2b
from typing import Any, TypeVar

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.boxes import Boxes2D, Boxes3D, finite
from fbench.replay.errors import DecodeError

B = TypeVar("B", Boxes2D, Boxes3D)
_INT64 = range(-(2**63), 2**63)
_UUID = re.compile(r"[0-9a-fA-F]{8}[0-9a-fA-F-]{8,}", re.ASCII)
_NUMBERED = re.compile(r"[a-zA-Z][\w ./:#-]{0,126}[0-9]", re.ASCII)
"""A name with a number of its own; without one it may as well be a class."""

_MAX_BOXES = 10_000
"""As of programs' answers; many more than any stack gives, and few enough to compare each with each."""


def require_few(num: int) -> None:
    """Refuse what no stack gives.

    Raises:
        DecodeError: where a message has too many boxes.
    """
    if num > _MAX_BOXES:
        raise DecodeError(f"{num} boxes in one message, more than {_MAX_BOXES}")


def matrix(parts: Sequence[Any], names: str) -> Float64:
    """Attributes of each part (N, len(names)), such as `x`, `y`, `z`.

    Raises:
        DecodeError: where a part lacks one.
    """
    try:
        rows = [[getattr(part, name) for name in names] for part in parts]
    except AttributeError as error:
        raise DecodeError(f"message has no field '{error.name}'") from error
    return np.array(rows, np.float64).reshape(-1, len(names))


def angles(xyzw: Float64) -> tuple[Float64, Float64, Float64]:
    """Yaw, pitch, roll (N,) of quaternions (N, 4) with R = Rz(yaw) Ry(pitch) Rx(roll); roll is 0 at pitch +-90 deg. An
    orientation of zeros, which means that none was given, is yaw 0.
    """
    largest = np.abs(xyzw).max(axis=1, keepdims=True)
    given = np.where(largest == 0, [0.0, 0.0, 0.0, 1.0], xyzw / np.where(largest > 0, largest, 1.0))
    x, y, z, w = (given / np.sqrt((given**2).sum(axis=1, keepdims=True))).T
    r00, r10, r20 = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    r21, r22 = 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    across = np.hypot(r00, r10)
    locked = across < 1e-9
    yaw = np.where(locked, np.arctan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z)), np.arctan2(r10, r00))
    return yaw, np.arctan2(-r20, across), np.where(locked, 0.0, np.arctan2(r21, r22))


def orientation(xyzw: Float64) -> dict[str, Any]:
    """Columns of the angles of quaternions (N, 4); upright boxes have yaw alone."""
    yaw, pitch, roll = angles(xyzw)
    upright = not (pitch.any() or roll.any())
    return {"yaw_rad": yaw, "pitch_rad": None if upright else pitch, "roll_rad": None if upright else roll}


def turned(xyzw: Float64, vectors: Float64) -> Float64:
    """Vectors (N, 3) in the axes of objects, each turned by its quaternion (N, 4) into those around them."""
    length = np.sqrt((xyzw**2).sum(axis=1, keepdims=True))
    unit = np.where(length == 0, [0.0, 0.0, 0.0, 1.0], xyzw / np.where(length > 0, length, 1.0))
    axis, w = unit[:, :3], unit[:, 3:]
    across = 2 * np.cross(axis, vectors)
    return np.asarray(vectors + w * across + np.cross(axis, across), np.float64)


def track_ids(ids: Sequence[object]) -> Int64 | None:
    """Tracks as numbers: integers as they are; UUIDs, as texts or bytes, and names that end with a number, such as
    `veh_11`, by 63 bits of a digest. `None` where not all are of one of these kinds, or such a text comes twice.
    """
    texts = [id_.hex() if isinstance(id_, bytes) else "" if id_ is None else str(id_) for id_ in ids]
    is_bytes = any(isinstance(id_, bytes) for id_ in ids)
    if not is_bytes and all(t.isascii() and t.removeprefix("-").isdigit() and len(t) <= 20 for t in texts):
        numbers = [int(text) for text in texts]
        return np.array(numbers, np.int64) if all(n in _INT64 for n in numbers) else None
    if len(set(texts)) < len(texts) or not all(_UUID.fullmatch(t) or _NUMBERED.fullmatch(t) for t in texts):
        return None
    digests = [blake2b(text.lower().encode(), digest_size=8).digest() for text in texts]
    return np.array([int.from_bytes(digest, "little") >> 1 for digest in digests], np.int64)


def checked(boxes: B) -> B:
    """Return the boxes as they are.

    Raises:
        DecodeError: where a box isn't finite, or there are too many.
    """
    require_few(len(boxes))
    good, scored = finite(boxes)
    if not (good & scored).all():
        raise DecodeError(f"box {int(np.argmin(good & scored))} isn't finite")
    return boxes
