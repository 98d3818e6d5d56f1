"""Boxes of scenes that other programs made for viewers (`SceneUpdate` of Foxglove, Protobuf or ROS): cubes with a pose,
a size, and whatever the metadata of their entity say.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.classes import labels
from fbench.replay.logs.box_parts import checked, matrix, orientation, require_few, track_ids, turned

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
    text, then its id, tells it. Speeds are along the heading.

    Raises:
        DecodeError: where a box isn't finite, or there are too many.
    """
    require_few(sum(len(entity.cubes) for entity in entities))
    cubes = [(entity, cube) for entity in entities for cube in entity.cubes]
    said = [_metadata(entity) for entity, _ in cubes]
    xyzw = matrix([cube.pose.orientation for _, cube in cubes], "xyzw")
    boxes = Boxes3D(
        matrix([cube.pose.position for _, cube in cubes], "xyz"), matrix([cube.size for _, cube in cubes], "xyz"),
        **orientation(xyzw), **labels([_label(entity, words) for (entity, _), words in zip(cubes, said, strict=True)]),
        velocity_mps=_velocities(said, xyzw), score=_scores(said),
        track_id=track_ids([_id(entity, words) for (entity, _), words in zip(cubes, said, strict=True)]),
    )  # fmt: skip
    return checked(boxes), tuple(str(entity.frame_id).removeprefix("/") for entity, _ in cubes)


def _metadata(entity: Any) -> dict[str, str]:
    return {re.sub(r"[\s_\-.]", "", str(pair.key)).lower(): str(pair.value).strip() for pair in entity.metadata}


def _first(words: Mapping[str, str], keys: Sequence[str]) -> str:
    return next((words[key] for key in keys if words.get(key)), "")


def _label(entity: Any, words: Mapping[str, str]) -> str:
    named = _first(words, _LABELS)
    if named:
        return named
    texts = (_WORD.match(str(text.text)) for text in entity.texts)
    word = next((match for match in texts if match), None) or _NAMED.fullmatch(str(entity.id))
    return "" if word is None else word[1]


def _id(entity: Any, words: Mapping[str, str]) -> str:
    named = _first(words, _IDS)
    if named:
        return named
    number = _NUMBER.fullmatch(str(entity.id))
    return str(entity.id) if number is None else number[1]


def _scores(said: Sequence[Mapping[str, str]]) -> Float64 | None:
    values = [_numbers(_first(words, _SCORES)) for words in said]
    if not values or not all(len(value) == 1 for value in values):
        return None
    return np.array([value[0] for value in values], np.float64)


def _velocities(said: Sequence[Mapping[str, str]], xyzw: Float64) -> Float64 | None:
    rows = [_velocity(words) for words in said]
    speeds = [_numbers(_first(words, _SPEEDS)) for words in said]
    if not any(rows) and not any(speeds):
        return None
    ahead = np.array([(speed[0], 0.0, 0.0) if len(speed) == 1 else (np.nan,) * 3 for speed in speeds], np.float64)
    along = turned(xyzw, ahead).tolist()
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
