"""Sensors of a nuScenes scene, and its radar scans (binary PCD files).

Format: https://pointclouds.org/documentation/tutorials/pcd_file_format.html; fields:
https://github.com/nutonomy/nuscenes-devkit, `RadarPointCloud` in `utils/data_classes.py`.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fbench.datasets.importing.files import is_pinhole
from fbench.datasets.nuscenes.tables import DataRow, Tables
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import read_bytes
from fbench.replay.data.arrays import Array, Bool
from fbench.replay.data.messages import RadarScan
from fbench.replay.data.rig import CameraModel, Mount, Rig

_MEASURED = ("x", "y", "z", "rcs", "vx", "vy")
_FLAGS = ("invalid_state", "dyn_prop", "ambig_state")
_TYPES = {
    ("F", "4"): "<f4", ("F", "8"): "<f8", ("I", "1"): "i1", ("I", "2"): "<i2", ("I", "4"): "<i4", ("I", "8"): "<i8",
    ("U", "1"): "u1", ("U", "2"): "<u2", ("U", "4"): "<u4", ("U", "8"): "<u8",
}  # fmt: skip
_MAX_HEADER = 8192
_MAX_ECHOES = 1_000_000


def read_scan(
    path: Path, sensor: str, stamp_ns: int, filtered: bool, frame_number: int | None = None
) -> tuple[RadarScan, int]:
    """Read one scan, and say how many echoes the filter dropped. Echoes that aren't finite are left out, as in files of
    scans without any.

    The radial velocity is that along the line of sight, (x vx + y vy) / |(x, y, z)|; the radar measures no vertical
    velocity. `vx_comp` and `vy_comp`, from which the ego motion is removed, aren't used. Raises LogError where the file
    is truncated or isn't such a PCD.
    """
    table = _read_table(path)
    needed = [*_MEASURED, *(_FLAGS if filtered else ())]
    for name in needed:
        if name not in (table.dtype.names or ()):
            raise LogError(f"{path}: no field '{name}'")
    table = table[np.logical_and.reduce([np.isfinite(table[name]) for name in _MEASURED])]
    kept = table[is_kept(table)] if filtered else table
    columns = {name: kept[name].astype(np.float64) for name in _MEASURED}
    x, y, z = columns["x"], columns["y"], columns["z"]
    distance = np.sqrt(x * x + y * y + z * z)
    along = x * columns["vx"] + y * columns["vy"]
    receding = np.divide(along, distance, out=np.full(len(kept), np.nan), where=distance > 0)
    xyz = np.stack([x, y, z], axis=1).astype(np.float32)
    receding, rcs = receding.astype(np.float32), columns["rcs"].astype(np.float32)
    scan = RadarScan(sensor, stamp_ns, stamp_ns, xyz, receding, rcs, frame_number=frame_number)
    return scan, len(table) - len(kept)


def is_kept(table: Array) -> Bool:
    """Tell which echoes (N,) nuscenes-devkit keeps by default: valid (`invalid_state` 0), with a dynamic property
    (`dyn_prop` 0 to 6) and without ambiguity of the velocity (`ambig_state` 3).
    """
    moving = (table["dyn_prop"] >= 0) & (table["dyn_prop"] <= 6)
    kept: Bool = (table["invalid_state"] == 0) & moving & (table["ambig_state"] == 3)
    return kept


def _read_table(path: Path) -> Array:
    """Return the echoes as a structured array."""
    data, begin = read_bytes(path), 0
    header: dict[str, list[str]] = {}  # Lines by their first word
    while "DATA" not in header:
        end = data.find(b"\n", begin, _MAX_HEADER)
        if end < 0:
            raise LogError(f"{path}: not a PCD file, or its header is truncated")
        name, *values = data[begin:end].decode("ascii", "replace").split() or ["#"]
        header[name], begin = values, end + 1
    try:
        names, counts = header["FIELDS"], header.get("COUNT", [])
        if any(count != "1" for count in counts):
            raise ValueError("COUNT other than 1")
        kinds = zip(names, header["TYPE"], header["SIZE"], strict=True)
        dtype = np.dtype([(name, _TYPES[kind, size]) for name, kind, size in kinds])
        num = int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
        if not (0 <= num <= _MAX_ECHOES and [num] == [int(text) for text in header.get("POINTS", [str(num)])]):
            raise ValueError(f"WIDTH x HEIGHT is {num}, POINTS {' '.join(header.get('POINTS', []))}")
    except (KeyError, IndexError, ValueError) as error:
        why = str(error)
        if isinstance(error, KeyError):
            key = error.args[0]
            why = f"no line {error}" if isinstance(key, str) else f"unknown TYPE and SIZE {' '.join(key)}"
        raise LogError(f"{path}: PCD header: {why}") from error
    if header["DATA"] != ["binary"]:
        raise LogError(f"{path}: DATA {' '.join(header['DATA'])}, expected binary")
    if len(data) - begin < num * dtype.itemsize:
        has = f"{len(data) - begin} bytes for {num} echoes of {dtype.itemsize}"
        raise LogError(f"{path}: {has}, is it truncated?")
    return np.frombuffer(data, dtype, num, begin)


def rigs_of(rows: Sequence[DataRow], tables: Tables, scene: str) -> list[tuple[int, Rig]]:
    """Return the rigs of a scene, each with the stamp [us] from which on it holds; the first one holds from 0.

    A rig has the sensors that measured something; body coordinates are those of the ego vehicle. It changes where the
    calibration of a sensor or the size of its images does, together with all sensors that measure nothing more under
    their old one: what changes at about one instant is one change. `rows` are in the order of stamps. Raises LogError
    where a sensor has two calibrations at one stamp, or a camera has no proper intrinsics.
    """
    last: dict[str, DataRow] = {}
    held: dict[str, DataRow] = {}  # A row with the calibration that holds, by sensor
    waiting: dict[str, deque[tuple[int, DataRow]]] = {}  # Later ones, each with the last stamp of the one before
    for row in rows:
        old = last.setdefault(row.channel, row)
        if _setting(row, tables) != _setting(old, tables):
            if row.stamp_us == old.stamp_us:
                what = f"two calibrations of {row.channel} at one stamp, '{old.token}' and '{row.token}'"
                raise LogError(f"{tables.folder.table('sample_data')}: {scene}: {what}")
            waiting.setdefault(row.channel, deque()).append((old.stamp_us, row))
        held.setdefault(row.channel, row)
        last[row.channel] = row
    rigs = [(0, _make_rig(held, tables))]
    while waiting := {name: rest for name, rest in waiting.items() if rest}:
        now_us = min(rest[0][1].stamp_us for rest in waiting.values())
        held |= {name: rest.popleft()[1] for name, rest in waiting.items() if rest[0][0] < now_us}
        rigs.append((now_us, _make_rig(held, tables)))
    return rigs


def _setting(row: DataRow, tables: Tables) -> tuple[object, ...]:
    """What a rig holds of a sensor; equal calibrations may have several rows."""
    own = tables.calibrations[row.calibration]
    size = (row.width, row.height) if own.camera_intrinsic else (0, 0)
    return own.translation, own.rotation, own.camera_intrinsic, size


def _make_rig(held: Mapping[str, DataRow], tables: Tables) -> Rig:
    mounts, cameras = {}, {}
    for name, row in sorted(held.items()):
        calibration, kind = tables.calibrations[row.calibration], tables.sensor(row.calibration).modality
        w, x, y, z = calibration.rotation
        mounts[name] = Mount(kind, np.array(calibration.translation), np.array([x, y, z, w]))
        if kind == "camera":
            K = np.array(calibration.camera_intrinsic)
            if K.shape != (3, 3) or not is_pinhole(K):
                why = f"row with token '{row.calibration}': camera_intrinsic isn't that of {row.channel}"
                raise LogError(f"{tables.folder.table('calibrated_sensor')}: {why}")
            if not (row.width and row.height):
                why = f"row with token '{row.token}': an image of {row.channel} without width and height"
                raise LogError(f"{tables.folder.table('sample_data')}: {why}")
            cameras[name] = CameraModel(K, (row.width, row.height))
    return Rig(mounts, cameras)
