import numpy as np
import pytest

from fbench.pipelines.sensors.points.merged import Echoes
from fbench.pipelines.sensors.radar.doppler import (
    PERIOD_KEY,
    DopplerParams,
    over_ground,
    own_velocity,
    resolve_ego_motion,
    sensor_velocity,
    velocity_period,
    wrap_velocity,
)
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.rig import LogInfo

PERIOD = 128 * 0.0812


def range_rates(echoes, params):
    return over_ground(echoes, own_velocity(echoes, params))


def scene(velocity, moving=0.0, period=0.0, num=400, num_moving=40):
    """Stationary echoes all over the field of view, and one group that recedes over ground."""
    azimuth = np.concatenate([np.linspace(-0.9, 0.9, num), np.linspace(0.2, 0.25, num_moving)])
    direction = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(azimuth))])
    over_ground = np.concatenate([np.zeros(num), np.full(num_moving, moving)])
    measured = over_ground - direction[:, 0] * velocity[0] - direction[:, 1] * velocity[1]
    return Echoes(20 * direction, direction, wrap_velocity(measured, period), np.zeros(len(azimuth)), period)


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (3.3, 0.0), (9.4, 0.1), (27.8, 0.0), (7.0, 0.9), (-2.5, 0.0)])
@pytest.mark.parametrize("period", [0.0, PERIOD])
def test_ego_velocity_with_and_without_aliasing(velocity, period):
    found = sensor_velocity(scene(velocity, 6.0, period), DopplerParams())
    assert found == pytest.approx(velocity, abs=0.05)


def test_range_rates_over_ground():
    rates = range_rates(scene((12.0, 0.0), -3.0), DopplerParams())
    assert np.abs(rates[:400]).max() < 0.05
    assert rates[400:] == pytest.approx(-3.0, abs=0.05)


def test_ambiguous_rates_are_taken_to_the_slowest():
    rates = range_rates(scene((12.0, 0.0), 8.0, PERIOD), DopplerParams())
    assert rates[400:] == pytest.approx(8.0 - PERIOD, abs=0.05)


def test_rounded_velocities_are_not_taken_for_ambiguous():
    echoes = scene((15.0, 0.0), -14.0)
    rounded = Echoes(echoes.xyz, echoes.direction, np.round(echoes.radial_velocity_mps * 4) / 4, echoes.magnitude_db)
    rates = range_rates(rounded, DopplerParams())
    assert rates[400:] == pytest.approx(-14.0, abs=0.2)


def test_few_echoes_leave_the_radar_standing():
    rates = range_rates(scene((5.0, 0.0), num=4, num_moving=1), DopplerParams())
    assert rates[2] == pytest.approx(-5 * np.cos(0.3))


def test_radar_without_velocities():
    echoes = scene((5.0, 0.0))
    blind = Echoes(echoes.xyz, echoes.direction, np.full(len(echoes.xyz), np.nan), echoes.magnitude_db)
    assert np.isnan(range_rates(blind, DopplerParams())).all()


def test_periods_that_the_log_gives():
    def periods(metadata, given=None):
        log, params = LogInfo("drive", "id", metadata), DopplerParams(period_mps=given)
        return {name: velocity_period(name, log, params) for name in ("left", "right")}

    assert periods({}) == {"left": 0.0, "right": 0.0}
    assert periods({PERIOD_KEY: "10.4"}) == {"left": 10.4, "right": 10.4}
    own = {PERIOD_KEY: "10.4", "radar.left.velocity_period_mps": "0"}
    assert periods(own) == {"left": 0.0, "right": 10.4}
    assert periods(own, 5.0) == {"left": 5.0, "right": 5.0}
    assert periods(own, 0.0) == {"left": 0.0, "right": 0.0}


@pytest.mark.parametrize("text", ["x", "", "-10.4", "nan", "inf", "1e-320"])
@pytest.mark.parametrize("key", [PERIOD_KEY, "radar.front.velocity_period_mps"])
def test_periods_that_are_none(key, text):
    match = rf"log 'drive': metadata {key}: expected 0 or a number from 0\.1 to 1000, got '{text}'"
    with pytest.raises(LogError, match=match):
        velocity_period("front", LogInfo("drive", "id", {key: text}), DopplerParams())


def test_velocities_that_are_free_of_ego_motion_stay_as_they_are():
    """Most echoes come nearer: without being told, that would be taken for the vehicle's own motion."""
    echoes = scene((0.0, 0.0), -8.0, num=100, num_moving=300)
    removed = DopplerParams(ego_motion="removed")
    np.testing.assert_array_equal(range_rates(echoes, removed), echoes.radial_velocity_mps)
    assert range_rates(echoes, DopplerParams())[100:] == pytest.approx(0.0, abs=0.5)


def test_the_log_says_whether_ego_motion_is_removed():
    told = LogInfo("a", "b", {"radar.front.ego_motion": "removed"})
    assert resolve_ego_motion("front", told, DopplerParams()).ego_motion == "removed"
    assert resolve_ego_motion("rear", told, DopplerParams()).ego_motion == "included"
    assert resolve_ego_motion("front", told, DopplerParams(ego_motion="included")).ego_motion == "included"
    odd = LogInfo("a", "b", {"radar.ego_motion": "perhaps"})
    with pytest.raises(LogError, match="expected 'included' or 'removed', got 'perhaps'"):
        resolve_ego_motion("front", odd, DopplerParams())
