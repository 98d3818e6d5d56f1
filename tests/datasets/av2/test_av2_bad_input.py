"""Folders and files that can't be used: one line each that names what is wrong."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from tests.datasets.av2.conftest import FIRST_NS, NAME, STAMPS, Table, change
from tests.program import fbench

from fbench.datasets.av2 import Av2
from fbench.datasets.importing.run import import_one
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import FrameRange, ImportRequest
from fbench.replay.data.images import encode_jpeg

BOXES, POSES = "annotations.feather", "city_SE3_egovehicle.feather"
MOUNTS, LENSES = "calibration/egovehicle_SE3_sensor.feather", "calibration/intrinsics.feather"
SWEEP = f"sensors/lidar/{STAMPS[0]}.feather"
IMAGE = f"sensors/cameras/ring_front_center/{FIRST_NS + 20_000_000}.jpg"


def refused(folder: Path, message: str, asked: ImportRequest | None = None) -> None:
    out = folder.parent / "out.mcap"
    with pytest.raises(LogError, match=message) as caught:
        import_one(Av2(), folder, out, asked)
    assert "\n" not in str(caught.value)
    assert not out.exists()


def test_source_is_not_a_log(tmp_path: Path) -> None:
    refused(tmp_path / "none", r"none: no such folder$")
    refused(tmp_path, r"no log of Argoverse 2: no city_SE3_egovehicle.feather in it, nor in any folder in it$")


@pytest.mark.parametrize("name", [BOXES, POSES, MOUNTS, LENSES, SWEEP])
@pytest.mark.parametrize("content", [b"", b"ARROW1\0\0", b"no table at all"])
def test_broken_feather(log: Path, name: str, content: bytes) -> None:
    (log / name).write_bytes(content)
    refused(log, rf"{Path(name).name}: isn't a Feather file, or is truncated$")


@pytest.mark.parametrize("name", [BOXES, POSES, MOUNTS, LENSES, SWEEP])
def test_truncated_feather(log: Path, name: str) -> None:
    data = (log / name).read_bytes()
    (log / name).write_bytes(data[: len(data) // 2])
    refused(log, rf"{Path(name).name}: isn't a Feather file, or is truncated$")


@pytest.mark.parametrize("name", [MOUNTS, LENSES])
def test_missing_calibration(log: Path, name: str) -> None:
    (log / name).unlink()
    refused(log, rf"{Path(name).name}: No such file or directory$")


@pytest.mark.parametrize(
    ("name", "column"),
    [(BOXES, "track_uuid"), (BOXES, "num_interior_pts"), (POSES, "qw"), (MOUNTS, "sensor_name"), (LENSES, "fx_px"),
     (SWEEP, "laser_number")],
)  # fmt: skip
def test_missing_columns(log: Path, name: str, column: str) -> None:
    change(log / name, lambda columns: columns.pop(column))
    refused(log, rf"{Path(name).name}: no column '{column}'$")


def put(column: str, row: int, value: object) -> Callable[[Table], None]:
    """Return what puts a value into a row of a column."""

    def edit(columns: Table) -> None:
        values = columns[column].to_pylist()
        values[row] = value
        columns[column] = pa.chunked_array([pa.array(values, columns[column].type)])

    return edit


def retype(column: str, kind: pa.DataType) -> Callable[[Table], None]:
    """Return what makes a column one of another type."""

    def edit(columns: Table) -> None:
        columns[column] = pa.array([str(i) for i in range(len(columns[column]))], pa.string()).cast(kind)

    return edit


@pytest.mark.parametrize(
    ("name", "edit", "message"),
    [
        (BOXES, put("tx_m", 1, np.nan), r"row 1: tx_m is nan, expected a finite number$"),
        (BOXES, put("length_m", 2, np.inf), r"row 2: length_m is inf, expected a finite number$"),
        (BOXES, put("height_m", 3, 0.0), r"row 3: length_m width_m height_m are 4.5 2 0, expected above 0$"),
        (BOXES, put("qw", 0, 2.0), r"row 0: qw qx qy qz isn't a unit quaternion: 2 0 0 0$"),
        (BOXES, put("category", 0, None), r"column 'category' has 1 empty value$"),
        (BOXES, put("track_uuid", 1, "b-car"), r"row \d: track b-car is twice at 315966253660000000$"),
        (BOXES, retype("track_uuid", pa.int64()), r"column 'track_uuid' is int64, expected text$"),
        (BOXES, retype("timestamp_ns", pa.float64()), r"column 'timestamp_ns' is double, expected integers$"),
        (BOXES, retype("tx_m", pa.string()), r"column 'tx_m' is string, expected numbers$"),
        (POSES, put("tx_m", 4, np.nan), r"row 4: tx_m is nan"),
        (POSES, put("timestamp_ns", 1, FIRST_NS), r"two poses of one instant, 315966253660000000$"),
        (MOUNTS, put("sensor_name", 0, "down_lidar"), r"no sensor 'up_lidar', of which there are files$"),
        (MOUNTS, put("sensor_name", 1, "other"), r"no sensor 'ring_front_center', of which there are files$"),
        (LENSES, put("sensor_name", 0, "other"), r"no camera 'ring_front_center', of which there are images$"),
        (LENSES, put("fx_px", 0, -1.0), r"'ring_front_center': a camera needs focal lengths and sizes above 0$"),
        (SWEEP, put("x", 0, np.nan), r"row 0: x is nan"),
        (SWEEP, put("offset_ns", 0, -1), r"offset_ns from -1 to 5000, expected 0 to 2147483647$"),
    ],
)
def test_wrong_values(log: Path, name: str, edit: Callable[[Table], None], message: str) -> None:
    change(log / name, edit)
    refused(log, rf"{Path(name).name}: {message}")


def test_images_and_maps(log: Path) -> None:
    (log / IMAGE).write_bytes(encode_jpeg(np.zeros((24, 30, 3), np.uint8), 90))
    refused(log, r"jpg: 30x24 px, expected 32x24 as the calibration says$")
    (log / IMAGE).write_bytes(b"no image")
    refused(log, r"jpg: .*")
    (path,) = (log / "map").iterdir()
    path.write_text('{"drivable_areas": {"7": {"area_boundary": [{"x": 1.0}]}}}')
    refused(log, r"log_map_archive_.*json: drivable_areas.*y")
    path.write_text('{"drivable_areas": {"7": {"area_boundary": [{"x": 1.0, "y": 2.0}]}}}')
    refused(log, r"drivable area 7 has 1 corner, expected 3 or more$")


def test_nothing_to_import(log: Path) -> None:
    refused(log, r"no frame 3:, there are 0 to 2$", ImportRequest((NAME,), FrameRange(3)))
    (log / "sensors").rename(log.parent / "sensors")
    (log / BOXES).unlink()
    refused(log, r"neither sweeps in sensors/lidar/ nor images nor annotations.feather$")


def test_command_says_it_in_one_line_and_leaves_no_log(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change(log / BOXES, put("tx_m", 1, np.nan))
    assert fbench("log", "import", "av2", log, "-o", log.parent / "out.mcap") == 3
    assert not (log.parent / "out.mcap").exists()
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
