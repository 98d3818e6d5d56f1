"""Recorded radar scans in rain, snow and fog."""

import numpy as np
import pytest
from tests.replay.conditions.sites import bytes_of, cloud, has_consistent_polar, scan, site, standing, street

from fbench.replay.conditions.lidar.weather import disturb_cloud
from fbench.replay.conditions.radar.echoes import Sensitivity
from fbench.replay.conditions.radar.weather import disturb_scan
from fbench.replay.conditions.weather import Weather

RAINS = ((5, 3.52), (10, 5.75), (25, 10.99), (50, 17.94), (100, 29.29))


def own(after, before):
    """Rows of `before` that are in `after`, with those of the latter; points don't move in weather."""
    rows = {row.tobytes(): i for i, row in enumerate(before.xyz)}
    pairs = [(rows[row.tobytes()], i) for i, row in enumerate(after.xyz) if row.tobytes() in rows]
    return np.array(pairs).T


@pytest.mark.parametrize(("rain_mm_h", "db_per_km"), RAINS)
def test_echoes_lose_twice_the_attenuation_of_the_recommendation(rain_mm_h, db_per_km):
    base = standing()
    after = disturb_scan(base, Weather(rain_mm_h=float(rain_mm_h)), site("radar"))
    before_rows, after_rows = own(after, base)
    loss = base.rcs_dbsm[before_rows] - after.rcs_dbsm[after_rows]
    np.testing.assert_allclose(loss, 2 * db_per_km * base.range_m[before_rows] / 1000, atol=0.012)


@pytest.mark.parametrize(("rain_mm_h", "reach_m"), [(5, 142), (10, 137), (25, 128), (50, 118), (100, 105)])
def test_reach_shrinks_by_the_fourth_power_law(rain_mm_h, reach_m):
    """A target that is just found at 150 m in clear air, of the anchors' table."""
    range_m = np.concatenate([np.linspace(10, 150, 14_001), np.full(200, 150.0)])
    base = scan(np.stack([range_m, range_m * 0, range_m * 0], axis=1))  # equally large targets
    after = disturb_scan(base, Weather(rain_mm_h=float(rain_mm_h)), site("radar"))
    assert own(after, base)[0].max() == pytest.approx(100 * (reach_m - 10), abs=60)


def test_fog_is_next_to_nothing_for_radar_while_lidar_collapses():
    dense = Weather(visibility_m=50.0)
    base = standing()
    after = disturb_scan(base, dense, site("radar"))
    assert len(after.xyz) > 0.98 * len(base.xyz)
    rows = own(after, base)
    assert rows.shape[1] == len(after.xyz)
    loss = base.rcs_dbsm[rows[0]] - after.rcs_dbsm[rows[1]]
    assert 0 < loss.max() < 0.35
    far = street()
    far = cloud(far.xyz[np.abs(far.xyz).max(axis=1) > 25], far.intensity[np.abs(far.xyz).max(axis=1) > 25])
    seen = disturb_cloud(far, dense, site()).xyz
    assert (np.sqrt((seen**2).sum(axis=1)) > 20).sum() < 0.5 * len(far.xyz)


@pytest.mark.parametrize("name", ["rain_mm_h", "snow_mm_h"])
def test_heavier_weather_leaves_fewer_echoes_and_rain_adds_clutter(name):
    base, left = standing(), []
    for rate in (8.0, 25.0, 80.0, 250.0):
        after = disturb_scan(base, Weather(**{name: rate}), site("radar"))
        left.append(own(after, base).shape[1])
        added = len(after.xyz) - left[-1]
        assert (added > 0) == (name == "rain_mm_h")
        assert has_consistent_polar(after)
    assert left[0] < len(base.xyz)
    assert (np.diff(left) < 0).all()


def test_snow_takes_less_than_rain():
    base = standing()
    left = [
        len(own(disturb_scan(base, w, site("radar")), base)[0])
        for w in (Weather(snow_mm_h=50.0), Weather(rain_mm_h=50.0))
    ]
    assert left[0] > left[1]


def test_sensors_that_give_a_magnitude_have_the_same_floor_everywhere():
    rng = np.random.default_rng(0)
    range_m = rng.uniform(5, 100, 3000)
    xyz = np.stack([range_m, range_m * 0, range_m * 0], axis=1)
    magnitude = Sensitivity(scan(xyz, rcs=45 + rng.exponential(5, 3000)))
    assert magnitude.decade_db == 0
    assert magnitude.floor_db == pytest.approx(45, abs=0.1)
    section = Sensitivity(standing())
    assert section.decade_db == 40
    assert section.floor_db == pytest.approx(-7 - 80, abs=0.5)
    np.testing.assert_allclose(section.weakest_db(np.array([100.0, 10.0])), [-7, -47], atol=0.5)


def test_coarse_strengths_at_the_floor_are_not_all_lost_at_once():
    rng = np.random.default_rng(0)
    range_m = rng.uniform(5, 100, 3000)
    coarse = np.floor(rng.exponential(4, 3000) * 2) / 2 + 45
    base = scan(np.stack([range_m, range_m * 0, range_m * 0], axis=1), rcs=coarse)
    after = disturb_scan(base, Weather(visibility_m=50.0), site("radar"))
    at_floor = (coarse == 45).sum()
    assert 0 < len(base.xyz) - len(after.xyz) < 0.5 * at_floor


def test_scans_without_strength_lose_what_is_far():
    base = standing()
    bare = scan(base.xyz, base.radial_velocity_mps)
    after = disturb_scan(bare, Weather(rain_mm_h=100.0), site("radar"))
    assert after.rcs_dbsm is None
    before_rows, _ = own(after, bare)
    gone = np.setdiff1d(np.arange(len(bare.xyz)), before_rows)
    assert base.range_m[gone].min() > 60


@pytest.mark.parametrize("weather", [Weather(), Weather(lux=0.3), Weather(water_mm=1.0)])
def test_what_a_radar_does_not_feel_changes_nothing(weather):
    base = standing()
    assert disturb_scan(base, weather, site("radar")) is base


def test_input_is_kept_and_seeds_count():
    base, weather = standing(), Weather(rain_mm_h=50.0)
    before = bytes_of(base)
    a, b, c = (bytes_of(disturb_scan(base, weather, site("radar", seed=seed))) for seed in (0, 0, 1))
    assert a == b != c
    assert bytes_of(base) == before


def test_empty_scans_and_points_that_are_nowhere():
    empty = scan(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    assert disturb_scan(empty, Weather(rain_mm_h=50.0), site("radar")) is empty
    nowhere = scan(np.full((2, 3), np.nan), np.zeros(2), np.zeros(2))
    assert len(disturb_scan(nowhere, Weather(rain_mm_h=50.0), site("radar")).xyz) == 2
