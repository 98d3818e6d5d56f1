"""The text tables of the Astyx HiRes2019 set: LiDAR sweeps and radar scans."""

from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from fbench.replay.arrays import Float64, Int64
from fbench.replay.errors import LogError
from fbench.replay.imports.files import read_bytes

_LIDAR_HEADER = "X Y Z Reflectivity LaserID Timestamp"
_RADAR_HEADER = "X Y Z V_r Mag"
HOUR_US = 3_600_000_000
_BLOCK = 128 * 1024
"""Files are parsed in blocks of so many bytes, as many at a time as there are cores."""


@dataclass(frozen=True, eq=False)
class LidarTable:
    """One file of `lidar_vlp16/`: xyz (N, 3) [m] and intensity, ring, time within the hour (N,) [us]."""

    xyz: Float64
    intensity: Float64
    ring: Int64
    time_us: Int64


def read_lidar(path: Path) -> LidarTable:
    """Read one sweep, in the LiDAR's coordinate frame.

    Raises:
        LogError: naming file and line.
    """
    table = _table(path, _LIDAR_HEADER)
    ring, time_us = table[:, 4], table[:, 5]
    if not (np.all((ring >= 0) & (ring < 2**16)) and np.all((time_us >= 0) & (time_us < HOUR_US))):
        raise LogError(f"{path}: expected LaserID from 0 to 65535 and Timestamp within one hour [us]")
    return LidarTable(table[:, :3], table[:, 3], ring.astype(np.int64), time_us.astype(np.int64))


def read_radar(path: Path) -> Float64:
    """Read one scan (N, 5): x, y, z [m], V_r [m/s], magnitude [dB], in the radar's coordinate frame.

    Raises:
        LogError: naming file and line.
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
