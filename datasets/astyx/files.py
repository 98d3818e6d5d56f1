"""Files of the Astyx HiRes2019 set, turned into fbench's types."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Annotated

import numpy as np
import pyarrow as pa
from pyarrow import csv
from pydantic import BaseModel, Field, FiniteFloat

from fbench.datasets.importing.files import find_numbered, is_rotation, mount_of, read_image, read_json
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import FrameRange, read_bytes, require_folder
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import CameraModel, Kind, Rig
from fbench.replay.geometry.transforms import yaw_pitch_roll

CAMERA, LIDAR, RADAR = "camera_front", "lidar_vlp16", "radar_6455"
CALIBRATION, TRUTH = "calibration", "groundtruth_obj3d"
KINDS: dict[str, Kind] = {CAMERA: "camera", LIDAR: "lidar", RADAR: "radar"}
_SUFFIXES = {CAMERA: ".jpg", LIDAR: ".txt", RADAR: ".txt", CALIBRATION: ".json", TRUTH: ".json"}
_DIGITS = 6
_TOLERANCE = 1e-3  # Of the squared length of quaternions, which are written with few digits

LABELS = {
    "Car": "car", "Truck": "truck", "Bus": "bus", "Trailer": "trailer", "Towed Object": "trailer",
    "Person": "pedestrian", "Cyclist": "bicycle", "Motorcyclist": "motorcycle", "Other Vehicle": "other",
}  # fmt: skip
"""Classes of the set's specification; any other becomes `other` too."""

_Three = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_Four = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
_Length = Annotated[FiniteFloat, Field(gt=0)]


class CalibData(BaseModel):
    """Calibration of one sensor; `K` belongs to cameras only."""

    T_to_ref_COS: tuple[_Four, _Four, _Four, _Four]
    K: tuple[_Three, _Three, _Three] | None = None


class Sensor(BaseModel):
    """One sensor of a calibration file."""

    sensor_uid: str
    calib_data: CalibData


class Calibration(BaseModel):
    """One file of `calibration/`."""

    sensors: list[Sensor]


class Object(BaseModel):
    """One labeled object; `orientation_quat` is w, x, y, z."""

    classname: str
    center3d: _Three
    dimension3d: tuple[_Length, _Length, _Length]
    orientation_quat: _Four
    occlusion: FiniteFloat


class Objects(BaseModel):
    """One file of `groundtruth_obj3d/`."""

    objects: list[Object]


Files = Mapping[str, Mapping[int, Path]]


def scan(source: Path, frames: FrameRange) -> Files:
    """Find the files of chosen frames, by folder and frame number; other files and folders are left alone. Raises
    LogError where `source` isn't an Astyx folder, or has no LiDAR frames.
    """
    require_folder(source)
    for folder in (LIDAR, CALIBRATION):
        if not (source / folder).is_dir():
            raise LogError(f"{source}: not an Astyx folder, no {folder}/")
    files = {folder: find_numbered(source / folder, (suffix,), _DIGITS, frames) for folder, suffix in _SUFFIXES.items()}
    for folder in (LIDAR, CALIBRATION):
        if not files[folder]:
            raise LogError(f"{source / folder}: no frames, expected files like 000001{_SUFFIXES[folder]}")
    return files


def read_rig(files: Files) -> Rig:
    """Read the calibration, which must be the same in all frames; a sensor without any file is left out.

    Body coordinates are the set's reference frame, that of the radar. Raises LogError naming the first calibration that
    differs, isn't rigid or lacks a sensor.
    """
    (_, first), *others = sorted(files[CALIBRATION].items())
    calibration = read_json(first, Calibration)
    for _, path in others:
        if read_json(path, Calibration) != calibration:
            raise LogError(f"{path}: calibration differs from {first.name}, import frames of one calibration at a time")
    data = {sensor.sensor_uid: sensor.calib_data for sensor in calibration.sensors}
    used = [name for name in KINDS if files[name]]
    for name in used:
        if name not in data:
            raise LogError(f"{first}: no sensor '{name}'")
    cameras, mounts = {}, {}
    if files[CAMERA]:
        if data[CAMERA].K is None:
            raise LogError(f"{first}: {CAMERA}: no K")
        image = read_jpeg(files[CAMERA][min(files[CAMERA])], 0)
        cameras[CAMERA] = CameraModel(np.array(data[CAMERA].K), image.size_wh)
    for name in used:
        matrix = np.array(data[name].T_to_ref_COS)
        if not is_rotation(matrix[:3, :3]):
            why = "isn't a rotation, its columns must be orthonormal within 1e-3"
            raise LogError(f"{first}: {name}: T_to_ref_COS {why}")
        mounts[name] = mount_of(KINDS[name], matrix)
    return Rig(mounts, cameras)


def read_jpeg(path: Path, stamp_ns: int, size_wh: tuple[int, int] | None = None, number: int | None = None) -> Image:
    """Return an image, which must be `size_wh` [px] where that is given. Raises LogError naming the file."""
    image = read_image(path, CAMERA, stamp_ns, frame_number=number)
    if image.encoding != "jpeg":
        raise LogError(f"{path}: not a JPEG image")
    size = image.size_wh
    if size_wh is not None and size != size_wh:
        raise LogError(f"{path}: {size[0]}x{size[1]} px, expected {size_wh[0]}x{size_wh[1]} as in the first image")
    return image


