import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.replay.boxes import Boxes3D
from fbench.replay.geometry.rotated import footprints, iou_bev


def box(x: float, y: float, length: float, width: float, yaw: float) -> Boxes3D:
    return Boxes3D(np.array([[x, y, 0.0]]), np.array([[length, width, 1.0]]), np.array([yaw]))


def test_hand_values() -> None:
    unit = box(0, 0, 1, 1, 0)
    assert iou_bev(unit, unit).tolist() == [[1.0]]
    np.testing.assert_allclose(iou_bev(unit, box(0.5, 0, 1, 1, 0)), [[1 / 3]])
    assert iou_bev(unit, box(1, 0, 1, 1, 0))[0, 0] == pytest.approx(0, abs=1e-12)
    assert iou_bev(unit, box(5, 0, 1, 1, 0)).tolist() == [[0.0]]
    # A unit square and itself turned by 45 degrees share a regular octagon of area 2 (sqrt 2 - 1).
    octagon = 2 * (np.sqrt(2) - 1)
    np.testing.assert_allclose(iou_bev(unit, box(0, 0, 1, 1, np.pi / 4)), [[octagon / (2 - octagon)]])
    # A cross of two 4 x 2 boxes shares a 2 x 2 square.
    np.testing.assert_allclose(iou_bev(box(0, 0, 4, 2, 0), box(0, 0, 4, 2, np.pi / 2)), [[4 / 12]])


def test_heading_turns_length_towards_y() -> None:
    corners = footprints(box(1, 2, 4, 2, np.pi / 2))[0]
    np.testing.assert_allclose(corners, [[0, 4], [0, 0], [2, 0], [2, 4]], atol=1e-12)


def test_shapes_and_boxes_without_area() -> None:
    assert iou_bev(Boxes3D.empty(), box(0, 0, 1, 1, 0)).shape == (0, 1)
    assert iou_bev(box(0, 0, 0, 0, 0), box(0, 0, 0, 0, 0)).tolist() == [[0.0]]


sizes = st.floats(0.5, 6)
shapes = st.tuples(st.floats(-2, 2), st.floats(-2, 2), sizes, sizes, st.floats(-4, 4))


@given(shapes, shapes)
def test_overlap_is_symmetric_and_moves_with_the_boxes(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    iou = iou_bev(box(*a), box(*b))[0, 0]
    assert 0 <= iou <= 1
    np.testing.assert_allclose(iou, iou_bev(box(*b), box(*a))[0, 0], atol=1e-9)
    turned_a, turned_b = (box(-y, x, length, width, yaw + np.pi / 2) for x, y, length, width, yaw in (a, b))
    np.testing.assert_allclose(iou, iou_bev(turned_a, turned_b)[0, 0], atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_against_counting_random_points(seed: int) -> None:
    generator = np.random.Generator(np.random.Philox(seed))
    low, high = np.array([-1, -1, 1, 1, -3.0]), np.array([1, 1, 5, 5, 3.0])
    a, b = (box(*generator.uniform(low, high).tolist()) for _ in range(2))
    points = generator.uniform(-5, 5, (200_000, 2))
    in_a, in_b = _inside(a, points), _inside(b, points)
    np.testing.assert_allclose(iou_bev(a, b)[0, 0], (in_a & in_b).sum() / (in_a | in_b).sum(), atol=0.02)


def _inside(boxes: Boxes3D, points: np.ndarray) -> np.ndarray:
    x, y = (points - boxes.center_m[0, :2]).T
    cos, sin = np.cos(boxes.yaw_rad[0]), np.sin(boxes.yaw_rad[0])
    length, width = boxes.size_lwh_m[0, :2]
    inside: np.ndarray = (np.abs(cos * x + sin * y) <= length / 2) & (np.abs(cos * y - sin * x) <= width / 2)
    return inside
