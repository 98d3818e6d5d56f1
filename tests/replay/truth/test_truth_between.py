"""Boxes between two instants, worked out by hand."""

import numpy as np
import pytest

from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.truth.times import interpolate, move_to_body


def solid(ids, x, yaw=None, **columns):
    num = len(ids)
    center = np.column_stack([np.array(x, float), np.zeros(num), np.full(num, 0.5)])
    size = columns.pop("size", np.full((num, 3), 2.0))
    return Boxes3D(
        center, size, np.zeros(num) if yaw is None else np.array(yaw, float), track_id=np.array(ids), **columns
    )


def flat(ids, left, **columns):
    xyxy = np.array([[x, 0.0, x + 10, 20] for x in left], float).reshape(-1, 4)
    return Boxes2D(np.full(len(ids), "left"), xyxy, track_id=np.array(ids), **columns)


def test_places_sizes_and_velocities_are_linear():
    a = solid([7], [10.0], size=np.array([[4.0, 2, 1]]), velocity_mps=np.array([[8.0, 0, 0]]))
    b = solid([7], [14.0], size=np.array([[5.0, 2, 2]]), velocity_mps=np.array([[4.0, 2, 0]]))
    boxes, is_moved = interpolate(a, b, 0.25)
    assert is_moved.tolist() == [True]
    assert boxes.center_m.tolist() == [[11.0, 0, 0.5]]
    assert boxes.size_lwh_m.tolist() == [[4.25, 2, 1.25]]
    assert boxes.velocity_mps.tolist() == [[7.0, 0.5, 0]]


@pytest.mark.parametrize(
    ("start", "end", "share", "expected"),
    [
        (0.2, 0.6, 0.25, 0.3),
        (3.0, -3.0, 0.5, np.pi),
        (-3.0, 3.0, 0.25, -3.0 - (2 * np.pi - 6) / 4),
        (3.1, -3.1, 0.75, 3.1 + 0.75 * (2 * np.pi - 6.2) - 2 * np.pi),
        (0.1, 0.1 + 2 * np.pi, 0.5, 0.1),
        (0.0, -np.pi / 2, 0.5, -np.pi / 4),
    ],
)
def test_headings_take_the_shorter_arc(start, end, share, expected):
    a, b = (solid([1], [0], [yaw], pitch_rad=np.array([yaw]), roll_rad=np.array([-yaw])) for yaw in (start, end))
    boxes, _ = interpolate(a, b, share)
    for angle in (boxes.yaw_rad[0], boxes.pitch_rad[0], -boxes.roll_rad[0]):
        assert np.exp(1j * angle) == pytest.approx(np.exp(1j * expected), abs=1e-12)
        assert abs(angle) <= np.pi


def test_all_else_is_its_own():
    told = {"label": np.array(["car"]), "visibility": np.array([0.2]), "num_lidar_pts": np.array([5])}
    other = {"label": np.array(["van"]), "visibility": np.array([0.9]), "num_lidar_pts": np.array([50])}
    boxes, _ = interpolate(solid([1], [0], **told), solid([1], [1], **other), 0.9)
    assert {name: boxes.arrays()[name].tolist() for name in told} == {name: x.tolist() for name, x in told.items()}


def test_only_the_same_object_is_a_partner():
    """Ids that are gone, of none, or there twice; boxes that aren't real."""
    a = solid([1, 2, -1, 4, 4, 6, 8], [0.0] * 7)
    b = solid([8, 6, 1, -1, 4, 9, 9], [9.0, np.nan, 10, 9, 9, 9, 9])
    boxes, is_moved = interpolate(a, b, 0.5)
    assert is_moved.tolist() == [True, False, False, False, False, False, True]
    assert boxes.center_m[:, 0].tolist() == [5.0, 0, 0, 0, 0, 0, 4.5]
    without = Boxes3D(a.center_m, a.size_lwh_m, a.yaw_rad)
    assert not interpolate(without, b, 0.5)[1].any()
    assert not interpolate(a, without, 0.5)[1].any()
    assert not interpolate(a, Boxes3D.empty(), 0.5)[1].any()


def test_what_isnt_known_on_both_sides_stays():
    a = solid([1, 2], [0, 0], velocity_mps=np.array([[1.0, 0, 0], [np.nan] * 3]))
    b = solid([1, 2], [2, 2], velocity_mps=np.array([[np.nan] * 3, [3.0, 0, 0]]))
    boxes, _ = interpolate(a, b, 0.5)
    assert boxes.velocity_mps[0].tolist() == [1.0, 0, 0]
    assert np.isnan(boxes.velocity_mps[1]).all()
    boxes, _ = interpolate(a, solid([1, 2], [2, 2]), 0.5)
    np.testing.assert_array_equal(boxes.velocity_mps, a.velocity_mps)


def test_rectangles_are_linear():
    a = flat([3, 4], [10, 50], visible_xyxy_px=np.array([[10.0, 0, 15, 20]] * 2), distance_m=np.array([20.0, 5]))
    b = flat([3], [20], visible_xyxy_px=np.array([[20.0, 0, 30, 20]]), distance_m=np.array([18.0]))
    boxes, is_moved = interpolate(a, b, 0.5)
    assert is_moved.tolist() == [True, False]
    assert boxes.xyxy_px.tolist() == [[15, 0, 25, 20], [50, 0, 60, 20]]
    assert boxes.visible_xyxy_px.tolist() == [[15, 0, 22.5, 20], [10, 0, 15, 20]]
    assert boxes.distance_m.tolist() == [19.0, 5.0]


def test_moved_boxes_get_no_pitch_and_roll_of_their_own():
    step = np.eye(4)
    step[:3, 3] = [1, 0, 0]
    there = move_to_body(solid([1], [5]), step)
    assert there.center_m.tolist() == [[6, 0, 0.5]]
    assert (there.roll_rad, there.pitch_rad) == (None, None)
    kept = move_to_body(solid([1], [5], pitch_rad=np.array([0.1]), roll_rad=np.array([0.2])), step)
    np.testing.assert_allclose([kept.pitch_rad[0], kept.roll_rad[0]], [0.1, 0.2])
