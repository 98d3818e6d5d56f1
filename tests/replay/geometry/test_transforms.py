import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.replay.geometry.transforms import (
    chain,
    inverse,
    pose_matrix,
    quaternion,
    transform,
    wrap_angle,
    yaw_pitch_roll,
)

angles = st.floats(-1.5, 1.5)


def euler_xyzw(yaw, pitch, roll):
    """Quaternion by hand: qz * qy * qx."""
    (cz, sz), (cy, sy), (cx, sx) = ((np.cos(a / 2), np.sin(a / 2)) for a in (yaw, pitch, roll))
    return np.array([
        cz * cy * sx - sz * sy * cx, cz * sy * cx + sz * cy * sx,
        sz * cy * cx - cz * sy * sx, cz * cy * cx + sz * sy * sx,
    ])  # fmt: skip


@given(angles, angles, angles)
def test_angles_survive(yaw, pitch, roll):
    np.testing.assert_allclose(yaw_pitch_roll(euler_xyzw(yaw, pitch, roll)), (yaw, pitch, roll), atol=1e-9)


@given(angles, angles, angles)
def test_inverse_undoes(yaw, pitch, roll):
    a_T_b = pose_matrix([1, -2, 3], euler_xyzw(yaw, pitch, roll))
    points = np.array([[0.0, 0, 0], [1, 2, 3], [-5, 4, 9]])
    np.testing.assert_allclose(transform(inverse(a_T_b), transform(a_T_b, points)), points, atol=1e-12)
    np.testing.assert_allclose(a_T_b[:3, :3] @ a_T_b[:3, :3].T, np.eye(3), atol=1e-12)


@given(angles, angles, angles)
def test_quaternion_of_a_matrix_gives_the_matrix_back(yaw, pitch, roll):
    matrix = pose_matrix(np.zeros(3), euler_xyzw(yaw, pitch, roll))
    np.testing.assert_allclose(pose_matrix(np.zeros(3), quaternion(matrix[:3, :3])), matrix, atol=1e-12)


def test_quarter_turn_by_hand():
    b_T_a = pose_matrix([10, 0, 0], [0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    np.testing.assert_allclose(transform(b_T_a, np.array([[1.0, 0, 0]])), [[10, 1, 0]], atol=1e-15)


def test_wrap_angle():
    np.testing.assert_allclose(wrap_angle(np.array([0, np.pi, -np.pi, 3.5])), [0, -np.pi, -np.pi, 3.5 - 2 * np.pi])


@pytest.mark.parametrize("value", [np.nan, np.inf, 1.7e308])
def test_points_that_are_not_finite_stay_so_without_a_warning(value):
    turned = pose_matrix([0, 0, 0], [0.5, 0.5, 0.5, 0.5]) * 2
    moved = transform(turned, np.array([[1.0, 2, 3], [value, value, -value]]))
    assert np.isfinite(moved).all(axis=1).tolist() == [True, False]


def test_chained_transforms_are_the_product_of_matrices():
    a = pose_matrix([1.0, -2, 3], [0.1, 0.2, 0.3, 0.9])
    b = pose_matrix([0.5, 4, -1], [-0.7, 0.1, 0.2, 0.4])
    np.testing.assert_allclose(chain(a, b), a @ b, atol=1e-15)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_many_points_move_as_few_do(dtype):
    """Bit by bit, whatever holds them, and what isn't finite stays so."""
    rng = np.random.default_rng(5)
    matrix = pose_matrix(rng.normal(0, 100, 3), euler_xyzw(0.3, -0.1, 0.2))
    xyz = (rng.normal(0, 50, (9000, 3)) * 10.0 ** rng.integers(-30, 30, (9000, 1))).astype(dtype)
    xyz[5], xyz[7, 1], xyz[9, 2] = np.nan, np.inf, -np.inf
    few = np.concatenate([transform(matrix, part) for part in np.split(xyz, 9000 // 500)])
    frozen = xyz.copy()
    frozen.flags.writeable = False
    for points in (xyz, frozen, np.asfortranarray(xyz), np.repeat(xyz, 2, axis=0)[::2]):
        np.testing.assert_array_equal(transform(matrix, points), few)
