"""What a LiDAR receives in rain, against a simulation of every single drop."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import ks_2samp

from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.lidar.echoes import KEPT, LOST, SCATTERED, particle_echoes, rain_drops
from fbench.replay.conditions.weather import rain_extinction_per_m

FLOOR = 0.9 / 200**2
WATER = (0.328 / 2.328) ** 2


def rain_echoes(rate, *args, **reach):
    return particle_echoes([rain_drops(rate)] if rate > 0 else [], *args, **reach)


def every_drop(rate, alpha, range_m, reflectivity, num_beams, rng):
    """Range of the strongest echo of each of equal beams, 0 where none is strong enough, from all drops in them."""
    slope = 4.1 * rate**-0.21
    per_m3 = 8000 / slope * np.exp(-slope * 0.05)
    num = rng.poisson(per_m3 * np.pi / 3 * range_m * (range_m * np.tan(3e-3) / 2) ** 2, num_beams)
    beam = np.repeat(np.arange(num_beams), num)
    r = range_m * rng.random(len(beam)) ** (1 / 3)
    size_mm = 0.05 + rng.exponential(1 / slope, len(beam))
    power = WATER * np.exp(-2 * alpha * r) * np.minimum((size_mm / (1000 * np.tan(3e-3) * r)) ** 2, 1) / r**2
    power[r < 1.5] = 0
    strongest, at = np.zeros(num_beams), np.zeros(num_beams)
    order = np.argsort(power, kind="stable")
    strongest[beam[order]], at[beam[order]] = power[order], r[order]
    target = reflectivity * np.exp(-2 * alpha * range_m) / range_m**2
    result = np.where(strongest > target, at, range_m)
    return np.where(np.maximum(strongest, target) < FLOOR, 0.0, result)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "range_m", "reflectivity"),
    [(10.0, 40.0, 0.15), (50.0, 30.0, 0.2), (100.0, 25.0, 0.05), (25.0, 40.0, 0.01)],
)
def test_drops_win_as_often_and_as_far_away_as_if_all_were_drawn(rate, range_m, reflectivity):
    alpha, num_brute, num = rain_extinction_per_m(rate), 12_000, 100_000
    brute = every_drop(rate, alpha, range_m, reflectivity, num_brute, np.random.default_rng(5))
    echoes = rain_echoes(rate, alpha, np.full(num, range_m), np.full(num, reflectivity), generator(1, "rain"))
    hit = (brute > 0) & (brute < range_m)
    share = (echoes.label == SCATTERED).mean()
    assert share == pytest.approx(hit.mean(), abs=3 * np.sqrt(share / num_brute + share / num))
    assert (echoes.label == LOST).mean() == pytest.approx((brute == 0).mean(), abs=0.01)
    noise = np.random.default_rng(6).normal(0, 0.05, hit.sum())
    assert ks_2samp(brute[hit] + noise, echoes.range_m[echoes.label == SCATTERED]).pvalue > 1e-3


@pytest.mark.parametrize("rate", [2.0, 25.0, 200.0])
def test_share_of_scattered_beams_is_the_integral_along_the_beam(rate):
    alpha, range_m, reflectivity, num = rain_extinction_per_m(rate), 60.0, 0.3, 300_000
    slope = 4.1 * rate**-0.21
    needed = reflectivity * np.exp(-2 * alpha * range_m) / range_m**2

    def stronger_drops_per_m(r):
        share = needed / (WATER * np.exp(-2 * alpha * r) / r**2)
        if share > 1:
            return 0.0
        smallest = max(1000 * np.tan(3e-3) * r * np.sqrt(share), 0.05)
        return 8000 / slope * np.exp(-slope * smallest) * np.pi * (r * np.tan(3e-3) / 2) ** 2

    expected = 1 - np.exp(-quad(stronger_drops_per_m, 1.5, 12, limit=200)[0])
    echoes = rain_echoes(rate, alpha, np.full(num, range_m), np.full(num, reflectivity), generator(2, "rain"))
    assert (echoes.label == SCATTERED).mean() == pytest.approx(expected, abs=4 * np.sqrt(expected / num))


def test_range_noise_follows_the_signal():
    for range_m in (5.0, 50.0, 100.0):
        echoes = rain_echoes(0.0, 0.0, np.full(40_000, range_m), np.full(40_000, 0.6), generator(3, "rain"))
        assert (echoes.label == KEPT).all()
        sigma = 0.09 / np.sqrt(2 * 0.6 / range_m**2 / FLOOR)
        assert (echoes.range_m - range_m).std() == pytest.approx(sigma, rel=0.02)
        assert (echoes.range_m - range_m).mean() == pytest.approx(0, abs=3 * sigma / 200)


def test_without_rain_the_floor_alone_decides():
    range_m = np.array([199.0, 201.0, 66.0, 67.0, 50.0, np.inf])
    reflectivity = np.array([0.9, 0.9, 0.1, 0.1, 0.0, 0.5])
    echoes = rain_echoes(0.0, 0.0, range_m, reflectivity, generator(0, "rain"))
    np.testing.assert_array_equal(echoes.label, [KEPT, LOST, KEPT, LOST, LOST, LOST])
    assert np.isinf(echoes.range_m[echoes.label == LOST]).all()
    assert (echoes.power[echoes.label == LOST] == 0).all()


def test_power_of_targets_falls_by_beer_and_lambert_there_and_back():
    alpha, range_m = 0.01, np.array([10.0, 30.0, 60.0])
    echoes = rain_echoes(0.0, alpha, range_m, np.full(3, 0.5), generator(0, "rain"))
    np.testing.assert_allclose(echoes.power * range_m**2, 0.5 * np.exp(-2 * alpha * range_m))


def test_drops_answer_beams_into_the_sky_and_never_from_behind_the_target():
    num = 20_000
    sky = rain_echoes(50.0, 0.004, np.full(num, np.inf), np.zeros(num), generator(4, "rain"))
    assert 0.02 < (sky.label == SCATTERED).mean() < 0.3
    assert not (sky.label == KEPT).any()
    near = rain_echoes(50.0, 0.004, np.full(num, 2.0), np.full(num, 0.001), generator(4, "rain"))
    assert (near.range_m[near.label == SCATTERED] < 2.3).all()


def test_more_rain_scatters_more_and_keeps_less():
    rng = np.random.default_rng(0)
    range_m, reflectivity = rng.uniform(2, 100, 20_000), rng.uniform(0.02, 0.6, 20_000)
    labels = [
        rain_echoes(rate, rain_extinction_per_m(rate), range_m, reflectivity, generator(7, "rain")).label
        for rate in (0.0, 2.0, 10.0, 50.0, 200.0)
    ]
    scattered, kept = ([(label == which).sum() for label in labels] for which in (SCATTERED, KEPT))
    assert scattered[0] == 0
    assert (np.diff(scattered) > 0).all()
    assert (np.diff(kept) < 0).all()


def test_a_sensor_of_short_range_sees_no_drops():
    echoes = rain_echoes(100.0, 0.0, np.full(10_000, 5.0), np.ones(10_000), generator(0, "rain"), sensor_range_m=8.0)
    assert (echoes.label == KEPT).all()


def test_same_seed_same_echoes_and_no_beams_no_echoes():
    args = (20.0, 0.003, np.linspace(1, 90, 5000), np.full(5000, 0.3))
    first, again, other = (rain_echoes(*args, generator(seed, "rain")) for seed in (1, 1, 2))
    assert first.range_m.tobytes() == again.range_m.tobytes() != other.range_m.tobytes()
    assert len(rain_echoes(20.0, 0.003, np.zeros(0), np.zeros(0), generator(1, "rain")).label) == 0
