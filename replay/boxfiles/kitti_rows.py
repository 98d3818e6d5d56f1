"""Rows of KITTI's labels and results: https://www.cvlibs.net/datasets/kitti, devkits `object` and `tracking`."""

from collections.abc import Sequence

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.boxfiles.parse import number, whole
from fbench.replay.boxfiles.rows import Flat, Labelled, Solid
from fbench.replay.boxfiles.text import Line
from fbench.replay.errors import LogError

DONT_CARE = "DontCare"
CAMERA_T_LEVEL: Float64 = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64)
"""(4, 4) from a coordinate frame at the camera with x forward, y left, z up: there boxes stand upright. In the camera's
own, with z forward, yaw, pitch and roll of a box that stands upright aren't unique."""
_NAMES = (
    "truncated", "occluded", "alpha", "left", "top", "right", "bottom", "height", "width", "length", "x", "y", "z",
    "rotation_y", "score",
)  # fmt: skip


def labelled(line: Line, fields: Sequence[str], camera: str, track_id: int | None) -> Labelled:
    """Return the object of a row, its 3D box at the camera with x forward, y left, z up.

    Location is the middle of the bottom in the camera's coordinates (x right, y down, z forward); `rotation_y` turns
    about y, 0 where the object faces x.

    Args:
        line: For errors.
        fields: Class, then the 14 or 15 numbers.
        camera: Whose image 2D boxes are in.
        track_id: The object's.

    Raises:
        LogError: where a field isn't a number.
    """
    numbers = fields[1:]
    if len(numbers) not in (14, 15):
        raise LogError(f"{line.where}: {len(numbers)} numbers after the class, expected 14, or 15 with a score")
    v = {name: number(text, line.where, name) for name, text in zip(_NAMES, numbers, strict=False)}
    dont_care = fields[0] == DONT_CARE
    return Labelled(
        fields[0],
        None if dont_care or not _has_solid(v) else _solid(v),
        Flat(camera, (v["left"], v["top"], v["right"], v["bottom"])) if _has_flat(v) else None,
        label="other" if dont_care else None,
        score=v.get("score"),
        track_id=track_id,
        ignore=True if dont_care else None,
        occlusion=_known(v["occluded"]),
        truncation=_known(v["truncated"]),
    )


def track_id(text: str, where: str) -> int:
    """Return the id of a row of the tracking benchmark, -1 where it has none."""
    return max(whole(text, where, "track id"), -1)


def _solid(v: dict[str, float]) -> Solid:
    center = (v["z"], -v["x"], v["height"] / 2 - v["y"])
    return Solid(center, (v["length"], v["width"], v["height"]), (-v["rotation_y"] - np.pi / 2, 0.0, 0.0))


def _has_solid(v: dict[str, float]) -> bool:
    """Results in 2D alone have -1 as sizes, or -1000 as location."""
    return v["x"] > -1000 and any(v[name] != -1 for name in ("height", "width", "length"))


def _has_flat(v: dict[str, float]) -> bool:
    return any(v[name] != -1 for name in ("left", "top", "right", "bottom"))


def _known(value: float) -> float | None:
    return None if value == -1 else value
