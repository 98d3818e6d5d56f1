"""Where a radar's echoes lie, and how fast they move."""

import numpy as np
import pytest
from tests.datasets.city.sensors.radar_worlds import (
    EXACT,
    FINE,
    MOUNT,
    car,
    ground,
    hall,
    look,
    pedestrian,
    radar,
    states,
    world,
)

from fbench.datasets.city.instant import STATIC
from fbench.replay.geometry.transforms import transform


def test_rays_cover_the_field_of_view_evenly():
    message = look(world(hall(40)), states((0, 0, 0)), radar(**EXACT)).message
    azimuth, altitude = np.degrees(message.azimuth_rad), np.degrees(message.altitude_rad)
    assert len(azimuth) == 250_000 / 20
    num, _, _ = np.histogram2d(azimuth, altitude, bins=(10, 5), range=((-50, 50), (-25, 25)))
    assert num.sum() == 12_500
    assert abs(num - 250).max() <= 10


def test_each_scan_looks_elsewhere():
    caster, spec = world(hall(40)), radar(**EXACT)
    first, second = (look(caster, states((0, 0, 0)), spec, stamp_ns=stamp).message for stamp in (0, 50_000_000))
    assert not np.intersect1d(first.altitude_rad, second.altitude_rad).size


def test_points_are_those_of_the_polar_values():
    """Convention of the thesis: x = r cos phi cos theta, y = r cos phi sin theta, z = r sin phi."""
    message = look(world(ground(), car()), states((0, 0, 0), (15, 3, 0.4))).message
    r, theta, phi = (a.astype(np.float64) for a in (message.range_m, message.azimuth_rad, message.altitude_rad))
    expected = np.stack([r * np.cos(phi) * np.cos(theta), r * np.cos(phi) * np.sin(theta), r * np.sin(phi)], axis=1)
    np.testing.assert_array_equal(message.xyz, expected.astype(np.float32))


def test_points_lie_on_surfaces():
    caster = world(ground(), car())
    found = look(caster, states((100, -50, 2.0), (100 + 15 * np.cos(2), -50 + 15 * np.sin(2), 2.5)), radar(**EXACT))
    in_ego = transform(MOUNT, found.message.xyz)
    on_ground = found.body == STATIC
    assert on_ground.sum() > 1000
    np.testing.assert_allclose(in_ego[on_ground, 2], 0, atol=2e-4)
    at_car = transform(np.linalg.inv(_pose(15, 0, 0.5)), in_ego[found.body == 1])
    assert len(at_car) > 30
    assert (np.abs(at_car[:, 0]) <= 2.25 + 1e-3).all()
    assert (np.abs(at_car[:, 1]) <= 0.9 + 1e-3).all()
    assert ((at_car[:, 2] >= -1e-3) & (at_car[:, 2] <= 1.5 + 1e-3)).all()
    np.testing.assert_allclose(found.message.range_m, found.true_range_m, atol=1e-5)


