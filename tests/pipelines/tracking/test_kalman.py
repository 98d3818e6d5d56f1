import numpy as np
import pytest

from fbench.pipelines.tracking.kalman import (
    COVARIANCE,
    PLACE,
    PLACE_VAR,
    RATE,
    RATE_VAR,
    begin,
    begin_identity,
    predict,
    predict_identity,
    update,
)


def test_prediction_moves_by_rate_times_time_and_grows_uncertain() -> None:
    states = begin(np.array([[1.0, 2.0]]), np.array([[3.0, -1.0]]), np.full(2, 0.5), np.full(2, 2.0))
    later = predict(states, 0.5, np.full(2, 4.0))
    assert (later[PLACE].tolist(), later[RATE].tolist()) == ([[2.5, 1.5]], [[3.0, -1.0]])
    # P = F P F' + Q: 0.5^2 + 0.5^2 2^2 + 4^2 0.5^3 / 3;  0.5 2^2 + 4^2 0.5^2 / 2;  2^2 + 4^2 0.5.
    first = later[[PLACE_VAR, COVARIANCE, RATE_VAR], 0, 0]
    np.testing.assert_allclose(first, [0.25 + 1 + 2 / 3, 2 + 2, 4 + 8])


def test_scalar_update_by_hand() -> None:
    states = begin(np.array([[0.0]]), np.array([[0.0]]), np.array([2.0]), np.array([1.0]))
    got = update(states, np.array([[10.0]]), np.array([1.0]))
    # Gain 4 / (4 + 1).
    np.testing.assert_allclose(got[:, 0, 0], [8.0, 0.0, 0.8, 0.0, 1.0])


def test_a_larger_measurement_noise_trusts_measurements_less() -> None:
    states = begin(np.zeros((2, 1)), np.zeros((2, 1)), np.ones(1), np.ones(1))
    got = update(states, np.ones((2, 1)), np.array([[0.1], [10.0]]))
    assert got[PLACE][0, 0] > 0.9
    assert got[PLACE][1, 0] < 0.1


def test_blocks_are_those_of_the_whole_matrices() -> None:
    """Predict and update with F, Q, H and P as matrices, for one track at a time."""
    rng = np.random.Generator(np.random.Philox(3))
    for _ in range(300):
        num = int(rng.integers(1, 5))
        place, rate, z = rng.normal(0, 50, (3, 1, num))
        std, rate_std, drift, later_std = rng.uniform(0.1, 9, (4, num))
        dt = float(rng.uniform(0.02, 2))
        states = update(predict(begin(place, rate, std, rate_std), dt, drift), z, later_std)
        F, H = np.eye(2 * num), np.eye(num, 2 * num)
        F[:num, num:] = dt * np.eye(num)
        q = np.diag(drift**2)
        Q = np.block([[q * dt**3 / 3, q * dt**2 / 2], [q * dt**2 / 2, q * dt]])
        mean = F @ np.concatenate([place[0], rate[0]])
        P = F @ np.diag(np.concatenate([std, rate_std]) ** 2) @ F.T + Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(later_std**2))
        mean, P = mean + K @ (z[0] - H @ mean), (np.eye(2 * num) - K @ H) @ P
        np.testing.assert_allclose(np.concatenate([states[PLACE][0], states[RATE][0]]), mean, rtol=1e-9, atol=1e-9)
        i = np.arange(num)
        blocks = np.array([P[i, i], P[i, i + num], P[i + num, i + num]])
        np.testing.assert_allclose(states[PLACE_VAR:, 0], blocks, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("dt", [0.05, 1.0])
def test_the_filter_is_the_least_squares_line_when_nothing_drifts(dt: float) -> None:
    generator = np.random.Generator(np.random.Philox(7))
    times = np.arange(6) * dt
    measured = 3 + 2 * times + generator.normal(0, 0.1, 6)
    states = begin(measured[:1, None], np.zeros((1, 1)), np.array([0.1]), np.array([1e5]))
    for value in measured[1:]:
        states = update(predict(states, dt, np.zeros(1)), np.array([[value]]), np.array([0.1]))
    slope, offset = np.polyfit(times, measured, 1)
    np.testing.assert_allclose(
        [states[PLACE][0, 0], states[RATE][0, 0]], [offset + slope * times[-1], slope], rtol=1e-4
    )


def test_no_tracks() -> None:
    empty = np.zeros((0, 3))
    states = begin(empty, empty, np.ones(3), np.ones(3))
    assert update(predict(states, 0.1, np.ones(3)), empty, np.ones(3)).shape == (5, 0, 3)


def test_scaled_identities_are_those_of_the_whole_matrices() -> None:
    """The thesis's P, Q and R, with F, H and P as matrices: P = 10 I, but 1000 for rates, Q = 0.1 I, R = I."""
    F, H = np.array([[1, 0.1], [0, 1]]), np.array([[1.0, 0]])
    states = begin_identity(np.array([[3.0]]), np.zeros((1, 1)), 10.0, 1000.0)
    x, P = np.array([3.0, 0]), np.diag([10.0, 1000.0])
    for z in (3.4, 3.9, 4.3):
        states = update(predict_identity(states, 0.1, 0.1), np.array([[z]]), np.ones(1))
        x, P = F @ x, F @ P @ F.T + 0.1 * np.eye(2)
        K = P @ H.T / (H @ P @ H.T + 1.0)
        x, P = x + K[:, 0] * (z - x[0]), (np.eye(2) - K @ H) @ P
    np.testing.assert_allclose(states[:, 0, 0], [*x, P[0, 0], P[0, 1], P[1, 1]], rtol=1e-9)
