"""A LiDAR in clear air: firing, noise, surfaces, reflectivity, motion."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from tests.datasets.city.sensors.lidar_worlds import MOUNT, SIZE, bytes_of, drum, ground, lidar, ranges, turn

from fbench.datasets.city.instant import MISS, STATIC
from fbench.datasets.city.mesh import Skin, merge_meshes, quad
from fbench.replay.conditions.weather import Weather

CARS = ((0, 0), (12, 3, 0.3), (-9, -4, 2.0), (20, -6, 1.2), (4, 9, 3.0), (35, 0, 0.1))


def wall(x_m, material="plaster"):
    """Return a large wall across the x axis."""
    y, z = 60.0, 60.0
    corners = np.array([(x_m, y, -z), (x_m, -y, -z), (x_m, -y, z), (x_m, y, z)])
    return quad(corners, Skin(material, (0.5, 0.5, 0.5)))


def test_every_shot_of_a_turn_in_firing_order():
    cloud = turn(drum(10)).cloud
    assert len(cloud.xyz) == 50_000  # 1,000,000 points a second at 20 Hz
    shot = np.arange(50_000)
    np.testing.assert_array_equal(cloud.ring, shot % 128)
    np.testing.assert_array_equal(cloud.offset_ns, (shot - 49_999) * 1000)  # one a microsecond, the last at the stamp
    x, y, z = cloud.xyz.astype(np.float64).T
    altitude = np.degrees(np.arctan2(z, np.hypot(x, y)))
    np.testing.assert_allclose(altitude, 30 - (shot % 128) * 50 / 127, atol=1e-4)
    turned = (180 - np.degrees(np.arctan2(y, x))) % 360
    np.testing.assert_allclose((turned - shot * 360 / 50_000 + 180) % 360 - 180, 0, atol=1e-3)
    assert cloud.xyz[0, 0] < 0  # begins behind
    assert cloud.xyz[12_500, 1] > 0  # then the left


@pytest.mark.parametrize(("points", "rate", "channels", "expected"), [(1000, 10, 1, 100), (1000, 3, 16, 333)])
def test_other_rates_and_channels(points, rate, channels, expected):
    cloud = turn(drum(10), spec=lidar(points_per_s=points, rate_hz=float(rate), channels=channels)).cloud
    assert len(cloud.xyz) == expected
    assert cloud.ring.max() == channels - 1
    assert -1e9 / rate < cloud.offset_ns[0] < 0 == cloud.offset_ns[-1]


def test_range_noise_has_the_stated_sigma():
    for sigma in (0.01, 0.05):
        result = turn(drum(12), spec=lidar(noise_m=sigma))
        error = ranges(result) - result.range_m
        num = len(error)
        assert num == 50_000
        assert abs(error.mean()) < 5 * sigma / np.sqrt(num)
        assert error.std() == pytest.approx(sigma, rel=5 / np.sqrt(2 * num))
        assert np.abs(error).max() < 6 * sigma
        assert np.mean(np.abs(error) < sigma) == pytest.approx(0.6827, abs=0.01)


def test_without_noise_points_lie_on_surfaces():
    result = turn(merge_meshes([ground(), wall(25.0)]), spec=lidar(noise_m=0.0))
    world = result.cloud.xyz.astype(np.float64) + MOUNT[:3, 3]
    off = np.minimum(np.abs(world[:, 2]), np.abs(world[:, 0] - 25))
    assert off.max() < 2e-3
    assert np.abs(world[:, 2] < 0.01).sum() > 1000
    assert np.abs(world[:, 0] > 24.9).sum() > 1000


def test_points_of_a_body_are_in_its_box():
    result = turn(ground(), CARS, spec=lidar(noise_m=0.03))
    world = result.cloud.xyz.astype(np.float64) + MOUNT[:3, 3]
    for i, (x, y, yaw) in enumerate(CARS[1:], 1):
        d = world[result.body == i] - (x, y, 0)
        assert len(d) > 20
        cos, sin = np.cos(yaw), np.sin(yaw)
        local = np.column_stack([cos * d[:, 0] + sin * d[:, 1], cos * d[:, 1] - sin * d[:, 0], d[:, 2] - SIZE[2] / 2])
        outside = (np.abs(local) - np.array(SIZE) / 2).max(axis=1)
        assert np.mean(outside < 3 * 0.03) > 0.99
        assert outside.max() < 5 * 0.03
    assert not np.isin(0, result.body)


def test_nothing_is_seen_beyond_the_range():
    bright = Skin("sign", (0.5, 0.5, 0.5))  # retroreflecting: strong at any distance
    near, far = quad(np.array([(99.0, 9, -9), (99, -9, -9), (99, -9, 9), (99, 9, 9)]), bright), wall(101.0, "sign")
    result = turn(merge_meshes([near, far]), spec=lidar(noise_m=0.0))
    assert ranges(result).max() <= 100
    assert (ranges(result) > 98.9).sum() > 100
    assert len(turn(wall(101.0, "sign")).body) == 0


def test_a_dark_target_is_just_seen_at_the_range():
    """10 % of reflectivity at 100 m; others at the distance where the power is equal, and glass never from afar."""
    for material, reflects in (("rubber", 0.06), ("plastic", 0.12), ("asphalt", 0.17)):
        r = np.linspace(1, 200, 100_000)
        clear = np.log(20) / 20_000
        power = reflects * np.exp(-2 * clear * r) / r**2
        sees_m = r[power >= 0.1 * np.exp(-2 * clear * 100) / 100**2].max()
        spec = lidar(upper_deg=0.5, lower_deg=-0.5, noise_m=0.0)
        inside, outside = min(sees_m, 100) - 0.2, sees_m + 0.2
        assert len(turn(drum(inside, material), spec=spec).body) > 45_000
        assert len(turn(drum(outside, material), spec=spec).body) == 0


def test_intensity_follows_material_and_incidence():
    clear = np.log(20) / 20_000
    for material, diffuse, retro in (("brick", 0.30, 0.0), ("paint", 0.45, 0.0), ("plate", 0.50, 0.8)):
        result = turn(wall(20.0, material), spec=lidar(noise_m=0.0))
        cosine = 20 / result.range_m
        expected = np.minimum((diffuse * cosine + retro) * np.exp(-2 * clear * result.range_m), 1)
        np.testing.assert_allclose(result.cloud.intensity, expected, rtol=1e-4)
        assert len(expected) > 2000


def test_lost_returns_are_the_stated_share():
    num = len(turn(drum(10), spec=lidar(dropout=0.2)).body)
    assert num == pytest.approx(40_000, abs=5 * np.sqrt(50_000 * 0.16))
    assert len(turn(drum(10), spec=lidar(dropout=1.0)).body) == 0


def test_an_empty_world_gives_an_empty_cloud():
    result = turn(merge_meshes([]))
    assert result.cloud.xyz.shape == (0, 3)
    assert len(result.body) == len(result.range_m) == len(result.cloud.intensity) == 0


def test_light_changes_nothing():
    day = turn(ground(), CARS)
    night = turn(ground(), CARS, weather=Weather(lux=0.3, sun_elevation_deg=-30.0, sun_azimuth_deg=10.0))
    assert bytes_of(day) == bytes_of(night)


def test_same_seed_same_bytes_in_any_thread():
    one = bytes_of(turn(ground(), CARS))
    with ThreadPoolExecutor(4) as pool:
        assert {bytes_of(f.result()) for f in [pool.submit(partial(turn, ground(), CARS)) for _ in range(4)]} == {one}
    for changed in ({"seed": 1}, {"stamp_ns": 100_000_000}, {"sensor": "other"}):
        assert bytes_of(turn(ground(), CARS, **changed)) != one


def test_standing_still_motion_changes_nothing():
    assert bytes_of(turn(ground(), CARS)) == bytes_of(turn(ground(), CARS, spec=lidar(motion=True)))


def test_bodies_stand_still_at_the_stamp_without_motion():
    moving = [(x, y, yaw, 15.0, 4.0, 1.0) for x, y, yaw in ((0, 0, 0), *CARS[1:])]
    assert bytes_of(turn(ground(), moving)) == bytes_of(turn(ground(), CARS))


def test_in_motion_points_fit_every_body_at_its_own_time():
    ego = (3.0, -2.0, 0.5, 12.0, 5.0, 0.6)
    rows = [ego, (15, 4, 0.3, 20, 6, -0.8), (-8, -6, 2.0, -15, 3, 0.5), (20, -8, 1.2, 0, 25, 0.0)]
    result = turn(merge_meshes([ground()]), rows, spec=lidar(motion=True, noise_m=0.0))
    t = result.cloud.offset_ns * 1e-9
    yaw = ego[2] + ego[5] * t
    local = result.cloud.xyz.astype(np.float64) + MOUNT[:3, 3]
    world = np.column_stack([
        ego[0] + ego[3] * t + np.cos(yaw) * local[:, 0] - np.sin(yaw) * local[:, 1],
        ego[1] + ego[4] * t + np.sin(yaw) * local[:, 0] + np.cos(yaw) * local[:, 1],
        local[:, 2],
    ])  # fmt: skip
    assert np.abs(world[result.body == STATIC, 2]).max() < 2e-3
    smeared = []
    for i, (x, y, heading, vx, vy, rate) in enumerate(rows[1:], 1):
        on = result.body == i
        assert on.sum() > 50
        turned = heading + rate * t[on]
        dx, dy = world[on, 0] - x - vx * t[on], world[on, 1] - y - vy * t[on]
        own = np.column_stack([
            np.cos(turned) * dx + np.sin(turned) * dy, np.cos(turned) * dy - np.sin(turned) * dx,
            world[on, 2] - SIZE[2] / 2,
        ])  # fmt: skip
        outside = (np.abs(own) - np.array(SIZE) / 2).max(axis=1)
        assert outside.max() < 2e-3
        smeared.append(np.hypot(vx * t[on], vy * t[on]).max())
    assert max(smeared) > 0.3  # it would not fit without the offsets


def test_a_drum_turns_and_shifts_with_the_ego_vehicle():
    """Driving 20 m/s towards a wall, the first shot sees it 1 m farther away than the last, 50 ms later."""
    rows = [(0, 0, 0, 20.0, 0, 0)]
    spec = lidar(motion=True, noise_m=0.0, channels=1, upper_deg=0.0, lower_deg=0.0)
    result = turn(wall(30.0), rows, spec=spec)
    x = result.cloud.xyz[:, 0]
    np.testing.assert_allclose(x, 30 - 20 * result.cloud.offset_ns * 1e-9, atol=2e-3)
    assert MISS not in result.body
