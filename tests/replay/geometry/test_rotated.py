import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.replay.geometry.box_pairs import degenerate, ordinary, shapely_iou_bev

from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.iou import flat_iou, iou_bev, upright


def box(x: float, y: float, length: float, width: float, yaw: float, z: float = 0.0, height: float = 1.0) -> Boxes3D:
    return Boxes3D(np.array([[x, y, z]]), np.array([[length, width, height]]), np.array([yaw]))


def of_pairs(a: Float64, b: Float64, solid: bool = False) -> Float64:
    each = np.arange(len(a) + 1)
    return flat_iou(a, b, each, each, solid)


def iou_3d(a: Boxes3D, b: Boxes3D) -> Float64:
    starts = (np.array([0, len(boxes)], np.int64) for boxes in (a, b))
    return flat_iou(upright(a), upright(b), next(starts), next(starts), solid=True).reshape(len(a), len(b))


def test_hand_values_from_above() -> None:
    unit = box(0, 0, 1, 1, 0)
    assert iou_bev(unit, unit).tolist() == [[1.0]]
    np.testing.assert_allclose(iou_bev(unit, box(0.5, 0, 1, 1, 0)), [[1 / 3]])
    assert iou_bev(unit, box(1, 0, 1, 1, 0)).tolist() == [[0.0]]
    assert iou_bev(unit, box(5, 0, 1, 1, 0)).tolist() == [[0.0]]
    # A unit square and itself turned by 45 degrees share a regular octagon of area 2 (sqrt 2 - 1).
    octagon = 2 * (np.sqrt(2) - 1)
    np.testing.assert_allclose(iou_bev(unit, box(0, 0, 1, 1, np.pi / 4)), [[octagon / (2 - octagon)]])
    # A cross of two 4 x 2 boxes shares a 2 x 2 square.
    np.testing.assert_allclose(iou_bev(box(0, 0, 4, 2, 0), box(0, 0, 4, 2, np.pi / 2)), [[4 / 12]])


def test_hand_values_in_space() -> None:
    cube = box(0, 0, 2, 2, 0.3, height=2)
    assert iou_3d(cube, cube).tolist() == [[1.0]]
    np.testing.assert_allclose(iou_3d(cube, box(0, 0, 2, 2, 0.3, z=1, height=2)), [[1 / 3]])
    np.testing.assert_allclose(iou_3d(cube, box(0, 0, 2, 2, 0.3, z=0.5, height=1)), [[1 / 2]])
    assert iou_3d(cube, box(0, 0, 2, 2, 0.3, z=2, height=2)).tolist() == [[0.0]]
    assert iou_3d(cube, box(0, 0, 2, 2, 0.3, z=9, height=2)).tolist() == [[0.0]]
    # 4 x 2 x 1 crossed with 4 x 2 x 3 at the same ground: 2 x 2 x 1 of 8 + 24 - 4.
    np.testing.assert_allclose(
        iou_3d(box(0, 0, 4, 2, 0, z=0.5), box(0, 0, 4, 2, np.pi / 2, z=1.5, height=3)), [[4 / 28]]
    )


def test_heading_turns_length_towards_y() -> None:
    assert iou_bev(box(0, 0, 4, 1, np.pi / 2), box(0, 1.9, 0.1, 0.1, 0))[0, 0] > 0
    assert iou_bev(box(0, 0, 4, 1, np.pi / 2), box(1.9, 0, 0.1, 0.1, 0))[0, 0] == 0


def test_shapes_and_boxes_without_area() -> None:
    assert iou_bev(Boxes3D.empty(), box(0, 0, 1, 1, 0)).shape == (0, 1)
    assert iou_3d(box(0, 0, 1, 1, 0), Boxes3D.empty()).shape == (1, 0)
    assert iou_bev(box(0, 0, 0, 0, 0), box(0, 0, 0, 0, 0)).tolist() == [[0.0]]
    assert iou_3d(box(0, 0, 1, 1, 0, height=0), box(0, 0, 1, 1, 0, height=0)).tolist() == [[0.0]]
    assert iou_bev(box(0, 0, 1, 1, 0, height=0), box(0, 0, 1, 1, 0, height=0)).tolist() == [[1.0]]


