"""Sensors from published matrices."""

import numpy as np
import pytest

from fbench.datasets.importing.files import BODY_T_OPTICAL, is_pinhole, is_rotation, mount_of
from fbench.replay.geometry.transforms import pose_matrix

TURN = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])


def test_a_mount_is_the_pose_that_it_was_made_of():
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = TURN, (1, 2, 3)
    mount = mount_of("lidar", pose)
    assert mount.kind == "lidar"
    np.testing.assert_allclose(pose_matrix(mount.translation_m, mount.rotation_xyzw), pose, atol=1e-12)


def test_optical_axes_are_right_down_forward():
    right, down, forward = BODY_T_OPTICAL[:3, :3].T.tolist()
    assert (right, down, forward) == ([0, -1, 0], [0, 0, -1], [1, 0, 0])


@pytest.mark.parametrize(
    ("matrix", "expected"),
    [
        (np.eye(3), True),
        (TURN + np.diag([4e-4, 0, 0]), True),
        (TURN + 2e-3, False),
        (np.diag([1.0, 1, -1]), False),
        (np.zeros((3, 3)), False),
        (np.full((3, 3), np.nan), False),
        (np.full((3, 3), 1e300), False),
    ],
)
def test_rotations(matrix, expected):
    assert is_rotation(matrix) is expected


@pytest.mark.parametrize(
    ("place", "value", "expected"),
    [
        ((0, 1), 0.5, True),
        ((1, 0), 0.5, False),
        ((2, 2), 2, False),
        ((2, 0), 1e-9, False),
        ((0, 0), -700, False),
        ((1, 1), 0, False),
        ((0, 0), np.nan, False),
    ],
)
def test_pinholes(place, value, expected):
    K = np.array([[700.0, 0, 600], [0, 700, 200], [0, 0, 1]])
    K[place] = value
    assert is_pinhole(K) is expected
