"""Sweeps of the Velodyne HDL-32E, one CSV file each."""

from pathlib import Path

import numpy as np

from fbench.datasets.radiate.calibration import LIDAR
from fbench.replay.data import PointCloud
from fbench.replay.errors import LogError
from fbench.replay.imports.files import read_bytes

COLUMNS = ("x", "y", "z", "intensity", "ring")
_BLOCK = 2**18
"""Bytes that one thread parses; small enough for several threads to have some of a sweep."""


def read_sweep(path: Path, stamp_ns: int) -> PointCloud:
    """Read rows `x,y,z,intensity,ring` without a header; x right, y forward, z up [m].

    Raises:
        LogError: where a row hasn't five numbers, one isn't finite, or a ring isn't 0 to 65535.
    """
    import pyarrow as pa
    from pyarrow import csv

    types = {name: pa.float32() for name in COLUMNS} | {"ring": pa.uint16()}
    data = read_bytes(path)
    try:
        table = csv.read_csv(
            pa.BufferReader(data),
            csv.ReadOptions(use_threads=True, column_names=list(COLUMNS), block_size=_BLOCK),
            convert_options=csv.ConvertOptions(column_types=types, null_values=[], check_utf8=False),
        )
    except pa.ArrowInvalid as error:
        text = " ".join(str(error).split())[:200]
        raise LogError(f"{path}: expected rows of {','.join(COLUMNS)} ({text})") from error
    columns = [table.column(name).to_numpy() for name in COLUMNS]
    for name, column in zip(COLUMNS, columns, strict=True):
        if not np.isfinite(column).all():
            row = int(np.flatnonzero(~np.isfinite(column))[0]) + 1
            raise LogError(f"{path}: line {row}: {name} isn't a finite number")
    return PointCloud(LIDAR, stamp_ns, stamp_ns, np.stack(columns[:3], axis=1), columns[3], columns[4])
