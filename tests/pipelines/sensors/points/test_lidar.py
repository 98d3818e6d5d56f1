import numpy as np
import pytest
from tests.pipelines.scenes import car_back, road

from fbench.pipelines.sensors.lidar.clusters import LidarParams, LidarView, detect, obstacles

EYE = np.zeros(3)


def view(*parts) -> LidarView:
    points = np.concatenate(parts)
    points = points[np.lexsort(points.T[::-1])]
    params = LidarParams()
    return detect(obstacles(points, params), EYE, params)


def test_back_of_a_car_becomes_a_whole_car():
    found = view(road(), car_back(20.0, 3.0)).boxes
    assert len(found) == 1
    assert found.center_m[0] == pytest.approx([22.1, 3.0, -0.8], abs=0.05)
    assert found.size_lwh_m[0] == pytest.approx([4.2, 1.8, 1.6])
    assert found.yaw_rad[0] == pytest.approx(0.0)
    assert found.score is not None
    assert found.score[0] == 1.0


def wall():
    y, z = (a.ravel() for a in np.meshgrid(np.arange(-12, 12, 0.2), np.arange(-1.4, 0.6, 0.4)))
    return np.column_stack([np.full(len(y), 15.0), y, z])


def pole():
    return np.column_stack([np.full(10, 12.0), np.full(10, 4.0), np.linspace(-1.4, 0.8, 10)])


def bush():
    spread = np.arange(120)[:, None] * [0.6180, 0.7549, 0.5698] % 1.0
    return np.array([13.0, -7.0, -1.4]) + 2.0 * spread * [1, 1, 0.5]


def sign():
    return car_back(18.0, -4.0, z_m=-1.6 + 1.2)


def facade():
    return np.concatenate([car_back(18.0, -4.0), car_back(18.0, -4.0, z_m=-1.6 + 3.0)])


@pytest.mark.parametrize("thing", [wall, pole, bush, sign, facade])
def test_other_things_are_no_cars(thing):
    score = view(road(), thing()).boxes.score
    assert score is not None
    assert score.max() < 0.3


def test_clusters_are_rows_of_the_boxes():
    found = view(road(), car_back(20.0, 3.0), car_back(12.0, -3.0))
    assert len(found.boxes) == 2
    for number in range(2):
        middle = found.xyz[found.cluster == number].mean(axis=0)
        assert np.hypot(*(found.boxes.center_m[number] - middle)[:2]) < 2.5


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((1, 3)), np.ones((50, 3)), road()])
def test_nothing_to_find(points):
    found = view(points)
    assert len(found.boxes) == 0
    assert (found.cluster == -1).all()
