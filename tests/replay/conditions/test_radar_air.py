"""How rain and fog weaken radar waves, against the recommendations' figures."""

import pytest

from fbench.replay.conditions.weather import fog_db_per_km, liquid_water_g_m3, radar_rain_db_per_km
from fbench.replay.contracts.errors import ConfigError


@pytest.mark.parametrize(("rain_mm_h", "db_per_km"), [(5, 3.52), (10, 5.75), (25, 10.99), (50, 17.94), (100, 29.29)])
def test_rain_at_77_ghz(rain_mm_h, db_per_km):
    assert radar_rain_db_per_km(rain_mm_h) == pytest.approx(db_per_km, abs=0.0051)


@pytest.mark.parametrize(
    ("frequency_ghz", "k", "a"),
    [(24, 0.1404, 0.9561), (76.5, 1.1208, 0.7082), (79, 1.1541, 0.7038), (81, 1.1793, 0.7004)],
)
def test_rain_at_other_frequencies(frequency_ghz, k, a):
    assert radar_rain_db_per_km(1.0, frequency_ghz) == pytest.approx(k)
    assert radar_rain_db_per_km(30.0, frequency_ghz) == pytest.approx(k * 30**a)


def test_between_frequencies_it_lies_between():
    assert radar_rain_db_per_km(10, 77) < radar_rain_db_per_km(10, 78) < radar_rain_db_per_km(10, 79)


def test_no_rain_no_loss():
    assert radar_rain_db_per_km(0.0) == 0


def test_thick_fog_of_half_a_gram():
    """0.63 dB to 200 m and back; fog of 50 m visibility is thinner."""
    per_m = 144.7 * 0.5**0.88 / 1000
    assert liquid_water_g_m3(per_m) == pytest.approx(0.5)
    assert fog_db_per_km(per_m) * 0.4 == pytest.approx(0.63)
    assert 0.3 < liquid_water_g_m3(0.0599) < 0.4


@pytest.mark.parametrize("frequency_ghz", [10.0, 100.0, float("nan")])
def test_other_bands_are_refused(frequency_ghz):
    with pytest.raises(ConfigError, match="expected 24 to 81"):
        radar_rain_db_per_km(10.0, frequency_ghz)
    with pytest.raises(ConfigError, match="expected 24 to 81"):
        fog_db_per_km(0.01, frequency_ghz)
