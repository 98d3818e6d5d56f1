"""The one weather: its limits, and light and radar waves in it."""

import numpy as np
import pytest

from fbench.replay.conditions.weather import (
    Weather,
    extinction_per_m,
    fog_extinction_per_m,
    fog_of,
    koschmieder_per_m,
    radar_loss_db,
    rain_extinction_per_m,
    transmission,
)
from fbench.replay.contracts.errors import ConfigError


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("visibility_m", 9.9, "10 to 100000"),
        ("visibility_m", 100_001.0, "10 to 100000"),
        ("rain_mm_h", -0.1, "0 to 300"),
        ("rain_mm_h", 301.0, "0 to 300"),
        ("lux", -1.0, "0 to 150000"),
        ("lux", float("inf"), "0 to 150000"),
        ("sun_elevation_deg", 90.5, "-90 to 90"),
        ("sun_elevation_deg", float("nan"), "-90 to 90"),
        ("sun_azimuth_deg", float("-inf"), "-360 to 360"),
    ],
)
def test_a_number_out_of_range_is_refused(field, value, expected):
    with pytest.raises(ConfigError) as refused:
        Weather(**{field: value})
    assert str(refused.value) == f"Weather.{field}: expected {expected}, got {value!r}"


def test_limits_themselves_are_allowed():
    Weather(visibility_m=10.0, rain_mm_h=0.0, lux=0.0, sun_elevation_deg=-90.0, sun_azimuth_deg=-360.0)
    Weather(visibility_m=100_000.0, rain_mm_h=300.0, lux=150_000.0, sun_elevation_deg=90.0, sun_azimuth_deg=360.0)


@pytest.mark.parametrize(("per_m", "visibility_m"), [(0.005, 599), (0.01, 300), (0.02, 150), (0.03, 100), (0.06, 50)])
def test_extinction_of_fog_is_that_of_its_visibility(per_m, visibility_m):
    assert fog_extinction_per_m(Weather(visibility_m=visibility_m)) == pytest.approx(per_m, rel=2e-3)


def test_five_per_cent_of_light_comes_through_as_far_as_one_sees():
    for visibility_m in (50.0, 300.0, 20_000.0):
        assert transmission(Weather(visibility_m=visibility_m), np.array(visibility_m)) == pytest.approx(0.05)


def test_transmission_over_two_stretches_is_the_product_of_both():
    weather = Weather(visibility_m=400.0, rain_mm_h=20.0)
    near, far = np.array([3.0, 10.0, 70.0]), np.array([40.0, 1.0, 300.0])
    both = transmission(weather, near) * transmission(weather, far)
    np.testing.assert_allclose(transmission(weather, near + far), both, rtol=1e-12)


def test_rain_weakens_as_all_its_drops_do():
    """Twice the cross-section of Marshall and Palmer's drops, integrated here; and near Ulbrich and Atlas."""
    diameter_mm = np.linspace(0, 20, 200_001)
    for rate in (1.0, 10.0, 50.0, 100.0):
        drops = 8000 * np.exp(-4.1 * rate**-0.21 * diameter_mm)
        whole = np.trapezoid(2 * np.pi / 4 * (diameter_mm / 1000) ** 2 * drops, diameter_mm)
        assert rain_extinction_per_m(rate) == pytest.approx(whole, rel=5e-3)
        ulbrich_atlas = 1.45 * rate**0.64 / (10 / np.log(10)) / 1000
        assert rain_extinction_per_m(rate) == pytest.approx(ulbrich_atlas, rel=0.15)


def test_fog_and_rain_add_up():
    mixed = extinction_per_m(Weather(visibility_m=200.0, rain_mm_h=30.0))
    assert mixed == pytest.approx(np.log(20) / 200 + 3.65e-4 * 30**0.63)
    assert extinction_per_m(Weather()) == pytest.approx(1.498e-4, rel=1e-3)


def test_light_falls_by_beer_and_lambert():
    weather = Weather(visibility_m=150.0)
    for distance_m in (10.0, 50.0, 150.0):
        share = transmission(weather, np.array([distance_m, distance_m]))
        np.testing.assert_allclose(share, np.exp(-np.log(20) * distance_m / 150), rtol=1e-12)


@pytest.mark.parametrize(
    ("rain_mm_h", "at_100_m", "at_200_m"),
    [(5, 0.70, 1.41), (10, 1.15, 2.30), (25, 2.20, 4.40), (50, 3.59, 7.18), (100, 5.86, 11.72)],
)
def test_radar_loss_in_rain_is_that_of_the_recommendation(rain_mm_h, at_100_m, at_200_m):
    loss = radar_loss_db(Weather(visibility_m=100_000.0, rain_mm_h=rain_mm_h), np.array([100.0, 200.0]))
    np.testing.assert_allclose(loss, [at_100_m, at_200_m], atol=0.0051)


def test_radar_hardly_notices_fog_in_which_light_is_gone():
    fog = Weather(visibility_m=50.0)
    assert radar_loss_db(fog, np.array([100.0]))[0] < 0.25
    assert transmission(fog, np.array([200.0]))[0] < 1e-5  # a LiDAR's way to 100 m and back


def test_lidar_fog_takes_the_extinction_of_all_that_is_in_the_air():
    weather = Weather(visibility_m=100.0, rain_mm_h=50.0)
    fog = fog_of(weather)
    assert fog.alpha_per_m == extinction_per_m(weather) > koschmieder_per_m(100.0)
    assert fog.beta_per_m == pytest.approx(4.6e-4)
