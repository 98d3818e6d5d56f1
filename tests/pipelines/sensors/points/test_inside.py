import numpy as np
import pytest

from fbench.pipelines.sensors.lidar.classification import measure_inside


def one_by_one(rectangles, points, margin_m):
    """Number and highest third coordinate of the points in each rectangle, by comparing all with all."""
    result = []
    for heading, low_u, high_u, low_v, high_v in rectangles[:, :5]:
        u = points[:, 0] * np.cos(heading) + points[:, 1] * np.sin(heading)
        v = points[:, 1] * np.cos(heading) - points[:, 0] * np.sin(heading)
        own = (u > low_u - margin_m) & (u < high_u + margin_m) & (v > low_v - margin_m) & (v < high_v + margin_m)
        result.append((own.sum(), points[own, 2].max(initial=-np.inf)))
    return np.array(result, np.float64).reshape(-1, 2)


@pytest.mark.parametrize("margin_m", [0.0, 0.6])
def test_points_in_rectangles_as_found_one_by_one(margin_m):
    random = np.random.default_rng(0)
    low = random.uniform(-40, 40, (60, 2))
    rectangles = np.column_stack([random.uniform(0, np.pi / 2, 60), low[:, 0], low[:, 0] + 4, low[:, 1], low[:, 1] + 2])
    points = random.uniform(-50, 50, (5000, 3))
    expected = one_by_one(rectangles, points, margin_m)
    assert expected[:, 0].max() > 3
    np.testing.assert_array_equal(measure_inside(points, rectangles, margin_m), expected)
    shuffled = measure_inside(points[random.permutation(5000)], rectangles, margin_m)
    np.testing.assert_array_equal(shuffled, expected)


def test_nothing_inside():
    rectangle = np.array([[0.0, 1.0, 2.0, 1.0, 2.0]])
    assert measure_inside(np.zeros((0, 3)), rectangle, 0.0).tolist() == [[0.0, -np.inf]]
    assert measure_inside(np.zeros((4, 3)), rectangle[:0], 0.0).shape == (0, 2)
