"""CFAR against the plain computation, cell by cell."""

import numpy as np
import pytest

from fbench.datasets.radiate.radar import CfarParams, clutter, detect
from fbench.replay.contracts.errors import ConfigError


def plain_mean(column: np.ndarray, cell: int, guard: int, training: int) -> float:
    near = range(cell - guard - training, cell - guard)
    far = range(cell + guard + 1, cell + guard + 1 + training)
    values = [float(column[i]) for i in (*near, *far) if 0 <= i < len(column)]
    return sum(values) / len(values) if values else np.inf


@pytest.mark.parametrize(("guard", "training"), [(0, 1), (2, 3), (15, 20), (40, 5), (100, 7)])
def test_clutter_is_the_mean_of_the_training_cells(guard: int, training: int) -> None:
    power = np.random.default_rng(1).integers(0, 256, (60, 4)).astype(np.uint8)
    expected = [[plain_mean(power[:, a], r, guard, training) for a in range(4)] for r in range(60)]
    assert np.allclose(clutter(power, guard, training), expected)


def test_targets_are_what_exceeds_the_mean_by_the_threshold() -> None:
    power = np.random.default_rng(2).integers(0, 100, (80, 5)).astype(np.uint8)
    params = CfarParams(guard=2, training=4, threshold=30.0, min_range_m=4.5, peak_only=False)
    rows, columns = detect(power, 0.5, params)
    expected = [(r, a) for a in range(5) for r in range(9, 80) if power[r, a] - plain_mean(power[:, a], r, 2, 4) > 30]
    assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == expected


def test_of_a_plateau_the_nearest_cell_is_the_peak() -> None:
    power = np.zeros((50, 1), np.uint8)
    power[20:24, 0] = [50, 90, 90, 60]
    rows, _ = detect(power, 1.0, CfarParams(guard=5, training=5))
    assert rows.tolist() == [21]


def test_the_strongest_are_kept_in_order() -> None:
    power = np.zeros((100, 3), np.uint8)
    power[50, :] = [60, 200, 100]
    rows, columns = detect(power, 1.0, CfarParams(max_points=2))
    assert (rows.tolist(), columns.tolist()) == ([50, 50], [1, 2])


def test_clutter_that_grows_is_followed() -> None:
    power = (np.arange(200)[:, None] * np.ones((1, 2))).astype(np.uint8)
    assert not len(detect(power, 1.0, CfarParams(peak_only=False))[0])


@pytest.mark.parametrize(
    "params",
    [
        {"guard": -1}, {"training": 0}, {"training": 10**9}, {"max_points": -1}, {"threshold": float("inf")},
        {"min_range_m": -1.0},
    ],
)  # fmt: skip
def test_parameters_are_checked(params: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(params))):
        CfarParams(**params)  # type: ignore[arg-type]
