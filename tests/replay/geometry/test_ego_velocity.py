"""The speed of a radar over ground, from velocities that were computed by hand."""

import numpy as np
import pytest

from fbench.replay.geometry.ego_velocity import decide_motion, fit_ego, read_motion, wrap_velocity


def directions(azimuth_deg):
    a = np.radians(azimuth_deg)
    return np.stack([np.cos(a), np.sin(a), 0 * a], axis=1)


def test_the_speed_is_found_among_other_traffic():
    d = directions(np.linspace(-50, 50, 101))
    v = -(d @ np.array([10.0, 0.5, 0]))
    v[:40] = np.linspace(-20, 20, 40)
    fit = fit_ego(d, v, None)
    assert fit.velocity_mps == pytest.approx([10.0, 0.5], abs=0.05)
    assert 0.6 <= fit.share < 0.7
    assert fit.radial_mps(np.array([0.0, np.pi / 2])) == pytest.approx([-10.0, -0.5], abs=0.05)


def test_a_rear_radar_sees_what_it_leaves():
    d = directions(np.linspace(140, 220, 81))
    assert fit_ego(d, -(d @ np.array([8.0, 0, 0])), None).velocity_mps[0] == pytest.approx(8.0, abs=0.05)


def test_too_few_points_fit_nothing():
    assert fit_ego(directions(np.zeros(7)), np.ones(7), None) is None
    assert fit_ego(directions(np.zeros(20)), np.full(20, np.nan), None) is None


def test_velocities_wrap_at_half_a_period():
    assert wrap_velocity(np.array([4.0, 6.0, -6.0]), 10.0).tolist() == [4.0, -4.0, 4.0]
    assert wrap_velocity(np.array([6.0]), None).tolist() == [6.0]


def test_a_corner_radar_in_a_bend_moves_sideways_too():
    d = directions(np.linspace(20, 110, 91))
    fit = fit_ego(d, -(d @ np.array([7.0, 1.2, 0])), None)
    assert fit.velocity_mps == pytest.approx([7.0, 1.2], abs=0.05)
    assert fit.share == 1.0


def test_the_order_of_points_changes_nothing():
    rng = np.random.default_rng(3)
    d = directions(rng.uniform(-60, 60, 80))
    v = -(d @ np.array([12.0, 0, 0])) + rng.normal(0, 0.1, 80)
    order = rng.permutation(80)
    assert fit_ego(d[order], v[order], None).velocity_mps == pytest.approx(fit_ego(d, v, None).velocity_mps, abs=1e-9)


@pytest.mark.parametrize(
    ("speed_mps", "is_moving", "shown"),
    [(9.0, False, "included"), (-9.0, True, "included"), (0.0, True, "removed"), (0.0, False, "still"),
     (1.0, True, "unknown")],
)  # fmt: skip
def test_a_scan_shows_how_the_vehicle_moves(speed_mps, is_moving, shown):
    d = directions(np.linspace(-50, 50, 101))
    assert read_motion(fit_ego(d, -(d @ np.array([speed_mps, 0, 0])), None), is_moving) == shown


@pytest.mark.parametrize(
    ("counts", "motion"),
    [
        ({"unknown": 47, "included": 1}, "unknown"),
        ({"unknown": 47, "removed": 1}, "unknown"),
        ({"still": 47, "included": 1}, "still"),
        ({"unknown": 20, "included": 28}, "included"),
        ({"included": 2}, "unknown"),  # too few
        ({"included": 3}, "included"),
        ({"included": 30, "removed": 18}, "unknown"),  # no clear majority
        ({"removed": 30, "included": 7}, "removed"),
        ({"still": 38, "included": 10}, "included"),  # a long red light says nothing
    ],
)
def test_a_radar_is_decided_about_by_a_clear_majority(counts, motion):
    assert decide_motion([shown for shown, num in counts.items() for _ in range(num)]) == motion
