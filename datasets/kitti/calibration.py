"""Calibration files of the object and tracking benchmarks: one line a matrix."""

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from fbench.datasets.importing.summary import is_pinhole, is_rotation
from fbench.datasets.kitti.files import bounded_lines
from fbench.datasets.kitti.rig import Calibration
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Float64
from fbench.replay.formats.text import Line, parse_number

_RECTIFICATION = ("R0_rect", "R_rect")
_LIDAR = ("Tr_velo_to_cam", "Tr_velo_cam")
_IMU = ("Tr_imu_to_velo", "Tr_imu_velo")
_SHAPES: dict[str, tuple[int, int]] = {
    **{f"P{i}": (3, 4) for i in range(4)},
    **dict.fromkeys(_RECTIFICATION, (3, 3)),
    **dict.fromkeys((*_LIDAR, *_IMU), (3, 4)),
}
"""The object benchmark writes the first name of each pair, with a colon; the tracking benchmark the second, without."""
_MAX = 1e6


def read_calibration(path: Path, cameras: Collection[int], needs_lidar: bool) -> Calibration:
    """Read what one file says of sensors; keys that aren't known are left alone.

    Args:
        path: The file.
        cameras: Numbers of the cameras that must be in it.
        needs_lidar: Whether the LiDAR must be in it.

    Raises:
        LogError: naming line and key, where one is missing, has another count of numbers, or can't be a calibration.
    """
    found = _matrices(path)
    missing = [f"P{i}" for i in sorted(cameras) if f"P{i}" not in found]
    if needs_lidar:
        missing += [keys[0] for keys in (_RECTIFICATION, _LIDAR) if not any(key in found for key in keys)]
    if missing:
        raise LogError(f"{path}: no {missing[0]}")
    rectification, velo, imu = (
        next((found[key] for key in keys if key in found), None) for keys in (_RECTIFICATION, _LIDAR, _IMU)
    )
    return Calibration(
        {i: found[f"P{i}"] for i in range(4) if f"P{i}" in found},
        None if rectification is None or velo is None else _square(rectification) @ _square(velo),
        None if imu is None else _square(imu),
    )


def _matrices(path: Path) -> Mapping[str, Float64]:
    found: dict[str, Float64] = {}
    for line in bounded_lines(path):
        key = line.fields[0].removesuffix(":")
        if key in found:
            raise LogError(f"{line.where}: {key} a second time")
        if key in _SHAPES:
            found[key] = _matrix(line, key)
    return found


def _matrix(line: Line, key: str) -> Float64:
    rows, columns = _SHAPES[key]
    texts = line.fields[1:]
    if len(texts) != rows * columns:
        raise LogError(f"{line.where}: {key} has {len(texts)} numbers, expected {rows * columns}")
    values = np.array([parse_number(text, line.where, key) for text in texts]).reshape(rows, columns)
    if not np.all(np.abs(values) < _MAX):  # also false for NaN
        raise LogError(f"{line.where}: {key} has a number that isn't finite, or is beyond all reason")
    is_projection, square = key.startswith("P"), values[:, :3]
    if is_projection and not is_pinhole(square):
        raise LogError(f"{line.where}: {key} isn't a camera's projection, expected fx 0 cx tx 0 fy cy ty 0 0 1 tz")
    if not is_projection and not is_rotation(square):
        raise LogError(f"{line.where}: {key} isn't a rotation, its columns must be orthonormal within 1e-3")
    return values


def _square(matrix: Float64) -> Float64:
    whole = np.eye(4)
    whole[: matrix.shape[0], : matrix.shape[1]] = matrix
    return whole
