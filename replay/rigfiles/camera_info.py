"""Intrinsics as camera_calibration and camera_info_manager of ROS write them (YAML).

Keys after http://wiki.ros.org/camera_calibration_parsers. `rectification_matrix` and `projection_matrix` are those of
rectified images; fbench uses images as they are, so it takes only `camera_matrix` and the distortion.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fbench.replay.errors import ConfigError
from fbench.replay.rig_patch import RigPatch
from fbench.replay.rigfiles.values import MALFORMED, camera_model, known_model, natural, numbers, shown


def read_camera_info(path: Path, tree: Mapping[str, object]) -> RigPatch:
    """Return the camera of a file, under its `camera_name`, else under the name of the file.

    Raises:
        ConfigError: naming the key that is wrong.
    """
    size_wh = (_natural(path, tree, "image_width"), _natural(path, tree, "image_height"))
    K = np.array(_data(path, tree, "camera_matrix", 3, 3)).reshape(3, 3)
    distortion = _data(path, tree, "distortion_coefficients", 1) if "distortion_coefficients" in tree else []
    model = known_model(f"{path}: distortion_model", _text(path, tree, "distortion_model", "plumb_bob"))
    name = _text(path, tree, "camera_name", path.stem) or path.stem
    return RigPatch(cameras={name: camera_model(f"{path}: {name}", K, size_wh, model, distortion)})


def _natural(path: Path, tree: Mapping[str, object], key: str) -> int:
    if key not in tree:
        raise ConfigError(f"{path}: no '{key}'", MALFORMED)
    return natural(f"{path}: {key}", tree[key])


def _text(path: Path, tree: Mapping[str, object], key: str, default: str) -> str:
    value = tree.get(key, default)
    if not isinstance(value, str):
        raise ConfigError(f"{path}: {key}: expected a text, got {shown(value)}", MALFORMED)
    return value.strip()


def _data(path: Path, tree: Mapping[str, object], key: str, rows: int, cols: int | None = None) -> list[float]:
    """Return the numbers of `{rows, cols, data}`, row by row."""
    value = tree.get(key)
    if not isinstance(value, Mapping) or "data" not in value:
        raise ConfigError(f"{path}: no '{key}' with rows, cols and data", MALFORMED)
    found = tuple(natural(f"{path}: {key}.{n}", value[n]) for n in ("rows", "cols") if n in value and value[n] != "0")
    data = numbers(f"{path}: {key}.data", value["data"], None if cols is None else rows * cols)
    if len(found) == 2 and found != (rows, len(data) // rows):
        raise ConfigError(
            f"{path}: {key}: expected {rows}x{len(data) // rows}, got {found[0]}x{found[1]} (rows x cols)", MALFORMED
        )
    return data
