"""Boxes from messages: scenes of viewers, whose boxes are cubes with metadata, and columns of box parts."""

import re
from collections.abc import Mapping, Sequence
from hashlib import blake2b
from typing import Any, TypeVar

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Boxes3D, finite
from fbench.replay.data.classes import labels

B = TypeVar("B", Boxes2D, Boxes3D)
_INT64 = range(-(2**63), 2**63)
_UUID = re.compile(r"[0-9a-fA-F]{8}[0-9a-fA-F-]{8,}", re.ASCII)
_NUMBERED = re.compile(r"[a-zA-Z][\w ./:#-]{0,126}[0-9]", re.ASCII)
"""A name with a number of its own; without one it may as well be a class."""
_MAX_BOXES = 10_000  # As of programs' answers; many more than any stack gives, and few enough to compare each with each


def _require_few(num: int) -> None:
    if num > _MAX_BOXES:
        raise DecodeError(f"{num} boxes in one message, more than {_MAX_BOXES}")


def matrix(parts: Sequence[Any], names: str) -> Float64:
    """Attributes of each part (N, len(names)), such as `x`, `y`, `z`. Raises DecodeError where a part lacks one."""
    try:
        rows = [[getattr(part, name) for name in names] for part in parts]
    except AttributeError as error:
        raise DecodeError(f"message has no field '{error.name}'") from error
    return np.array(rows, np.float64).reshape(-1, len(names))


def orientation(xyzw: Float64) -> dict[str, Any]:
    """Columns of the angles (N,) of quaternions (N, 4) with R = Rz(yaw) Ry(pitch) Rx(roll); roll is 0 at pitch +-90
    deg, upright boxes have yaw alone. An orientation of zeros, which means that none was given, is yaw 0.
    """
    largest = np.abs(xyzw).max(axis=1, keepdims=True)
    given = np.where(largest == 0, [0.0, 0.0, 0.0, 1.0], xyzw / np.where(largest > 0, largest, 1.0))
    x, y, z, w = (given / np.sqrt((given**2).sum(axis=1, keepdims=True))).T
    r00, r10, r20 = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    r21, r22 = 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    across = np.hypot(r00, r10)
    locked = across < 1e-9
    yaw = np.where(locked, np.arctan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z)), np.arctan2(r10, r00))
    pitch, roll = np.arctan2(-r20, across), np.where(locked, 0.0, np.arctan2(r21, r22))
    return {"yaw_rad": yaw} | ({"pitch_rad": pitch, "roll_rad": roll} if pitch.any() or roll.any() else {})


def rotate(xyzw: Float64, vectors: Float64) -> Float64:
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


def check_boxes(boxes: B) -> B:
    """Return the boxes as they are. Raises DecodeError where a box isn't finite, or there are too many."""
    _require_few(len(boxes))
    good, scored = finite(boxes)
    if not (good & scored).all():
        raise DecodeError(f"box {int(np.argmin(good & scored))} isn't finite")
    return boxes


_LABELS = ("label", "class", "classname", "classlabel", "classification", "category", "categoryname", "objectclass",
           "objecttype", "type", "semantic")  # fmt: skip
_SCORES = ("score", "confidence", "probability", "existenceprobability", "conf", "prob")
_IDS = ("trackid", "trackingid", "objectid", "instanceid", "instance", "instancetoken", "id", "uuid")
_VELOCITIES = ("velocity", "velocitymps", "linearvelocity", "vel")
_COMPONENTS = (("vx", "vy", "vz"), ("velocityx", "velocityy", "velocityz"), ("velx", "vely", "velz"))
_SPEEDS = ("speed", "speedmps")
_WORD = re.compile(r"\s*([A-Za-z]+(?:[ _.\-/][A-Za-z]+)*)")
_NAMED = re.compile(_WORD.pattern + r"[ _.\-/:#]*\d*", re.ASCII)
"""An id that says what the object is: a word, then at most a number."""
_NUMBER = re.compile(r"(?:.*[^0-9.])?(\d{1,18})", re.ASCII | re.DOTALL)


