"""Car following against hand-computed values."""

import numpy as np
import pytest

from fbench.datasets.city.traffic.follow_kernel import HARDEST_MPS2, free_acceleration, interaction, limit_braking


def test_free_road_matches_hand_computed_values() -> None:
    assert free_acceleration(0.0, 30.0, 1.5, 2.0) == 1.5
    assert free_acceleration(15.0, 30.0, 1.5, 2.0) == pytest.approx(1.5 * (1 - 1 / 16))
    assert free_acceleration(30.0, 30.0, 1.5, 2.0) == 0.0


def test_too_fast_brakes_no_harder_than_comfortable() -> None:
    assert -2.0 < free_acceleration(60.0, 10.0, 1.5, 2.0) < -1.8
    assert free_acceleration(10.5, 10.0, 1.0, 1.0) == pytest.approx(-(1 - (10 / 10.5) ** 4))


def test_interaction_matches_hand_computed_value() -> None:
    # s* = 2 + 20 * 1.5 + 20 * 5 / (2 sqrt(1 * 2.25)) = 2 + 30 + 33.333; a (s* / 50)^2
    assert interaction(20.0, 50.0, 5.0, 1.5, 2.0, 1.0, 2.25) == pytest.approx((65.0 + 1 / 3) ** 2 / 2500)


def test_a_faster_leader_never_lowers_the_gap_below_the_standing_one() -> None:
    assert interaction(10.0, 2.0, -100.0, 1.5, 2.0, 1.0, 2.25) == pytest.approx(1.0)


@pytest.mark.parametrize("v", [5.0, 15.0, 25.0])
def test_equilibrium_gap_is_that_of_the_fundamental_diagram(v: float) -> None:
    # Treiber et al. (2000), equation 5: s_e(v) = (s0 + v T) / sqrt(1 - (v / v0)^4)
    gap = (2.0 + v * 1.2) / np.sqrt(1 - (v / 33.0) ** 4)
    rest = free_acceleration(v, 33.0, 1.4, 2.0) - interaction(v, gap, 0.0, 1.2, 2.0, 1.4, 2.0)
    assert rest == pytest.approx(0.0, abs=1e-12)


def test_brakes_have_a_limit() -> None:
    assert limit_braking(-50.0) == -HARDEST_MPS2
    assert limit_braking(1.0) == 1.0
