import numpy as np
import pytest

from fbench.pipelines.sensors.lidar.classification import FEATURES, Standing, features
from fbench.pipelines.sensors.points.vehicle import fit_rectangles

HEADINGS = np.radians(np.arange(0.0, 90.0, 2.0))


def described(points, loose=(), tall=()):
    """Features of one cluster, by name; points are x, y and height."""
    rows = np.array([*loose, *points], np.float64).reshape(-1, 3)
    first = np.array([len(loose), len(rows)])
    rectangles = fit_rectangles(np.ascontiguousarray(rows[:, :2]), first, HEADINGS, 0.05)
    standing = Standing(rows, first, np.array(tall, np.float64).reshape(-1, 3))
    values = features(standing, rectangles)
    assert values.shape == (1, len(FEATURES))
    return dict(zip(FEATURES, values[0].tolist(), strict=True))


BACK = [(10.0, y, z) for y in (-0.9, 0.0, 0.9) for z in (0.4, 0.8, 1.4)]


def test_the_back_of_a_car():
    found = described(BACK)
    assert found["length_m"] == pytest.approx(1.8)
    assert found["width_m"] == pytest.approx(0.0)
    assert found["top_m"] == 1.4
    assert found["bottom_m"] == 0.4
    assert found["reach_m"] == pytest.approx(1.4 + 0.6)  # nothing seen between 0.8 and 1.4 m
    assert found["log2_points"] == pytest.approx(np.log2(9))
    assert found["upper_share"] == pytest.approx(1 / 3)
    assert found["over_share"] == 0.0
    assert found["near_share"] == 0.0


def test_the_gap_below_the_lowest_point_counts():
    assert described([(5.0, 0.0, 0.9), (5.0, 0.2, 1.0), (5.0, 0.4, 1.1)])["reach_m"] == pytest.approx(1.1 + 0.9)


def test_what_is_above_and_beside():
    found = described(BACK, loose=[(10.3, 0.0, 0.5), (10.3, 0.3, 0.5), (30.0, 0.0, 0.5)], tall=[(10.1, 0.0, 3.5)])
    assert found["top_m"] == 3.5
    assert found["over_share"] == pytest.approx(1 / 10)
    assert found["near_share"] == pytest.approx(2 / 11)
