"""Sensors of KITTI's car, and the calibration files of the object and tracking benchmarks.

A. Geiger, P. Lenz, C. Stiller and R. Urtasun, "Vision meets Robotics: The KITTI Dataset", IJRR 2013, section IV.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fbench.datasets.importing.files import BODY_T_OPTICAL, is_pinhole, is_rotation, mount_of
from fbench.replay.contracts.errors import DecodeError, LimitError, LogError
from fbench.replay.contracts.importing import read_bytes, require_file
from fbench.replay.data.arrays import Float64
from fbench.replay.data.images import read_size
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.formats.objects import LabeledObject
from fbench.replay.formats.text import Line, lines, parse_number

LIDAR = "velodyne"
BODY_T_CAMERA0 = BODY_T_OPTICAL
"""(4, 4) from the rectified camera 0 (x right, y down, z forward) to the body.

Body coordinates have their origin in the rectified camera 0, so that labels, which are given there and stand upright
there, are the same boxes in the log, whatever the calibration of the other sensors.
"""
Size = tuple[int, int]
_BY_FOCAL_LENGTH: Mapping[float, tuple[str, Size]] = {
    721.5377: ("2011_09_26", (1242, 375)),
    707.0493: ("2011_09_28", (1224, 370)),
    718.3351: ("2011_09_29", (1238, 374)),
    707.0912: ("2011_09_30", (1226, 370)),
    718.856: ("2011_10_03", (1241, 376)),
}
"""Day of recording and size [px], by the focal length [px] of the rectified cameras, which is that of the day."""
_MAX_SIDE_PX = 2**16
_RECTIFICATION = ("R0_rect", "R_rect")
_LIDAR = ("Tr_velo_to_cam", "Tr_velo_cam")
_IMU = ("Tr_imu_to_velo", "Tr_imu_velo")
_SHAPES: dict[str, tuple[int, int]] = {
    **{f"P{i}": (3, 4) for i in range(4)},
    **dict.fromkeys(_RECTIFICATION, (3, 3)),
    **dict.fromkeys((*_LIDAR, *_IMU), (3, 4)),
}
"""The object benchmark writes the first name of each pair, with a colon; the tracking benchmark the second, without."""
_MAX_NUMBER = 1e6  # In a matrix


@dataclass(frozen=True, eq=False)
class Calibration:
    """What KITTI's calibration files say; coordinates of camera 0 are the rectified ones."""

    projections: Mapping[int, Float64]  # P (3, 4) of the rectified cameras by number, from rectified camera 0 to pixels
    camera0_T_velo: Float64 | None = None  # (4, 4), rectification included
    velo_T_imu: Float64 | None = None  # (4, 4)

    @property
    def body_T_imu(self) -> Float64 | None:
        """(4, 4) where the calibration tells it."""
        if self.camera0_T_velo is None or self.velo_T_imu is None:
            return None
        return BODY_T_CAMERA0 @ self.camera0_T_velo @ self.velo_T_imu


def camera_name(number: int) -> str:
    """Name of a camera: that of its folder."""
    return f"image_{number:02d}"


def rig_of(calibration: Calibration, sizes_wh: Mapping[int, tuple[int, int]], has_lidar: bool) -> Rig:
    """Return the sensors: the rectified cameras whose sizes [px] are given, and the LiDAR where there is one, else
    ValueError. P = K [I | t] gives the camera's position -t in rectified camera 0 (paper, equation 4); a camera needs
    one (KeyError).
    """
    mounts, cameras = {}, {}
    for number, size_wh in sorted(sizes_wh.items()):
        P = calibration.projections[number]
        K = P[:, :3]
        camera0_T_camera = np.eye(4)
        camera0_T_camera[:3, 3] = -np.linalg.solve(K, P[:, 3])
        mounts[camera_name(number)] = mount_of("camera", BODY_T_CAMERA0 @ camera0_T_camera)
        cameras[camera_name(number)] = CameraModel(np.array(K), size_wh)
    if has_lidar:
        if calibration.camera0_T_velo is None:
            raise ValueError("the calibration doesn't tell where the LiDAR is")
        mounts[LIDAR] = mount_of("lidar", BODY_T_CAMERA0 @ calibration.camera0_T_velo)
    return Rig(mounts, cameras)


