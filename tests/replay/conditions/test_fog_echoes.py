"""What a LiDAR receives in fog, against the published figures and direct integration."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import beta

from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.lidar.echoes import fog_echoes, fog_return

C = 299_792_458.0


def fog_of_alpha(alpha):
    return fog_return(alpha, np.log(20) / alpha)


def direct(alpha, at_m, target_m):
    """The convolution at one range by adaptive quadrature over the pulse's time."""

    def part(t):
        x = at_m - C * t / 2
        xi = np.clip((x - 0.9) / 0.1, 0, 1)
        return np.sin(np.pi * t / 40e-9) ** 2 * np.exp(-2 * alpha * x) / x**2 * xi if 0.9 < x < target_m else 0.0

    breaks = [t for x in (0.9, 1.0) if 0 < (t := 2 * (at_m - x) / C) < 40e-9]
    return quad(lambda ns: part(ns * 1e-9), 0, 40, points=[1e9 * t for t in breaks] or None, limit=200)[0] * 1e-9


@pytest.mark.parametrize(
    ("alpha", "backscatter", "peak_m", "integral", "switch_m"),
    [
        (0.005, 7.68e-5, 4.7, 4.568e-9, 259.8),
        (0.01, 1.54e-4, 4.7, 4.493e-9, 150.6),
        (0.02, 3.07e-4, 4.7, 4.347e-9, 86.5),
        (0.03, 4.61e-4, 4.7, 4.206e-9, 62.4),
        (0.06, 9.21e-4, 4.6, 3.815e-9, 35.6),
    ],
)
def test_figures_of_each_density_are_the_published_ones(alpha, backscatter, peak_m, integral, switch_m):
    fog = fog_of_alpha(alpha)
    assert fog.beta_per_m == pytest.approx(backscatter, rel=4e-3)
    assert round(fog.peak_m, 1) == peak_m
    at_peak = fog.integral(np.array([peak_m]))[0]  # theirs lies on a grid of 0.1 m
    assert at_peak == pytest.approx(integral, abs=0.51e-12)
    assert round(fog.switch_m, 1) == switch_m


def test_echo_of_fog_before_near_targets():
    near = fog_of_alpha(0.03).integral(np.array([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_allclose(near, [1.63e-13, 4.54e-10, 2.08e-9, 3.79e-9], rtol=2e-3)


@pytest.mark.parametrize("alpha", [0.005, 0.03, 0.3])
def test_table_is_the_integral(alpha):
    fog = fog_of_alpha(alpha)
    for target_m in (1.0, 1.5, 2.5, 3.7, 4.4, 5.0, 80.0):
        largest = max(direct(alpha, at, target_m) for at in np.arange(0.95, min(target_m, 6.0) + 1e-9, 0.05))
        assert fog.integral(np.array([target_m]))[0] == pytest.approx(largest, rel=5e-3)


def test_every_density_has_its_own_figures():
    """Not those of the nearest one in a table, as where a float rounded to a digit is looked up (defect 4)."""
    switches = [fog_return(np.log(20) / m, m).switch_m for m in (100.0, 100.4, 100.8, 101.2)]
    assert (np.diff(switches) > 0.05).all()


def test_beyond_five_metres_the_target_changes_nothing_for_the_fog():
    fog = fog_of_alpha(0.02)
    assert len(set(fog.integral(np.array([5.0, 6.0, 50.0, 300.0])))) == 1
    np.testing.assert_array_equal(fog.soft_range_m(np.array([2.0, 4.0, 50.0])), [2.0, 4.0, fog.peak_m])


@pytest.mark.parametrize("visibility_m", [10.0, 50.0, 300.0, 20_000.0])
def test_fog_wins_exactly_beyond_the_switch(visibility_m):
    fog = fog_return(np.log(20) / visibility_m, visibility_m)
    near, far = fog.switch_m * np.array([0.999, 1.001])
    assert fog.soft_strength(np.array([near]))[0] < fog.hard_strength(np.array([near]))[0]
    assert fog.soft_strength(np.array([far]))[0] > fog.hard_strength(np.array([far]))[0]
    below = np.linspace(0.5, near, 2000)
    assert not (fog.soft_strength(below) > fog.hard_strength(below)).any()
    assert fog.switch_m > 5


def test_targets_before_the_switch_keep_their_range_and_lose_by_beer_and_lambert():
    fog = fog_of_alpha(0.03)
    range_m = np.linspace(1.0, 62.0, 500)
    echoes = fog_echoes(fog, range_m, generator(1, "fog"))
    assert not echoes.soft.any()
    np.testing.assert_array_equal(echoes.range_m, range_m)
    np.testing.assert_allclose(echoes.strength, np.exp(-0.06 * range_m))


def test_farther_targets_become_fog_at_its_peak():
    fog = fog_of_alpha(0.06)
    range_m = np.full(50_000, 60.0)
    echoes = fog_echoes(fog, range_m, generator(1, "fog"))
    assert echoes.soft.all()
    scatter = echoes.range_m - fog.peak_m
    expected = beta(2, 20)
    assert scatter.mean() / 10 == pytest.approx(expected.mean(), abs=3 * expected.std() / np.sqrt(50_000))
    assert scatter.std() / 10 == pytest.approx(expected.std(), rel=0.03)
    np.testing.assert_allclose(echoes.strength, fog.soft_strength(range_m))


def test_fog_never_answers_from_behind_the_target():
    fog = fog_return(np.log(20) / 10, 10.0)
    range_m = np.linspace(fog.switch_m, fog.switch_m + 1, 20_000)
    echoes = fog_echoes(fog, range_m, generator(3, "fog"))
    assert (echoes.range_m <= range_m).all()


def test_same_seed_same_echoes_and_input_is_kept():
    fog, range_m = fog_of_alpha(0.06), np.linspace(1, 100, 1000)
    before = range_m.copy()
    first, again, other = (fog_echoes(fog, range_m, generator(seed, "fog")) for seed in (1, 1, 2))
    assert first.range_m.tobytes() == again.range_m.tobytes() != other.range_m.tobytes()
    np.testing.assert_array_equal(range_m, before)
