import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.iou import corners, distance_bev, iou_2d


def test_corners_of_an_upright_box():
    found = corners(Boxes3D(np.array([[10.0, 5, 1]]), np.array([[4.0, 2, 1.5]]), np.array([np.pi / 2])))[0]
    np.testing.assert_allclose(found.min(axis=0), [9, 3, 0.25])
    np.testing.assert_allclose(found.max(axis=0), [11, 7, 1.75])


angles = st.floats(-3.0, 3.0)


@given(angles, angles, angles)
def test_corners_follow_yaw_pitch_roll(yaw, pitch, roll):
    size = np.array([[4.0, 2, 1.5]])
    box = Boxes3D(np.zeros((1, 3)), size, np.array([yaw]), np.array([roll]), np.array([pitch]))
    flat = corners(Boxes3D(np.zeros((1, 3)), size, np.zeros(1)))[0]
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).apply(flat)
    np.testing.assert_allclose(corners(box)[0], expected, atol=1e-12)


def test_neighboring_corners_share_an_edge():
    found = corners(Boxes3D(np.zeros((1, 3)), np.array([[4.0, 2, 1]]), np.zeros(1)))[0]
    lengths = [np.linalg.norm(found[0] - found[bit]) for bit in (1, 2, 4)]
    assert lengths == [4, 2, 1]


def test_iou_by_hand():
    a = np.array([[0.0, 0, 2, 2], [10, 10, 11, 11]])
    b = np.array([[1.0, 1, 3, 3], [0, 0, 2, 2], [5, 5, 5, 5]])
    np.testing.assert_allclose(iou_2d(a, b), [[1 / 7, 1, 0], [0, 0, 0]])
    assert iou_2d(np.zeros((0, 4)), b).shape == (0, 3)
    assert iou_2d(b[2:], b[2:])[0, 0] == 0


def test_distance_in_the_ground_plane_leaves_height_out():
    np.testing.assert_allclose(distance_bev([[0.0, 0, 5]], [[3.0, 4, 0], [0, 0, 9]]), [[5, 0]])