def size_without_images(P: Float64, objects: Iterable[LabeledObject]) -> tuple[Size, str]:
    """Return a size [px] for the camera of a projection (3, 4) that there are no images of, and how it is known.

    It is that of the day; else that of the smallest image that holds all labeled boxes; without any, that of the image
    whose middle is the principal point.
    """
    if (known := _BY_FOCAL_LENGTH.get(round(float(P[0, 0]), 4))) is not None:
        day, size_wh = known
        return size_wh, f"without images: that of {day}, the day of recording by its focal length"
    corners = [row.flat.xyxy_px[2:] for row in objects if row.flat is not None]
    if corners:
        right, bottom = (max(values) for values in zip(*corners, strict=True))
        return _size(right + 1, bottom + 1), "without images: the smallest that holds all labeled boxes"
    return _size(2 * P[0, 2], 2 * P[1, 2]), "without images: twice the principal point"


def _size(width: float, height: float) -> Size:
    return min(max(math.ceil(width), 1), _MAX_SIDE_PX), min(max(math.ceil(height), 1), _MAX_SIDE_PX)


def first_size(paths: Iterable[Path]) -> Size | None:
    """Return the size [px] of the first image whose header can be read; `None` where there is none."""
    for path in paths:
        try:
            return read_size(read_bytes(path))
        except (LogError, DecodeError):
            continue  # whoever reads it for its pixels tells what is wrong with it
    return None


SPLITS = ("training", "testing")
IMAGES = (".png", ".jpg")
POINTS = (".bin",)
SENSORS: Mapping[str, tuple[str, ...]] = {camera_name(2): IMAGES, camera_name(3): IMAGES, LIDAR: POINTS}
"""Suffixes of files by the sensors that the benchmarks have, in the order in which one becomes the reference."""
_MAX_TEXT_BYTES = 64 * 2**20


def split_folders(source: Path) -> Mapping[str, Path]:
    """Return the folders that may hold a benchmark's files, by what names of sequences begin with: `source` itself;
    else its `training/` and `testing/`, which are told apart by name where both are there.
    """
    inner = [source / split for split in SPLITS if (source / split).is_dir()]
    if len(inner) > 1:
        return {f"{folder.name}/": folder for folder in inner}
    return {"": inner[0] if inner else source}


def read_bounded_lines(path: Path, comma: bool = False) -> Iterator[Line]:
    """Return the lines of a text, split at blanks or commas. LogError: isn't readable UTF-8; LimitError: too large."""
    if path.exists():
        require_file(path)
    if path.is_file() and (size := path.stat().st_size) > _MAX_TEXT_BYTES:
        raise LimitError(f"{path}: {size} bytes, more than {_MAX_TEXT_BYTES}; no such file of KITTI is that large")
    return lines(path, "," if comma else None)


@dataclass(frozen=True)
class KittiParams:
    """Parameters of `Kitti`."""

    detections: Path | None = None
    """Folder with another system's results, `NNNN.txt` for each sequence of the tracking benchmark or `FFFFFF.txt` for
    each frame of the object benchmark; they become recorded results."""


def read_calibration(path: Path, cameras: Collection[int], needs_lidar: bool) -> Calibration:
    """Read what one file says of sensors: at least of the cameras of these numbers, and of the LiDAR if it is needed;
    keys that aren't known are left alone. Raises LogError naming line and key, where one is missing, has another count
    of numbers, or can't be a calibration.
    """
    found: dict[str, Float64] = {}
    for line in read_bounded_lines(path):
        key = line.fields[0].removesuffix(":")
        if key in found:
            raise LogError(f"{line.where}: {key} a second time")
        if key in _SHAPES:
            found[key] = _matrix(line, key)
    missing = [f"P{i}" for i in sorted(cameras) if f"P{i}" not in found]
    if needs_lidar:
        missing += [keys[0] for keys in (_RECTIFICATION, _LIDAR) if not found.keys() & set(keys)]
    if missing:
        raise LogError(f"{path}: no {missing[0]}")
    pairs = (_RECTIFICATION, _LIDAR, _IMU)
    rectification, velo, imu = (next((_square(found[key]) for key in keys if key in found), None) for keys in pairs)
    camera0_T_velo = None if rectification is None or velo is None else rectification @ velo
    return Calibration({i: found[f"P{i}"] for i in range(4) if f"P{i}" in found}, camera0_T_velo, imu)


def _matrix(line: Line, key: str) -> Float64:
    rows, columns = _SHAPES[key]
    texts = line.fields[1:]
    if len(texts) != rows * columns:
        raise LogError(f"{line.where}: {key} has {len(texts)} numbers, expected {rows * columns}")
    values = np.array([parse_number(text, line.where, key) for text in texts]).reshape(rows, columns)
    if not np.all(np.abs(values) < _MAX_NUMBER):  # also false for NaN
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