def read_boxes(path: Path) -> Boxes3D:
    """Read the objects of one frame, in body coordinates.

    `label_certainty`, `measured_by` and `created_by` are dropped; `object_id` and `score` are always -1. Raises
    LogError naming file and field.
    """
    objects = read_json(path, Objects).objects
    angles = np.array([_angles(path, o.orientation_quat) for o in objects]).reshape(-1, 3)
    return Boxes3D(
        center_m=np.array([o.center3d for o in objects]).reshape(-1, 3),
        size_lwh_m=np.array([o.dimension3d for o in objects]).reshape(-1, 3),
        yaw_rad=angles[:, 0],
        pitch_rad=angles[:, 1],
        roll_rad=angles[:, 2],
        label=np.array([LABELS.get(o.classname, "other") for o in objects], dtype=np.str_),
        occlusion=np.array([o.occlusion for o in objects], dtype=np.float64),
        source_label=np.array([o.classname for o in objects], dtype=np.str_),
    )


def _angles(path: Path, wxyz: tuple[float, float, float, float]) -> tuple[float, float, float]:
    w, x, y, z = wxyz
    if abs(w * w + x * x + y * y + z * z - 1) > _TOLERANCE:
        raise LogError(f"{path}: orientation_quat isn't a unit quaternion: {w} {x} {y} {z}")
    return yaw_pitch_roll((x, y, z, w))


_LIDAR_HEADER = "X Y Z Reflectivity LaserID Timestamp"
_RADAR_HEADER = "X Y Z V_r Mag"
HOUR_US = 3_600_000_000
_BLOCK = 128 * 1024  # Files are parsed in blocks of so many bytes, as many at a time as there are cores


@dataclass(frozen=True, eq=False)
class LidarTable:
    """One file of `lidar_vlp16/`: xyz (N, 3) [m] and intensity, ring, time within the hour (N,) [us]."""

    xyz: Float64
    intensity: Float64
    ring: Int64
    time_us: Int64


def read_lidar(path: Path) -> LidarTable:
    """Read one sweep, in the LiDAR's coordinate frame. Raises LogError naming file and line."""
    table = _table(path, _LIDAR_HEADER)
    ring, time_us = table[:, 4], table[:, 5]
    if not (np.all((ring >= 0) & (ring < 2**16)) and np.all((time_us >= 0) & (time_us < HOUR_US))):
        raise LogError(f"{path}: expected LaserID from 0 to 65535 and Timestamp within one hour [us]")
    return LidarTable(table[:, :3], table[:, 3], ring.astype(np.int64), time_us.astype(np.int64))


def read_radar(path: Path) -> Float64:
    """Read one scan (N, 5): x, y, z [m], V_r [m/s], magnitude [dB], in the radar's coordinate frame. Raises LogError
    naming file and line.
    """
    return _table(path, _RADAR_HEADER)


def _table(path: Path, header: str) -> Float64:
    """Parse numbers under a header; some files have an empty line above it."""
    data, names = read_bytes(path), header.encode().split()
    top, _, body = data.lstrip().partition(b"\n")
    if top.split() == names and (values := _plain_values(body, len(names))) is not None:
        return values
    return _values(path, [line.split() for line in data.splitlines()], names)


def _plain_values(body: bytes, num: int) -> Float64 | None:
    """Parse rows of numbers with one space between them; `None` where they are anything else."""
    columns = [str(i) for i in range(num)]
    try:
        table = csv.read_csv(
            pa.BufferReader(body),
            csv.ReadOptions(block_size=_BLOCK, column_names=columns),
            csv.ParseOptions(delimiter=" ", quote_char=False),
            csv.ConvertOptions(column_types=dict.fromkeys(columns, pa.float64()), null_values=[]),
        )
    except pa.ArrowInvalid:
        return None
    return np.column_stack([column.to_numpy() for column in table.columns])


def _values(path: Path, rows: list[list[bytes]], names: list[bytes]) -> Float64:
    """Parse what isn't plain, or say where it is wrong."""
    top = next((i for i, row in enumerate(rows) if row), 0)
    if rows[top : top + 1] != [names]:
        raise LogError(f"{path}: line {top + 1}: expected the header '{b' '.join(names).decode()}'")
    body = [row for row in rows[top + 1 :] if row]
    try:
        values = np.fromiter(map(float, chain.from_iterable(body)), np.float64)
    except ValueError as error:
        raise _malformed(path, rows, top, len(names)) from error
    if any(len(row) != len(names) for row in body):
        raise _malformed(path, rows, top, len(names))
    return values.reshape(-1, len(names))


def _malformed(path: Path, rows: list[list[bytes]], top: int, num: int) -> LogError:
    bad = next(i for i, row in enumerate(rows) if i > top and row and not _is_numeric(row, num))
    return LogError(f"{path}: line {bad + 1}: expected {num} numbers")


def _is_numeric(row: list[bytes], num: int) -> bool:
    try:
        return len([float(value) for value in row]) == num
    except ValueError:
        return False
