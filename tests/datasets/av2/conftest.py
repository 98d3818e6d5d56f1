"""A log as Argoverse 2 stores one, made by hand."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather

from fbench.replay.data.images import encode_jpeg

FIRST_NS, STEP_NS, NUM = 315_966_253_660_000_000, 100_000_000, 3
STAMPS = tuple(FIRST_NS + i * STEP_NS for i in range(NUM))
NAME = "7fab2350-7eaf-3b7e-a39d-000000000001"
Table = dict[str, Any]


def write(path: Path, columns: Table) -> None:
    """Write a Feather file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pa.table(columns), path)


def change(path: Path, edit: Callable[[Table], None]) -> None:
    """Rewrite a Feather file after a change of its columns."""
    table = feather.read_table(path, memory_map=False)
    columns: Table = {name: table.column(name) for name in table.column_names}
    edit(columns)
    write(path, columns)


def poses(num: int, **columns: Any) -> Table:
    """Columns of places and turns, all zero but for those given."""
    zeros = np.zeros(num)
    return {"qw": np.ones(num), "qx": zeros, "qy": zeros, "qz": zeros, "tx_m": zeros, "ty_m": zeros, "tz_m": zeros} | {
        name: np.asarray(values) for name, values in columns.items()
    }


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Three sweeps, images of one camera, a car that is passed, a rider at the first instant, and a map.

    The ego drives along the city's y at 10 m/s; the car stands at (100, 30) of the city.
    """
    root = tmp_path / "av2" / NAME
    half = np.sqrt(0.5)
    seconds = np.arange(2 * NUM) * 0.05
    turned = {"qw": np.full(2 * NUM, half), "qz": np.full(2 * NUM, half)}
    stamps = np.array([FIRST_NS + i * STEP_NS // 2 for i in range(2 * NUM)])
    city = poses(2 * NUM, tx_m=np.full(2 * NUM, 100.0), ty_m=10 * seconds, **turned)
    write(root / "city_SE3_egovehicle.feather", {"timestamp_ns": stamps, **city})
    sensors = poses(2, tx_m=[1.35, 1.6], tz_m=[1.64, 1.4], qw=[0.0, 0.5], qx=[0.0, -0.5], qy=[0.0, 0.5], qz=[1.0, -0.5])
    write(
        root / "calibration/egovehicle_SE3_sensor.feather",
        {"sensor_name": ["up_lidar", "ring_front_center"], **sensors},
    )
    intrinsics = {"sensor_name": ["ring_front_center"], "fx_px": [20.0], "fy_px": [20.0], "cx_px": [15.5],
                  "cy_px": [11.5], "k1": [-0.2], "k2": [0.1], "k3": [0.0], "height_px": pa.array([24], pa.uint16()),
                  "width_px": pa.array([32], pa.uint16())}  # fmt: skip
    write(root / "calibration/intrinsics.feather", intrinsics)
    xyz = np.array([[10.0, 0.0, 0.5], [8.0, 2.0, 1.0]], np.float16)
    for i, stamp in enumerate(STAMPS):
        byte = np.array([10, 255], np.uint8)
        sweep = {"x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2], "intensity": byte,
                 "laser_number": np.array([31, 63], np.uint8), "offset_ns": np.array([0, 5000 + i], "i4")}  # fmt: skip
        write(root / f"sensors/lidar/{stamp}.feather", sweep)
    folder = root / "sensors/cameras/ring_front_center"
    folder.mkdir(parents=True)
    for stamp in STAMPS[:2]:
        (folder / f"{stamp + 20_000_000}.jpg").write_bytes(encode_jpeg(np.full((24, 32, 3), 90, np.uint8), 90))
    rows = 4  # The car, 30 m - 1 m per step ahead, thrice; the rider once
    boxes = {
        "timestamp_ns": np.array([STAMPS[0], STAMPS[0], STAMPS[1], STAMPS[2]]),
        "track_uuid": ["b-car", "a-rider", "b-car", "b-car"],
        "category": ["REGULAR_VEHICLE", "BICYCLIST", "REGULAR_VEHICLE", "REGULAR_VEHICLE"],
        "length_m": np.full(rows, 4.5), "width_m": np.full(rows, 2.0), "height_m": np.full(rows, 1.5),
        **poses(rows, tx_m=[30.0, 5.0, 29.0, 28.0], ty_m=[0.0, 2.0, 0.0, 0.0]),
        "num_interior_pts": np.array([9, 0, 7, 5]),
    }  # fmt: skip
    write(root / "annotations.feather", boxes)
    corners = ", ".join(f'{{"x": {x}, "y": {y}, "z": 0.0}}' for x, y in ((90, 0), (90, 50), (110, 50), (110, 0)))
    (root / "map").mkdir()
    (root / f"map/log_map_archive_{NAME}____PIT_city_1.json").write_text(
        f'{{"drivable_areas": {{"7": {{"area_boundary": [{corners}], "id": 7}}}}, "lane_segments": {{}}}}'
    )
    return root
