import numpy as np
import pytest

from fbench.pipelines.tracking.kalman import begin, predict, update


def test_prediction_moves_by_rate_times_time_and_grows_uncertain() -> None:
    states = begin(np.array([[1.0, 2.0]]), np.array([[3.0, -1.0]]), np.full(2, 0.5), np.full(2, 2.0))
    later = predict(states, 0.5, np.full(2, 4.0))
    assert later.mean.tolist() == [[2.5, 1.5, 3.0, -1.0]]
    # P = F P F' + Q: 0.5^2 + 0.5^2 2^2 + 4^2 0.5^3 / 3;  0.5 2^2 + 4^2 0.5^2 / 2;  2^2 + 4^2 0.5.
    np.testing.assert_allclose(later.cov[0, 0, [0, 2]], [0.25 + 1 + 2 / 3, 2 + 2])
    np.testing.assert_allclose(later.cov[0, 2, [0, 2]], [4, 12])
    assert later.cov[0, 0, 1] == 0


def test_scalar_update_by_hand() -> None:
    states = begin(np.array([[0.0]]), np.array([[0.0]]), np.array([2.0]), np.array([1.0]))
    got = update(states, np.array([[10.0]]), np.array([1.0]))
    # Gain 4 / (4 + 1).
    np.testing.assert_allclose(got.mean, [[8.0, 0.0]])
    np.testing.assert_allclose(got.cov[0, 0, 0], 0.8)


def test_a_larger_measurement_noise_trusts_measurements_less() -> None:
    states = begin(np.zeros((2, 1)), np.zeros((2, 1)), np.ones(1), np.ones(1))
    got = update(states, np.ones((2, 1)), np.array([[0.1], [10.0]]))
    assert got.mean[0, 0] > 0.9
    assert got.mean[1, 0] < 0.1


def test_components_without_rates_stay() -> None:
    states = begin(np.array([[1.0, 7.0]]), np.array([[2.0]]), np.ones(2), np.ones(1))
    assert predict(states, 1.0, np.ones(1)).mean.tolist() == [[3.0, 7.0, 2.0]]


@pytest.mark.parametrize("dt", [0.05, 1.0])
def test_the_filter_is_the_least_squares_line_when_nothing_drifts(dt: float) -> None:
    generator = np.random.Generator(np.random.Philox(7))
    times = np.arange(6) * dt
    measured = 3 + 2 * times + generator.normal(0, 0.1, 6)
    states = begin(measured[:1, None], np.zeros((1, 1)), np.array([0.1]), np.array([1e5]))
    for value in measured[1:]:
        states = update(predict(states, dt, np.zeros(1)), np.array([[value]]), np.array([0.1]))
    slope, offset = np.polyfit(times, measured, 1)
    np.testing.assert_allclose(states.mean[0], [offset + slope * times[-1], slope], rtol=1e-4)


def test_no_tracks() -> None:
    empty = np.zeros((0, 3))
    states = begin(empty, empty, np.ones(3), np.ones(3))
    assert len(update(predict(states, 0.1, np.ones(3)), empty, np.ones(3))) == 0
