"""Poses from GPS and IMU."""

import numpy as np
import pytest

from fbench.datasets.kitti.oxts import World, fix_of, read_fix
from fbench.replay.contracts.errors import LogError


def geodetic(fix, e2):
    """Earth-centered position [m] on an ellipsoid with the square of eccentricity `e2`; 0 is a sphere."""
    lat, lon = np.deg2rad([fix.lat_deg, fix.lon_deg])
    n = 6378137.0 / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    p = (n + fix.alt_m) * np.cos(lat)
    return np.array([p * np.cos(lon), p * np.sin(lon), (n * (1 - e2) + fix.alt_m) * np.sin(lat)])


def tangent_plane(fix, origin, e2):
    """East, north, up [m] in the plane that touches the Earth at the origin."""
    lat, lon = np.deg2rad([origin.lat_deg, origin.lon_deg])
    turn = np.array(
        [
            [-np.sin(lon), np.cos(lon), 0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ]
    )
    return turn @ (geodetic(fix, e2) - geodetic(origin, e2))


@pytest.fixture
def fix(make_oxts_row):
    return lambda **values: fix_of(make_oxts_row(**values), "row")


def test_positions_are_those_of_the_devkit(fix):
    """convertOxtsToPose.m written out: mx = s lon pi er / 180, my = s er log(tan((90 + lat) pi / 360))."""
    origin, other = fix(lat=49.015003823272, lon=8.4342971002335, alt=116.43), fix(lat=49.0161, lon=8.4351, alt=117.5)
    s, er = np.cos(origin.lat_deg * np.pi / 180), 6378137
    mercator = [
        np.array([s * f.lon_deg * np.pi * er / 180, s * er * np.log(np.tan((90 + f.lat_deg) * np.pi / 360)), f.alt_m])
        for f in (origin, other)
    ]
    moved = World(origin).world_T_imu(other)[:3, 3]
    np.testing.assert_allclose(moved, mercator[1] - mercator[0], atol=1e-8)
    assert World(origin).world_T_imu(origin)[:3, 3].tolist() == [0, 0, 0]


@pytest.mark.parametrize(("e2", "tolerance_m"), [(0, 0.01), (6.69437999014e-3, 0.20)])
@pytest.mark.parametrize("angle", np.arange(0, 360, 45))
def test_positions_agree_with_the_tangent_plane(fix, angle, e2, tolerance_m):
    """Over 100 m to 1 cm on the sphere that KITTI takes the Earth for, to 20 cm on WGS 84: at 49 degrees the radius of
    curvature is 6372 km along the meridian and 6390 km across it, 0.1% and 0.2% off those 6378 km.
    """
    origin = fix()
    d_lat, d_lon = np.rad2deg(100 / 6378137 * np.array([np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle)) / 0.656]))
    other = fix(lat=origin.lat_deg + d_lat, lon=origin.lon_deg + d_lon)
    position = World(origin).world_T_imu(other)[:3, 3]
    assert 99 < np.linalg.norm(position) < 101
    error = position - tangent_plane(other, origin, e2)
    assert np.abs(error[:2]).max() < tolerance_m
    assert abs(error[2]) < 0.001


@pytest.mark.parametrize(("yaw", "expected"), [(0, [1, 0, 0]), (np.pi / 2, [0, 1, 0])])
def test_yaw_0_is_east_and_counts_to_the_left(make_oxts_row, yaw, expected):
    row = make_oxts_row(yaw=yaw).split()
    row[3:5] = "0", "0"
    fix = fix_of(" ".join(row), "row")
    np.testing.assert_allclose(World(fix).world_T_imu(fix)[:3, 0], expected, atol=1e-6)


def test_origin_is_kept_as_it_was_written(fix):
    assert World(fix()).metadata == {
        "world.origin_lat_deg": "49.015000000000",
        "world.origin_lon_deg": "8.434000000000",
        "world.origin_alt_m": "116.40000000",
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda row: row.rsplit(" ", 1)[0], "29 values, expected 30"),
        (lambda row: row + " 1", "31 values"),
        (lambda row: "", "0 values"),
        (lambda row: row.replace("116.40000000", "nan"), "altitude is 'nan', expected a finite number"),
        (lambda row: row.replace("116.40000000", "1e400"), "altitude is '1e400'"),
        (lambda row: row.replace("116.40000000", "1e300"), "no place on Earth"),
        (lambda row: row.replace("49.015000000000", "x"), "latitude is 'x'"),
        (lambda row: row.replace("49.015000000000", "90"), "no place on Earth"),
        (lambda row: row.replace("8.434000000000", "181"), "no place on Earth"),
        (lambda row: row.replace("1.5", "inf", 1), "value 7 is 'inf'"),
    ],
)
def test_bad_rows_are_named(make_oxts_row, change, message):
    with pytest.raises(LogError, match=f"row 7: .*{message}"):
        fix_of(change(make_oxts_row()), "row 7")


def test_a_file_of_two_rows_is_refused(make_oxts_row, tmp_path):
    path = tmp_path / "0000000000.txt"
    path.write_text(f"{make_oxts_row()}\n{make_oxts_row()}\n")
    with pytest.raises(LogError, match=r"0000000000.txt: 2 rows, expected one"):
        read_fix(path)
