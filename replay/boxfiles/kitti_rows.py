"""Rows of KITTI's labels and results: https://www.cvlibs.net/datasets/kitti, devkits `object` and `tracking`.

And the same numbers in another order, comma-separated: detections as AB3DMOT takes them,
https://github.com/xinshuoweng/AB3DMOT.
"""

from collections.abc import Mapping, Sequence

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
_AB3DMOT_NAMES = (
    "left", "top", "right", "bottom", "score", "height", "width", "length", "x", "y", "z", "rotation_y", "alpha",
)  # fmt: skip
AB3DMOT_COLUMNS = 2 + len(_AB3DMOT_NAMES)
"""Frame, number of the class, then these."""
UNKNOWN_ALPHA = -10
"""What stands for an angle of observation that nobody knows."""
AB3DMOT_CLASSES = {1: "Pedestrian", 2: "Car", 3: "Cyclist"}


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
    return _object(fields[0], v, camera, track_id)


def ab3dmot(line: Line, camera: str) -> Labelled:
    """Return the detection of a row of AB3DMOT's, its 3D box as in `labelled`; it has no id.

    Raises:
        LogError: where a column is missing or isn't a number.
    """
    if len(line.fields) != AB3DMOT_COLUMNS:
        names = ", ".join(("frame", "class", *_AB3DMOT_NAMES))
        raise LogError(f"{line.where}: {len(line.fields)} columns, expected {AB3DMOT_COLUMNS}: {names}")
    kind = whole(line.fields[1], line.where, "class")
    v = {n: number(text, line.where, n) for n, text in zip(_AB3DMOT_NAMES, line.fields[2:], strict=True)}
    return _object(AB3DMOT_CLASSES.get(kind, str(kind)), v, camera, None)


def _object(name: str, v: Mapping[str, float], camera: str, track_id: int | None) -> Labelled:
    dont_care = name == DONT_CARE
    return Labelled(
        name,
        None if dont_care or not _has_solid(v) else _solid(v),
        Flat(camera, (v["left"], v["top"], v["right"], v["bottom"])) if _has_flat(v) else None,
        label="other" if dont_care else None,
        score=v.get("score"),
        track_id=track_id,
        ignore=True if dont_care else None,
        occlusion=_known(v.get("occluded", -1)),
        truncation=_known(v.get("truncated", -1)),
        alpha_rad=None if v["alpha"] == UNKNOWN_ALPHA else v["alpha"],
    )


def track_id(text: str, where: str) -> int:
    """Return the id of a row of the tracking benchmark, -1 where it has none."""
    return max(whole(text, where, "track id"), -1)


def _solid(v: Mapping[str, float]) -> Solid:
    center = (v["z"], -v["x"], v["height"] / 2 - v["y"])
    return Solid(center, (v["length"], v["width"], v["height"]), (-v["rotation_y"] - np.pi / 2, 0.0, 0.0))


def _has_solid(v: Mapping[str, float]) -> bool:
    """Results in 2D alone have -1 as sizes, or -1000 as location, or 0 as both: nothing is inside the camera."""
    size, place = [v[name] for name in ("height", "width", "length")], [v[name] for name in ("x", "y", "z")]
    return v["x"] > -1000 and any(value != -1 for value in size) and any(size + place)


def _has_flat(v: Mapping[str, float]) -> bool:
    return any(v[name] != -1 for name in ("left", "top", "right", "bottom"))


def _known(value: float) -> float | None:
    return None if value == -1 else value