def scene_boxes(entities: Sequence[Any]) -> tuple[Boxes3D, tuple[str, ...]]:
    """Return the boxes of entities, each in the coordinate frame of its entity, and these coordinate frames.

    Keys of metadata count whatever their case, spaces and dashes. Scores, velocities and ids are there where all boxes
    have them; an entity whose metadata have no id may end in its number. Without a class in the metadata the entity's
    text, then its id, tells it. Speeds are along the heading. Raises DecodeError where a box isn't finite, or there are
    too many.
    """
    _require_few(sum(len(entity.cubes) for entity in entities))
    cubes = [(entity, cube) for entity in entities for cube in entity.cubes]
    said = [
        {re.sub(r"[\s_\-.]", "", str(pair.key)).lower(): str(pair.value).strip() for pair in entity.metadata}
        for entity, _ in cubes
    ]
    xyzw = matrix([cube.pose.orientation for _, cube in cubes], "xyzw")
    scores = [_numbers(_first(words, _SCORES)) for words in said]
    boxes = Boxes3D(
        matrix([cube.pose.position for _, cube in cubes], "xyz"), matrix([cube.size for _, cube in cubes], "xyz"),
        **orientation(xyzw), **labels([_label(entity, words) for (entity, _), words in zip(cubes, said, strict=True)]),
        velocity_mps=_velocities(said, xyzw),
        score=np.concatenate(scores) if scores and all(len(score) == 1 for score in scores) else None,
        track_id=track_ids([_id(entity, words) for (entity, _), words in zip(cubes, said, strict=True)]),
    )  # fmt: skip
    return check_boxes(boxes), tuple(str(entity.frame_id).removeprefix("/") for entity, _ in cubes)


def _first(words: Mapping[str, str], keys: Sequence[str]) -> str:
    return next((words[key] for key in keys if words.get(key)), "")


def _label(entity: Any, words: Mapping[str, str]) -> str:
    if named := _first(words, _LABELS):
        return named
    texts = (_WORD.match(str(text.text)) for text in entity.texts)
    word = next((match for match in texts if match), None) or _NAMED.fullmatch(str(entity.id))
    return "" if word is None else word[1]


def _id(entity: Any, words: Mapping[str, str]) -> str:
    number = _NUMBER.fullmatch(str(entity.id))
    return _first(words, _IDS) or (str(entity.id) if number is None else number[1])


def _velocities(said: Sequence[Mapping[str, str]], xyzw: Float64) -> Float64 | None:
    rows = [_velocity(words) for words in said]
    speeds = [_numbers(_first(words, _SPEEDS)) for words in said]
    if not any(rows) and not any(speeds):
        return None
    ahead = np.array([(speed[0], 0.0, 0.0) if len(speed) == 1 else (np.nan,) * 3 for speed in speeds], np.float64)
    along = rotate(xyzw, ahead).tolist()
    return np.array([row or tuple(other) for row, other in zip(rows, along, strict=True)], np.float64)


def _velocity(words: Mapping[str, str]) -> tuple[float, ...]:
    """Three numbers, none where nothing is said; the last one may be left out."""
    joined = _numbers(_first(words, _VELOCITIES))
    parts = [[_numbers(words.get(key, "")) for key in keys] for keys in _COMPONENTS]
    apart = next((tuple(n[0] for n in part if n) for part in parts if len(part[0]) == len(part[1]) == 1), ())
    found = joined if len(joined) in (2, 3) else apart
    return (*found, 0.0)[:3] if found else ()


def _numbers(text: str) -> tuple[float, ...]:
    """Numbers of a text such as `[1.5, 2, 0]`; none where anything else is in it."""
    try:
        return tuple(float(part) for part in re.split(r"[\s,;]+", text.strip("()[]{} ")) if part)
    except ValueError:
        return ()