@pytest.mark.parametrize("iou", [iou_bev, iou_3d])
@pytest.mark.parametrize("bad", [box(np.nan, 0, 1, 1, 0), box(0, np.inf, 1, 1, 0), box(0, 0, -1, 1, 0),
                                 box(0, 0, -1, -1, 0), box(0, 0, 1, 1, np.nan), box(1e10, 0, 1, 1, 0)])  # fmt: skip
def test_what_is_no_box_is_like_nothing(iou, bad: Boxes3D) -> None:
    unit = box(0, 0, 1, 1, 0)
    assert iou(bad, unit).tolist() == iou(unit, bad).tolist() == iou(bad, bad).tolist() == [[-np.inf]]


@pytest.mark.slow
def test_shapely_agrees_on_ordinary_pairs() -> None:
    a, b = ordinary(50_000, 1)
    ours = of_pairs(a, b)
    assert (ours > 0).mean() > 0.3
    np.testing.assert_allclose(ours, shapely_iou_bev(a, b), rtol=0, atol=1e-12)


KINDS = degenerate(2_800, 2)


@pytest.mark.parametrize("kind", KINDS)
def test_shapely_agrees_on_degenerate_pairs(kind: str) -> None:
    a, b = KINDS[kind]
    ours = of_pairs(a, b)
    np.testing.assert_allclose(ours, shapely_iou_bev(a, b, grid_m=1e-13), rtol=0, atol=1e-9)
    assert ((ours >= 0) & (ours <= 1)).all()
    assert np.array_equal(of_pairs(b, a), ours)


def test_a_box_is_exactly_itself() -> None:
    a, _ = ordinary(20_000, 3)
    a[::2, :2] += 1e6
    for solid in (False, True):
        assert (of_pairs(a, a, solid) == 1).all()


def test_moving_both_changes_nothing() -> None:
    a, b = ordinary(20_000, 4)
    before = of_pairs(a, b, solid=True)
    rng = np.random.Generator(np.random.PCG64(5))
    turn, shift = rng.uniform(-4, 4, len(a)), rng.uniform(-1e3, 1e3, (len(a), 3))
    after = of_pairs(moved(a, turn, shift), moved(b, turn, shift), solid=True)
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-11)


def moved(boxes: Float64, turn: Float64, shift: Float64) -> Float64:
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = cos * boxes[:, 0] - sin * boxes[:, 1], sin * boxes[:, 0] + cos * boxes[:, 1]
    center = np.column_stack([x, y, boxes[:, 2]]) + shift
    return np.column_stack([center, boxes[:, 3:6], boxes[:, 6] + turn])


def test_a_pair_gives_the_same_bits_whatever_stands_beside_it() -> None:
    a, b = ordinary(60, 6)
    whole = flat_iou(a, b, np.array([0, 60]), np.array([0, 60]), True).reshape(60, 60)
    single = of_pairs(np.repeat(a, 60, axis=0), np.tile(b, (60, 1)), True).reshape(60, 60)
    assert np.array_equal(whole, single)


def test_steps_are_apart() -> None:
    a, b = ordinary(5, 7)
    flat = flat_iou(a, b, np.array([0, 2, 2, 5]), np.array([0, 1, 3, 5]), False)
    assert np.array_equal(flat, np.concatenate([
        flat_iou(a[:2], b[:1], np.array([0, 2]), np.array([0, 1]), False),
        flat_iou(a[2:], b[3:], np.array([0, 3]), np.array([0, 2]), False),
    ]))  # fmt: skip


shapes = st.tuples(*[st.floats(-2, 2)] * 2, *[st.floats(0.5, 6)] * 2, st.floats(-4, 4))


@given(shapes, shapes)
def test_in_space_is_from_above_where_heights_agree(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    np.testing.assert_allclose(iou_3d(box(*a), box(*b)), iou_bev(box(*a), box(*b)), atol=1e-12)


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