def _pose(x, y, yaw):
    return np.array([[np.cos(yaw), -np.sin(yaw), 0, x], [np.sin(yaw), np.cos(yaw), 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])


def test_noise_has_the_stated_deviations():
    caster, at = world(hall(40)), states((0, 0, 0))
    noise = {"range_noise_m": 0.2, "azimuth_noise_deg": 0.7, "altitude_noise_deg": 0.4, "speed_noise_mps": 0.3}
    clean = look(caster, at, radar(**EXACT)).message
    dirty = look(caster, at, radar(**EXACT | noise | {"rcs_noise_db": 2.0})).message
    for name, sigma in (
        ("range_m", 0.2), ("azimuth_rad", np.radians(0.7)), ("altitude_rad", np.radians(0.4)),
        ("radial_velocity_mps", 0.3), ("rcs_dbsm", 2.0),
    ):  # fmt: skip
        error = getattr(dirty, name).astype(np.float64) - getattr(clean, name)
        assert error.std() == pytest.approx(sigma, rel=0.03)
        assert error.mean() == pytest.approx(0, abs=4 * sigma / np.sqrt(len(error)))


@pytest.mark.parametrize(
    ("ego", "other"),
    [
        ((0, 0, 0), (20, 1, 0.3, 7.0, -2.0)),
        ((0, 0, 0, 15.0, 0.0), (20, 1, 0.3)),
        ((5, 5, 0.7, 8.0, 6.0, 0.5), (20, 18, -2.0, -3.0, 1.0, -0.8)),
    ],
    ids=["other moves", "ego moves", "both move and turn"],
)
def test_speed_is_how_fast_the_distance_changes(ego, other):
    """Oracle: the distance between the moving sensor and the moving point, a little earlier and later."""
    caster, at = world(ground(), car()), states(ego, other)
    found = look(caster, at, radar(**EXACT))
    world_T_ego = at.world_T_body(0)
    points = transform(world_T_ego, transform(MOUNT, found.message.xyz))
    sensor = transform(world_T_ego, MOUNT[None, :3, 3])
    later, earlier = (
        np.sqrt(((_after(at, found.body, points, s) - _after(at, np.zeros(1, int), sensor, s)) ** 2).sum(axis=1))
        for s in (1e-3, -1e-3)
    )
    assert (found.body == 1).sum() > 20
    np.testing.assert_allclose(found.message.radial_velocity_mps, (later - earlier) / 2e-3, atol=2e-4)


def _after(at, body, points, seconds):
    """Where points on bodies are some time later."""
    result = points.copy()
    for i in set(body[body >= 0]):
        mine, angle = body == i, at.yaw_rate_radps[i] * seconds
        arm = points[mine] - at.position_m[i]
        turned = np.stack(
            [
                np.cos(angle) * arm[:, 0] - np.sin(angle) * arm[:, 1],
                np.sin(angle) * arm[:, 0] + np.cos(angle) * arm[:, 1],
                arm[:, 2],
            ],
            axis=1,
        )
        result[mine] = at.position_m[i] + at.velocity_mps[i] * seconds + turned
    return result


def test_receding_is_positive():
    caster = world(ground(), car())
    for speed in (10.0, -10.0):
        found = look(caster, states((0, 0, 0), (30, 0, 0, speed, 0.0)))
        assert np.median(found.message.radial_velocity_mps[found.body == 1]) == pytest.approx(speed, abs=0.3)


def test_what_stands_has_no_speed_once_ego_motion_is_removed():
    caster, yaw, speed, rate = world(ground(), car()), 0.6, 12.0, 0.3
    at = states((0, 0, yaw, speed * np.cos(yaw), speed * np.sin(yaw), rate), (20, 14, 0))
    sensor_in_body = np.array([speed - rate * MOUNT[1, 3], rate * MOUNT[0, 3], 0.0])
    for changes, atol in ((EXACT, 2e-6), ({}, 0.5)):
        message = look(caster, at, radar(**changes)).message
        direction = message.xyz / message.range_m[:, None].astype(np.float64)
        over_ground = message.radial_velocity_mps + direction @ (MOUNT[:3, :3].T @ sensor_in_body)
        np.testing.assert_allclose(over_ground, 0, atol=atol)
    assert over_ground.std() == pytest.approx(np.sqrt(0.05**2 + 0.1**2 / 12), rel=0.3)


def test_a_standing_world_has_no_speed_at_all():
    message = look(
        world(ground(), car(), pedestrian()), states((0, 0, 0), (20, 2, 1), (9, -2, 0)), radar(**EXACT)
    ).message
    assert not message.radial_velocity_mps.any()


def test_values_are_multiples_of_the_resolution():
    steps = {
        "range_resolution_m": 0.4, "azimuth_resolution_deg": 1.5, "altitude_resolution_deg": 2.0,
        "speed_resolution_mps": 0.25,
    }  # fmt: skip
    message = look(world(ground(), car()), states((0, 0, 0, 10.0), (20, 2, 1, 3.0)), radar(**steps)).message
    for name, step in (
        ("range_m", 0.4), ("azimuth_rad", np.radians(1.5)), ("altitude_rad", np.radians(2.0)),
        ("radial_velocity_mps", 0.25),
    ):  # fmt: skip
        cells = getattr(message, name) / step
        np.testing.assert_allclose(cells, np.round(cells), atol=1e-4)
        assert len(np.unique(np.round(cells))) > 3


def test_steps_round_to_the_nearest():
    caster, at = world(hall(40)), states((0, 0, 0))
    exact, stepped = (look(caster, at, radar(**EXACT | {"range_resolution_m": step})).message for step in (0.0, 0.5))
    error = stepped.range_m - exact.range_m
    assert abs(error).max() <= 0.25 + 1e-5
    assert error.std() == pytest.approx(0.5 / np.sqrt(12), rel=0.05)


def test_merged_cells_hold_the_power_of_all_their_echoes():
    caster, at = world(ground("concrete"), car()), states((0, 0, 0), (12, 0, 1))
    coarse = {"range_resolution_m": 1.0, "azimuth_resolution_deg": 4.0, "altitude_resolution_deg": 4.0}
    every, merged = (look(caster, at, radar(**coarse, merge_cells=merge)) for merge in (False, True))
    cells = np.stack(_polar(merged), axis=1)
    assert len(np.unique(cells, axis=0)) == len(cells) < len(every.body) / 3
    np.testing.assert_array_equal(cells, np.unique(np.stack(_polar(every), axis=1), axis=0))  # sorted, and none missing
    for i in (0, len(cells) // 2, len(cells) - 1):
        same = (np.stack(_polar(every), axis=1) == cells[i]).all(axis=1)
        power = (10 ** (every.message.rcs_dbsm[same].astype(np.float64) / 10)).sum()
        assert merged.message.rcs_dbsm[i] == pytest.approx(10 * np.log10(power), abs=1e-4)
        assert merged.body[i] == every.body[same][np.argmax(every.message.rcs_dbsm[same])]


def _polar(found):
    message = found.message
    return message.range_m, message.azimuth_rad, message.altitude_rad, message.radial_velocity_mps


def test_without_resolution_nothing_merges():
    caster, at = world(ground(), car()), states((0, 0, 0), (12, 0, 1))
    every, merged = (look(caster, at, radar(**FINE, merge_cells=merge)) for merge in (False, True))
    assert len(every.body) == len(merged.body)


def test_what_touches_the_sensor_gives_no_echo():
    down = np.eye(4)
    down[:3, 3] = [0, 0, 1e-4]
    found = look(world(ground()), states((0, 0, 0)), mount=down)
    assert not (found.true_range_m < 0.2).any()
    assert np.isfinite(found.message.rcs_dbsm).all()


def test_nothing_to_see_is_an_empty_scan():
    sky = np.eye(4)
    sky[:3, :3] = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]
    sky[:3, 3] = [2, 0, 1]
    for merge in (False, True):
        found = look(world(ground()), states((0, 0, 0)), radar(merge_cells=merge), mount=sky)
        assert found.message.xyz.shape == (0, 3)
