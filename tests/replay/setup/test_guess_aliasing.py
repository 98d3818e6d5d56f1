"""Velocities that wrap around fill their range up to both ends."""

import numpy as np
import pytest

from fbench.replay.data.messages import RadarScan
from fbench.replay.logs.roles import Role
from fbench.replay.setup.guess_radar import period_line
from fbench.replay.setup.guess_sensors import Candidate
from fbench.replay.setup.inspection import SampledMessage, SampledTopic


def radar(velocity_mps, name="front", is_own=False):
    points = np.zeros((len(velocity_mps), 3), np.float32)
    scan = RadarScan(name, 1, 1, points, np.asarray(velocity_mps, np.float32))
    heard = SampledTopic(
        Role("radar", "/radar", name, is_own=is_own), "x", 1, samples=[SampledMessage(0, 1, 1, scan=scan)]
    )
    return Candidate(heard, name, "radar", "")


@pytest.fixture
def true_mps():
    """Stationary echoes seen over 100 degrees at 16 m/s, and some traffic."""
    random = np.random.default_rng(5)
    return np.concatenate([-16 * np.cos(random.uniform(-0.87, 0.87, 3000)), random.normal(0, 4, 300)])


def test_a_period_is_found_to_the_width_of_a_step(true_mps):
    step, bins = 0.0812, 128
    measured = (np.round(true_mps / step).astype(int) + bins // 2) % bins - bins // 2
    wrapped = np.concatenate([measured, np.arange(-64, 64)]) * step
    line = period_line(radar(wrapped))
    assert (line.key, line.is_guess) == ("velocity_period_mps", True)
    assert line.value == pytest.approx(10.394, abs=0.001)


def test_a_radar_that_measures_in_fine_steps(true_mps):
    wrapped = (true_mps + 4) % 8 - 4
    assert period_line(radar(wrapped)).value == pytest.approx(8, abs=0.05)


@pytest.mark.parametrize("sign", [1, -1])
def test_velocities_that_thin_out_are_unambiguous(true_mps, sign):
    assert period_line(radar(sign * true_mps)) is None
    assert period_line(radar(sign * np.round(true_mps))) is None


def test_nothing_is_said_without_evidence(true_mps):
    assert period_line(radar(np.linspace(-4, 4, 500))) is None
    assert period_line(radar(np.zeros(2000))) is None
    assert period_line(radar(np.full(2000, np.nan))) is None
    assert period_line(radar((true_mps + 4) % 8 - 4, is_own=True)) is None
