from pathlib import Path

import numpy as np
import pytest

from fbench.datasets.nuscenes.sensors import read_scan
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.messages import RadarScan

HEADER = b"""# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z rcs vx vy
SIZE 4 4 4 4 4 4
TYPE F F F F F F
COUNT 1 1 1 1 1 1
WIDTH 2
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 2
DATA binary
"""
BODY = np.array([[3, 4, 0, 5, 1, 2], [0, 0, 0, 1, 1, 1]], "<f4").tobytes()


def write(folder: Path, data: bytes) -> Path:
    path = folder / "scan.pcd"
    path.write_bytes(data)
    return path


def read_echoes(path: Path, filtered: bool) -> RadarScan:
    scan, num_dropped = read_scan(path, "radar", 0, filtered)
    assert num_dropped == 0
    return scan


def test_an_echo_at_the_sensor_has_no_line_of_sight(tmp_path: Path) -> None:
    echoes = read_echoes(write(tmp_path, HEADER + BODY), filtered=False)
    assert echoes.xyz.tolist() == [[3, 4, 0], [0, 0, 0]]
    assert echoes.radial_velocity_mps is not None
    assert echoes.rcs_dbsm is not None
    assert echoes.radial_velocity_mps[0] == pytest.approx(2.2)
    assert np.isnan(echoes.radial_velocity_mps[1])
    assert echoes.rcs_dbsm.tolist() == [5, 1]


def test_height_counts_in_the_distance(tmp_path: Path) -> None:
    body = np.array([[2, 3, 6, 0, 7, 14], [1, 0, 0, 0, 1, 0]], "<f4").tobytes()
    echoes = read_echoes(write(tmp_path, HEADER + body), filtered=False)
    assert echoes.radial_velocity_mps == pytest.approx([(2 * 7 + 3 * 14) / 7, 1])


def test_a_scan_without_echoes_holds_nan(tmp_path: Path) -> None:
    body = np.full((2, 6), np.nan, "<f4").tobytes()
    echoes = read_echoes(write(tmp_path, HEADER + body), filtered=False)
    assert echoes.xyz.shape == (0, 3)


def test_no_points_at_all(tmp_path: Path) -> None:
    header = HEADER.replace(b"WIDTH 2", b"WIDTH 0").replace(b"POINTS 2", b"POINTS 0")
    assert read_echoes(write(tmp_path, header), filtered=False).xyz.shape == (0, 3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (BODY, BODY[:-1], r"47 bytes for 2 echoes of 24, is it truncated\?"),
        (BODY, b"", r"0 bytes for 2 echoes of 24, is it truncated\?"),
        (b"DATA binary\n", b"DATA ascii\n", "DATA ascii, expected binary"),
        (b"DATA binary\n", b"DATA binary_compressed\n", "DATA binary_compressed, expected binary"),
        (b"DATA binary\n" + BODY, b"", "not a PCD file, or its header is truncated"),
        (HEADER, b"", "not a PCD file, or its header is truncated"),
        (HEADER, bytes(9000), "not a PCD file, or its header is truncated"),
        (b"COUNT 1 1 1 1 1 1", b"COUNT 1 1 1 1 1 2", "COUNT other than 1"),
        (b"SIZE 4 4 4 4 4 4", b"SIZE 4 4 4 4 4 3", "unknown TYPE and SIZE F 3"),
        (b"SIZE 4 4 4 4 4 4", b"SIZE 4 4 4 4 4", "PCD header: zip"),
        (b"FIELDS x y", b"FIELDS x x", "PCD header: field 'x' occurs more than once"),
        (b"WIDTH 2", b"WIDTH two", "PCD header: invalid literal"),
        (b"WIDTH 2", b"WIDTH -2", "WIDTH x HEIGHT is -2, POINTS 2"),
        (b"WIDTH 2", b"WIDTH 99999999999", "WIDTH x HEIGHT is 99999999999, POINTS 2"),
        (b"WIDTH 2", b"WIDTH " + b"9" * 5000, "PCD header"),
        (b"WIDTH 2", b"WIDTH", "PCD header"),
        (b"HEIGHT 1\n", b"", "no line 'HEIGHT'"),
        (b"POINTS 2", b"POINTS 3", "WIDTH x HEIGHT is 2, POINTS 3"),
        (b"rcs", b"foo", "no field 'rcs'"),
    ],
)
def test_broken_scans(tmp_path: Path, old: bytes, new: bytes, message: str) -> None:
    path = write(tmp_path, (HEADER + BODY).replace(old, new))
    with pytest.raises(LogError, match=message) as caught:
        read_echoes(path, filtered=False)
    assert str(caught.value).startswith(f"{path}: ")


def test_the_filter_needs_its_flags(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no field 'invalid_state'"):
        read_echoes(write(tmp_path, HEADER + BODY), filtered=True)
