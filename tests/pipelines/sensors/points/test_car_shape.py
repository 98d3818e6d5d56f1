"""How much clusters look like cars, given what is above them."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from fbench.pipelines.sensors.lidar.classification import CarShapeParams, plausibility
from fbench.replay.contracts.errors import ConfigError

PARAMS = CarShapeParams(num_over=(0.0, 1000.0))


def rectangles(num, seed=0):
    """Rectangles of a car's size, as `fit_rectangles` gives them."""
    random = np.random.default_rng(seed)
    low = random.uniform(-60, 60, (num, 2))
    columns = [random.uniform(0, np.pi / 2, num), low[:, 0], low[:, 0] + 4, low[:, 1], low[:, 1] + 1.8, np.zeros(num)]
    return np.column_stack(columns)


def scored(found, tall, params=PARAMS):
    num = len(found)
    return plausibility(found, np.full(num, 50), np.zeros(num), np.full(num, 1.5), tall, params)


def counted(found, tall, margin_m):
    """Points over each rectangle, one by one."""
    turned = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in found[:, 0]]
    over = [tall[:, :2] @ turn for turn in turned]
    low, high = found[:, [1, 3]] - margin_m, found[:, [2, 4]] + margin_m
    return np.array([((o > low[i]) & (o < high[i])).all(axis=1).sum() for i, o in enumerate(over)])


def test_points_over_clusters_as_counted_one_by_one():
    found, tall = rectangles(50), np.random.default_rng(1).uniform(-70, 70, (20_000, 3))
    expected = 1 - np.minimum(counted(found, tall, PARAMS.margin_m), 1000) / 1000
    assert expected.min() < 0.99
    assert scored(found, tall) == pytest.approx(expected)


def test_nothing_over_clusters():
    assert scored(rectangles(3), np.zeros((0, 3))).tolist() == [1.0, 1.0, 1.0]
    assert scored(rectangles(0), np.zeros((5, 3))).tolist() == []


def test_memory_does_not_grow_with_clusters_times_points():
    found, tall = rectangles(500), np.random.default_rng(1).uniform(-70, 70, (50_000, 3))
    scored(found[:1], tall)
    tracemalloc.start()
    scored(found, tall)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6


@pytest.mark.parametrize(
    ("name", "pair", "match"),
    [
        ("top_m", (2.5, 2.1), r"lidar\.shape\.top_m: expected a second value above the first, got 2\.5,2\.1"),
        ("top_m", (2.0, 2.0), r"lidar\.shape\.top_m: expected a second value above the first, got 2,2"),
        ("num_points", (4.0, 10.0), r"lidar\.shape\.num_points: expected a second value below the first, got 4,10"),
        ("filling_m", (-1.0, 1.0), r"lidar\.shape\.filling_m: expected at least 0, got -1"),
        ("num_over", (0.0, np.inf), r"lidar\.shape\.num_over: expected at most 1e\+06, got inf"),
    ],
)
def test_pairs_that_make_no_sense(name, pair, match):
    with pytest.raises(ConfigError, match=match):
        replace(PARAMS, **{name: pair})
