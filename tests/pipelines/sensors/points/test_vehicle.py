import numpy as np
import pytest

from fbench.pipelines.sensors.points.vehicle import VehicleSize, complete, fade, fit_rectangles, half_turn

CAR = VehicleSize(length_m=4.0, width_m=2.0, height_m=1.5)
ORIGIN = np.zeros(2)


def rectangle(heading=0.0, x=(0.0, 0.0), y=(0.0, 0.0)):
    return np.array([[heading, *x, *y, 0.0]])


@pytest.mark.parametrize(
    ("seen", "center", "size", "yaw"),
    [
        (rectangle(x=(10, 10.2), y=(1, 2.6)), (12, 2), (4, 2), 0),
        (rectangle(x=(-10.2, -10), y=(1, 2.6)), (-12, 2), (4, 2), 0),
        (rectangle(x=(10, 13.8), y=(-3, -2.9)), (12, -3.9), (4, 2), 0),
        (rectangle(x=(10, 10.2), y=(2, 5.8)), (11, 4), (4, 2), -np.pi / 2),
        (rectangle(x=(10, 11), y=(-0.8, 0.8)), (12, 0), (4, 2), 0),
        (rectangle(x=(5, 17), y=(3, 5.5)), (11, 4.25), (12, 2.5), 0),
        (rectangle(x=(20, 22), y=(2, 3.6)), (22, 3), (4, 2), 0),
        (rectangle(np.pi / 2, x=(2, 3.6), y=(-22, -20)), (22, 3), (4, 2), 0),
        (rectangle(x=(2, 3.6), y=(20, 22)), (3, 22), (4, 2), -np.pi / 2),
    ],
    ids=[
        "back",
        "back, behind",
        "side",
        "crossing",
        "straight ahead",
        "bus",
        "back and a part of the side",
        "the same, as the other heading",
        "the same, to the left",
    ],
)
def test_what_is_hidden_lies_behind_what_is_seen(seen, center, size, yaw):
    found = complete(seen, ORIGIN, CAR)
    assert found.center_m[0] == pytest.approx(center)
    assert found.size_lw_m[0] == pytest.approx(size)
    assert found.yaw_rad[0] == pytest.approx(yaw)


def test_completion_turns_with_the_scene():
    angle = 0.7
    turned = rectangle(heading=angle, x=(10, 10.2), y=(1, 2.6))
    found = complete(turned, ORIGIN, CAR)
    cos, sin = np.cos(angle), np.sin(angle)
    assert found.center_m[0] == pytest.approx([12 * cos - 2 * sin, 12 * sin + 2 * cos])
    assert found.yaw_rad[0] == pytest.approx(angle)


def test_completion_is_seen_from_the_sensor():
    found = complete(rectangle(x=(10, 10.2), y=(1, 2.6)), np.array([20.0, 10.0]), CAR)
    assert found.center_m[0] == pytest.approx([8.2, 1.6])


@pytest.mark.parametrize("degrees", [0, 20, 44, 60, 88])
def test_rectangle_around_two_sides_of_a_car(degrees):
    along = np.linspace(0, 4, 30)
    corner = np.concatenate([np.column_stack([along, 0 * along]), np.column_stack([0 * along[:15], along[:15]])])
    angle = np.radians(degrees)
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    points = corner @ rotation + [15.0, -3.0]
    found = fit_rectangles(points, np.array([0, len(points)]), np.radians(np.arange(0.0, 90.0, 2.0)), 0.05)[0]
    assert found[0] == pytest.approx(angle)
    assert found[2] - found[1] == pytest.approx(4.0)
    assert found[4] - found[3] == pytest.approx(along[14])
    assert found[5] == pytest.approx(0.0, abs=1e-9)


def test_rectangle_of_one_point():
    found = fit_rectangles(np.array([[3.0, 4.0]]), np.array([0, 1]), np.array([0.0, 0.5]), 0.05)
    assert found[0].tolist() == [0.0, 3.0, 3.0, 4.0, 4.0, 0.0]


def test_fading():
    assert fade(np.array([0.0, 1.0, 1.5, 2.0, 3.0]), 1.0, 2.0).tolist() == [1.0, 1.0, 0.5, 0.0, 0.0]
    assert fade(np.array([0.0, 1.0, 1.5, 2.0, 3.0]), 2.0, 1.0).tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]


def test_half_turn():
    assert half_turn(np.array([0.0, np.pi, -np.pi / 2, 2.0])) == pytest.approx([0, 0, -np.pi / 2, 2 - np.pi])
