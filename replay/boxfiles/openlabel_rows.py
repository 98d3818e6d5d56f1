"""Objects of an OpenLABEL file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fbench.replay.boxfiles.json_file import items, mapping, scalar, vector
from fbench.replay.boxfiles.parse import track_number
from fbench.replay.boxfiles.rotations import angles
from fbench.replay.boxfiles.rows import Flat, Labelled, Solid, Triple

_NUMBERS = {
    "score": "score", "confidence": "score", "occlusion": "occlusion", "truncation": "truncation",
    "visibility": "visibility", "num_points": "num_lidar_pts", "num_lidar_pts": "num_lidar_pts",
}  # fmt: skip
"""Fields of fbench by the names of numbers among an object's attributes."""


def labelled(
    name: str, uid: str, solid: Solid | None, flat: Flat | None, told: Sequence[Mapping[str, Any]], where: str
) -> Labelled:
    """Return an object with what the numbers among its data say.

    Raises:
        LogError: where one isn't a number.
    """
    values: dict[str, float] = {}
    for source in told:
        for item in items(source.get("num", []), f"{where}: num"):
            entry = mapping(item, f"{where}: num")
            key = _NUMBERS.get(str(entry.get("name", "")).lower())
            if key is not None:
                values[key] = scalar(entry.get("val"), f"{where}: {key}")
    points = values.get("num_lidar_pts", np.nan)
    return Labelled(
        name, solid, flat, track_id=track_number(uid), score=values.get("score"),
        visibility=values.get("visibility"), occlusion=values.get("occlusion"), truncation=values.get("truncation"),
        num_lidar_pts=int(points) if 0 <= points < 2**31 else None,
    )  # fmt: skip


def solid(box: Mapping[str, Any], where: str) -> Solid:
    """Return the box of a `cuboid`: ten numbers with a quaternion x, y, z, w between position and size, or nine with
    angles about x, y, z, R = Rz Ry Rx.
    """
    val = vector(box.get("val"), (9, 10), f"{where}: val")
    if len(val) == 10:
        turn: Triple = angles(val[3], val[4], val[5], val[6], where)
    else:
        turn = (val[5], val[4], val[3])
    return Solid((val[0], val[1], val[2]), (val[-3], val[-2], val[-1]), turn)


def flat(camera: str, box: Mapping[str, Any], where: str) -> Flat:
    """Return the box of a `bbox`: the middle, width and height."""
    x, y, width, height = vector(box.get("val"), (4,), f"{where}: val")
    return Flat(camera, (x - width / 2, y - height / 2, x + width / 2, y + height / 2))
