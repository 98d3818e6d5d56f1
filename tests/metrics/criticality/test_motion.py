"""Motion out of places: parabolas against numpy's, jitter of labels, and where there is too little for a parabola."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.metrics.criticality.conflict import find_conflicts
from fbench.metrics.criticality.motion import (
    FIT_S,
    MAX_GAP_S,
    Complex,
    differentiate,
    fit_motion,
    follow_ego,
    move_ego,
    move_objects,
)
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.metadata import Outline
from fbench.replay.data.sequences import Objects, Steps

NUM, STEP_NS = 80, 100_000_000
TIME_S = np.arange(NUM) * 0.1
ONE = np.zeros(NUM, np.int64)
STEPS = Steps(np.arange(NUM), np.arange(NUM, dtype=np.int64) * STEP_NS, ONE)


def follow(places: Complex, velocity_mps: Float64 | None = None) -> Objects:
    """A car at these places (N,), one a step, with velocities (N, 3) where it has them."""
    center = np.column_stack([places.real, places.imag, np.zeros(NUM)])
    return Objects(
        step=np.arange(NUM), label=np.full(NUM, "car"), track_id=np.ones(NUM, np.int64), score=np.ones(NUM),
        center_m=center, size_lwh_m=np.tile([4.0, 2.0, 1.5], (NUM, 1)), yaw_rad=np.zeros(NUM),
        velocity_mps=velocity_mps,
    )  # fmt: skip


def test_parabolas_are_followed_exactly() -> None:
    places = 10 * TIME_S + 0.75 * TIME_S**2 + 1j * (3 - 0.3 * TIME_S)
    velocity, acceleration = fit_motion(places, TIME_S, ONE)
    np.testing.assert_allclose(velocity, 10 + 1.5 * TIME_S - 0.3j, atol=1e-9)
    np.testing.assert_allclose(acceleration, 1.5, atol=1e-9)


def fit_by_numpy(places: Complex, time_s: Float64, stretch: Int64, k: int) -> tuple[complex, complex]:
    """The same by numpy's polynomials, of the rows of one stretch without gaps."""
    own = stretch == stretch[k]
    low, high = time_s[own][[0, -1]]
    half = min(FIT_S, high - low) / 2
    own &= np.abs(time_s - np.clip(time_s[k], low + half, high - half)) <= half + 1e-9
    x, y = (np.polynomial.Polynomial.fit(time_s[own] - time_s[k], part[own], 2) for part in (places.real, places.imag))
    return complex(x.deriv()(0), y.deriv()(0)), complex(x.deriv(2)(0), y.deriv(2)(0))


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.sampled_from([0.02, 0.1, 0.25, 0.5]))
def test_as_numpy_fits(seed: int, step_s: float) -> None:
    random = np.random.default_rng(seed)
    time_s = np.cumsum(random.uniform(0.5, 1.0, 30) * step_s)
    stretch = np.repeat([3, 5], 15)
    places = random.normal(0, 20, 30) + 1j * random.normal(0, 20, 30)
    velocity, acceleration = fit_motion(places, time_s, stretch)
    for k in range(30):
        v, a = fit_by_numpy(places, time_s, stretch, k)
        assert velocity[k] == pytest.approx(v, rel=1e-6, abs=1e-6)
        assert acceleration[k] == pytest.approx(a, rel=1e-6, abs=1e-6)


def test_of_few_places_differences() -> None:
    time_s = np.array([0.0, 0.1, 0.0, 0.0, MAX_GAP_S, 2 * MAX_GAP_S, 2 * MAX_GAP_S + 1.01, 7, 7.1, 7.2])
    stretch = np.array([0, 0, 1, 2, 2, 2, 2, 2, 2, 2])
    places = np.array([0, 1, 5, 0, 3, 8, 9, 20, np.nan, 24]).astype(complex)
    velocity, acceleration = fit_motion(places, time_s, stretch)
    slope = differentiate(places, time_s, stretch)
    np.testing.assert_array_equal(velocity, slope)
    np.testing.assert_array_equal(acceleration, differentiate(slope, time_s, stretch))
    np.testing.assert_allclose(velocity[:2].real, [10, 10])
    assert np.isnan(velocity[[2, 6, 8]]).all()  # Alone, behind a gap, unknown
    velocity, acceleration = fit_motion(np.zeros(0, complex), np.zeros(0), np.zeros(0, np.int64))
    assert velocity.shape == acceleration.shape == (0,)


def test_places_of_equal_times_have_no_parabola() -> None:
    velocity, acceleration = fit_motion(np.array([0, 1, 2j]), np.zeros(3), np.zeros(3, np.int64))
    assert np.isnan(velocity).all()
    assert np.isnan(acceleration).all()


@pytest.mark.parametrize(("ahead_m", "aside_m", "speed_mps"), [(15.0, 0.0, 10.0), (60.0, 3.5, 0.0)])
def test_jitter_of_labels_is_neither_braking_nor_conflict(ahead_m: float, aside_m: float, speed_mps: float) -> None:
    """A car that drives ahead as fast as the ego, and one that is parked beside its lane: labels are off by 5 cm."""
    random = np.random.default_rng(0)
    ego = follow_ego(STEPS.frame, STEPS.stream, STEPS.stamp_ns, np.array([[10 * t, 0, 0, 0, 0, 0, 1] for t in TIME_S]))
    jitter = random.normal(0, 0.05, NUM) + 1j * random.normal(0, 0.05, NUM)
    objects = follow(complex(ahead_m, aside_m) + (speed_mps - 10) * TIME_S + jitter)
    motion = move_objects(objects, STEPS, ego)
    np.testing.assert_allclose(motion.speed_mps, speed_mps, atol=0.5)
    assert np.abs(motion.acceleration_mps2).max() < 2
    conflicts = find_conflicts(move_ego(ego, STEPS), Outline(3.7, 1.0, 0.9), motion, np.tile([4.0, 2.0], (NUM, 1)))
    assert not conflicts.critical.any()


def test_velocities_that_boxes_have_are_kept() -> None:
    ego = follow_ego(STEPS.frame, STEPS.stream, STEPS.stamp_ns, np.tile([0, 0, 0, 0, 0, 0, 1.0], (NUM, 1)))
    velocity = np.full((NUM, 3), np.nan)
    velocity[1::2] = 7, 0, 0
    motion = move_objects(follow(TIME_S.astype(complex) ** 2, velocity), STEPS, ego)
    np.testing.assert_allclose(motion.speed_mps[1::2], 7)
    np.testing.assert_allclose(motion.speed_mps[0::2], 2 * TIME_S[0::2], atol=1e-9)
    np.testing.assert_allclose(motion.acceleration_mps2[4::2], 2, atol=1e-9)
