"""Compiled steps of the trackers against the same formulas on whole arrays: equal to the last bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.pipelines.tracking.kalman import PLACE, predict, update
from fbench.pipelines.tracking.kernels import as_corners, as_measured

LEAST = 1e-3


def random_states(rng: np.random.Generator, num: int, size: int) -> np.ndarray:
    values = rng.normal(0, 50, (5, num, size)) * 10.0 ** rng.integers(-6, 7, (5, num, size))
    values[[2, 4]] = np.abs(values[[2, 4]]) + 1e-9
    return values


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1), num=st.integers(0, 9), size=st.integers(1, 4), dt_s=st.floats(1e-9, 100.0),
    each=st.booleans(),
)  # fmt: skip
def test_both_steps_are_the_closed_forms(seed: int, num: int, size: int, dt_s: float, each: bool) -> None:
    rng = np.random.Generator(np.random.Philox(seed))
    states, z = random_states(rng, num, size), rng.normal(0, 50, (num, size))
    drift, std = rng.uniform(0, 9, (2, num, size) if each else (2, size))

    place, rate, var, shared, rate_var = states
    q = drift**2
    expected = [
        place + dt_s * rate, rate, var + dt_s * shared + dt_s * shared + dt_s * rate_var * dt_s + q * dt_s**3 / 3,
        shared + dt_s * rate_var + q * dt_s**2 / 2, rate_var + q * dt_s,
    ]  # fmt: skip
    np.testing.assert_array_equal(predict(states, dt_s, drift), np.array(expected))

    weight = 1 / (var + std**2)
    gain, rate_gain = var * weight, shared * weight
    between = (shared - gain * shared + (shared - rate_gain * var)) / 2
    expected = [
        place + gain * (z - place), rate + rate_gain * (z - place), var - gain * var, between,
        rate_var - rate_gain * shared,
    ]  # fmt: skip
    np.testing.assert_array_equal(update(states, z, std), np.array(expected))


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), num=st.integers(0, 9))
def test_what_is_filtered_of_rectangles(seed: int, num: int) -> None:
    rng = np.random.Generator(np.random.Philox(seed))
    low, side = rng.uniform(-500, 1500, (num, 2)), rng.uniform(0, 300, (num, 2)) * rng.integers(0, 2, (num, 2))
    xyxy = np.concatenate([low, low + side], axis=1)
    across, down = np.maximum(xyxy[:, 2:] - xyxy[:, :2], LEAST).T
    middle = (xyxy[:, :2] + xyxy[:, 2:]) / 2
    np.testing.assert_array_equal(as_measured(xyxy, LEAST), np.column_stack([middle, across * down, across / down]))
    x, y, area, aspect = z = np.concatenate([rng.normal(0, 500, (2, num)), rng.uniform(1e-3, 1e6, (2, num))])
    half, up = np.sqrt(area * aspect) / 2, np.sqrt(area / aspect) / 2
    np.testing.assert_array_equal(as_corners(z.T.copy()), np.column_stack([x - half, y - up, x + half, y + up]))


def test_rectangles_go_there_and_back() -> None:
    xyxy = np.array([[10.0, 20.0, 50.0, 30.0], [0.0, 0.0, 1.0, 7.0]])
    assert as_measured(xyxy, LEAST).tolist() == [[30.0, 25.0, 400.0, 4.0], [0.5, 3.5, 7.0, 1 / 7]]
    np.testing.assert_allclose(as_corners(as_measured(xyxy, LEAST)), xyxy, atol=1e-12)


@pytest.mark.parametrize("at", range(4))
def test_what_is_not_a_number_stays_so_and_leaves_others_alone(at: int) -> None:
    xyxy = np.tile([10.0, 20.0, 50.0, 30.0], (2, 1))
    xyxy[0, at] = np.nan
    measured = as_measured(xyxy, LEAST)
    assert np.isnan(measured[0, 2:]).all()
    got = as_corners(measured)
    assert np.isnan(got[0]).all()
    np.testing.assert_allclose(got[1], xyxy[1])


def test_nothing_to_divide_by_is_no_error() -> None:
    """A state and a measurement that are both exact, and a box without aspect ratio."""
    exact = np.zeros((5, 1, 1))
    assert np.isnan(update(exact, np.ones((1, 1)), np.zeros(1))[PLACE]).all()
    assert not np.isfinite(as_corners(np.array([[1.0, 1.0, 4.0, 0.0]]))[0, [1, 3]]).any()
