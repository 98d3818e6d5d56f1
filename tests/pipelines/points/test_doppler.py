import numpy as np
import pytest

from fbench.pipelines.points.doppler import (
    PERIOD_KEY,
    DopplerParams,
    logged_period,
    range_rates,
    sensor_velocity,
    velocity_period,
    wrapped,
)
from fbench.pipelines.points.merged import Echoes
from fbench.replay.data import LogInfo
from fbench.replay.errors import LogError

STEP = 0.0812
PERIOD = 128 * STEP


def scene(velocity, moving=0.0, period=0.0, num=400, num_moving=40):
    """Stationary echoes all over the field of view, and one group that recedes over ground."""
    azimuth = np.concatenate([np.linspace(-0.9, 0.9, num), np.linspace(0.2, 0.25, num_moving)])
    direction = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(azimuth))])
    over_ground = np.concatenate([np.zeros(num), np.full(num_moving, moving)])
    measured = over_ground - direction[:, 0] * velocity[0] - direction[:, 1] * velocity[1]
    return Echoes(20 * direction, direction, wrapped(measured, period), np.zeros(len(azimuth)))


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (3.3, 0.0), (9.4, 0.1), (27.8, 0.0), (7.0, 0.9), (-2.5, 0.0)])
@pytest.mark.parametrize("period", [0.0, PERIOD])
def test_ego_velocity_with_and_without_aliasing(velocity, period):
    found = sensor_velocity(scene(velocity, 6.0, period), period, DopplerParams())
    assert found == pytest.approx(velocity, abs=0.05)


def test_range_rates_over_ground():
    rates, period = range_rates(scene((12.0, 0.0), -3.0), DopplerParams())
    assert period == 0
    assert np.abs(rates[:400]).max() < 0.05
    assert rates[400:] == pytest.approx(-3.0, abs=0.05)


def test_ambiguous_rates_are_taken_to_the_slowest():
    rates, _ = range_rates(scene((12.0, 0.0), 8.0, PERIOD), DopplerParams(period_mps=PERIOD))
    assert rates[400:] == pytest.approx(8.0 - PERIOD, abs=0.05)


@pytest.mark.parametrize("bins", [range(-63, 65), range(-60, 64), range(-62, 3)])
def test_period_from_a_grid_with_or_without_its_ends(bins):
    values = np.float32(STEP) * np.array(bins, np.float32)
    expected = PERIOD if len(bins) > 66 else PERIOD * (1 if len(bins) > 64 else 0.5)
    assert velocity_period(values.astype(np.float64)) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    "values",
    [[], [1.0], [0.5] * 100, np.sin(np.arange(500.0)) * 9, np.arange(10.0), [*np.arange(40.0), 0.3]],
    ids=["none", "one", "equal", "not on a grid", "few", "one beside the grid"],
)
def test_no_period_where_velocities_are_not_on_a_grid(values):
    assert velocity_period(np.asarray(values, np.float64)) == 0


def test_few_echoes_leave_the_radar_standing():
    rates, _ = range_rates(scene((5.0, 0.0), num=4, num_moving=1), DopplerParams())
    assert rates[2] == pytest.approx(-5 * np.cos(0.3))


def test_radar_without_velocities():
    echoes = scene((5.0, 0.0))
    blind = Echoes(echoes.xyz, echoes.direction, np.full(len(echoes.xyz), np.nan), echoes.magnitude_db)
    rates, period = range_rates(blind, DopplerParams())
    assert np.isnan(rates).all()
    assert period == 0


def test_period_that_the_log_gives():
    assert logged_period(LogInfo("drive", "id")) is None
    assert logged_period(LogInfo("drive", "id", {PERIOD_KEY: "10.4"})) == 10.4
    with pytest.raises(LogError, match=r"log 'drive': metadata radar.velocity_period_mps: expected a number, got 'x'"):
        logged_period(LogInfo("drive", "id", {PERIOD_KEY: "x"}))
