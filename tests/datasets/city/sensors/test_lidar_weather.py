"""A LiDAR in fog and rain: Beer-Lambert, where fog outshines targets, what drops do."""

import numpy as np
import pytest
from tests.datasets.city.sensors.lidar_worlds import CLEAR, bytes_of, drum, lidar, ranges, turn

from fbench.datasets.city.instant import MISS, STATIC
from fbench.replay.conditions.weather import Weather

LEVEL = {"upper_deg": 0.5, "lower_deg": -0.5}
"""Beams that meet a drum at right angles."""


@pytest.mark.parametrize("visibility_m", [50.0, 100.0, 300.0, 1000.0])
def test_fog_weakens_echoes_by_beer_lambert(visibility_m):
    radii = [3.0, 6.0, 10.0, 15.0, 20.0]
    weather = Weather(visibility_m=visibility_m)
    spec = lidar(**LEVEL, noise_m=0.0)
    logs = [float(np.log(np.median(turn(drum(r), spec=spec, weather=weather).cloud.intensity))) for r in radii]
    slope = np.polyfit(radii, logs, 1)[0]
    assert slope == pytest.approx(-2 * np.log(20) / visibility_m, rel=0.01)


@pytest.mark.parametrize(("visibility_m", "switch_m"), [(599.0, 259.8), (300.0, 150.6), (150.0, 86.5), (100.0, 62.4),
                                                        (50.0, 35.6)])  # fmt: skip
def test_from_a_distance_on_fog_outshines_every_target(visibility_m, switch_m):
    """Distances of Hahner's model, calculated apart (anchors, part 1.3)."""
    spec = lidar(**LEVEL, range_m=400.0, points_per_s=100_000)
    for r, is_fog in ((switch_m * 0.985, False), (switch_m * 1.015, True)):
        result = turn(drum(r, "sign"), spec=spec, weather=Weather(visibility_m=visibility_m))
        assert len(result.body) > 4_500
        assert set(result.body.tolist()) == {MISS if is_fog else STATIC}
        if is_fog:
            assert 4.5 < np.median(ranges(result)) < 6
            assert ranges(result).max() < 15
            assert ranges(result).min() > 4.4


def test_fog_hides_what_clear_air_shows():
    spec = lidar(**LEVEL)
    assert len(turn(drum(60, "brick"), spec=spec).body) > 45_000
    assert len(turn(drum(60, "brick"), spec=spec, weather=Weather(visibility_m=100.0)).body) == 0
    assert len(turn(drum(20, "brick"), spec=spec, weather=Weather(visibility_m=100.0)).body) > 45_000


def test_noise_does_not_depend_on_fog():
    a, b = (turn(drum(15), spec=lidar(**LEVEL), weather=w) for w in (CLEAR, Weather(visibility_m=200.0)))
    np.testing.assert_array_equal(a.cloud.xyz, b.cloud.xyz)
    assert (a.cloud.intensity > b.cloud.intensity).all()


def test_drops_give_false_points_near_the_sensor_more_in_heavier_rain():
    counts = []
    for rate in (2.0, 10.0, 50.0):
        result = turn(drum(80, "plaster"), weather=Weather(rain_mm_h=rate))
        false = result.body == MISS
        counts.append(int(false.sum()))
        assert np.median(ranges(result)[false]) < 20
        assert ranges(result)[false].min() > 1
    assert 0 < counts[0] < counts[1] < counts[2] < 10_000


def test_rain_makes_weak_echoes_noisier():
    """By 0.09 / sqrt(2 P / P_min) beside the sensor's own noise; P_min is that of 10 % at 100 m in clear air."""
    weather = Weather(rain_mm_h=25.0)
    alpha = 3.65e-4 * 25**0.63 + np.log(20) / 20_000
    floor = 0.1 * np.exp(-2 * np.log(20) / 20_000 * 100) / 100**2
    for r in (10.0, 30.0, 60.0):
        result = turn(drum(r), spec=lidar(**LEVEL), weather=weather)
        hard = result.body == STATIC
        assert hard.sum() > 30_000
        error = (ranges(result) - result.range_m)[hard]
        power = 0.5 * np.exp(-2 * alpha * r) / r**2
        assert error.std() == pytest.approx(np.hypot(0.01, 0.09 / np.sqrt(2 * power / floor)), rel=0.02)
        assert np.median(result.cloud.intensity[hard]) == pytest.approx(0.5 * np.exp(-2 * alpha * r), rel=0.02)


def test_rain_loses_what_is_far_and_dark():
    spec = lidar(**LEVEL)
    clear, wet = (turn(drum(74, "rubber"), spec=spec, weather=w) for w in (CLEAR, Weather(rain_mm_h=50.0)))
    assert (clear.body == STATIC).sum() > 45_000
    assert (wet.body == STATIC).sum() == 0


@pytest.mark.parametrize("weather", [Weather(visibility_m=60.0), Weather(rain_mm_h=30.0),
                                     Weather(visibility_m=60.0, rain_mm_h=30.0)])  # fmt: skip
def test_weather_is_seeded(weather):
    a, b, c = (bytes_of(turn(drum(40), weather=weather, seed=seed)) for seed in (0, 0, 1))
    assert a == b != c
