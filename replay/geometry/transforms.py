"""Rigid transforms: float64 (4, 4) matrices named `dst_T_src`, quaternions in the order x, y, z, w."""

import numpy as np
from numpy.typing import ArrayLike

from fbench.replay.data.arrays import Array, Float64

_MANY = 2000  # From so many points on a compiled loop is used: it takes a fifth of the time


def pose_matrix(translation_m: ArrayLike, rotation_xyzw: ArrayLike) -> Float64:
    """Return `dst_T_src` (4, 4) of a position (3,) and quaternion (4,): the one function for stored rotations."""
    from scipy.spatial.transform import Rotation  # takes a while to import

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(np.asarray(rotation_xyzw, np.float64)).as_matrix()
    matrix[:3, 3] = translation_m
    return matrix


def pose_matrices(translation_m: ArrayLike, rotation_xyzw: ArrayLike) -> Float64:
    """Return `dst_T_src` (N, 4, 4) from positions (N, 3) and quaternions (N, 4), each as `pose_matrix` does."""
    from scipy.spatial.transform import Rotation  # takes a while to import

    xyzw = np.asarray(rotation_xyzw, np.float64).reshape(-1, 4)
    matrices = np.tile(np.eye(4), (len(xyzw), 1, 1))
    if len(xyzw):
        matrices[:, :3, :3] = Rotation.from_quat(xyzw).as_matrix()
        matrices[:, :3, 3] = translation_m
    return matrices


def quaternion(rotation: ArrayLike) -> Float64:
    """Return the quaternion x, y, z, w of a rotation matrix (3, 3), with w not negative."""
    from scipy.spatial.transform import Rotation  # takes a while to import

    xyzw = Rotation.from_matrix(np.asarray(rotation, np.float64)).as_quat(canonical=True)
    return np.asarray(xyzw, np.float64)


def inverse(dst_T_src: Float64) -> Float64:
    """Return `src_T_dst` (4, 4)."""
    result = np.eye(4)
    rotation = dst_T_src[:3, :3].T
    result[:3, :3] = rotation
    result[:3, 3] = -(rotation @ dst_T_src[:3, 3])
    return result


def transform(dst_T_src: Float64, xyz: Array) -> Float64:
    """Move points (N, 3) [m] from `src` to `dst`; returns float64 (N, 3), which isn't finite where a point isn't.
    Written as sums of products, so that the result doesn't depend on the BLAS in use.
    """
    m = dst_T_src
    if len(xyz) >= _MANY and xyz.dtype in (np.float32, np.float64):
        from fbench.replay.geometry.overlap_kernels import move_points  # numba takes a while to import

        return move_points(np.array(m, np.float64, order="C"), np.ascontiguousarray(xyz))
    p = np.asarray(xyz, np.float64)
    with np.errstate(over="ignore", invalid="ignore"):  # not finite in, not finite out: whoever needs more checks that
        return np.stack([p[:, 0] * m[i, 0] + p[:, 1] * m[i, 1] + p[:, 2] * m[i, 2] + m[i, 3] for i in range(3)], axis=1)


def chain(a_T_b: Float64, b_T_c: Float64) -> Float64:
    """Return `a_T_c` (4, 4), written as sums of products like `transform`."""
    result = np.eye(4)
    result[:3, :3] = [[sum(a_T_b[i, k] * b_T_c[k, j] for k in range(3)) for j in range(3)] for i in range(3)]
    result[:3, 3] = transform(a_T_b, b_T_c[None, :3, 3])[0]
    return result


def yaw_pitch_roll(rotation_xyzw: ArrayLike) -> tuple[float, float, float]:
    """Return yaw, pitch, roll [rad] with R = Rz(yaw) Ry(pitch) Rx(roll)."""
    from scipy.spatial.transform import Rotation  # takes a while to import

    yaw, pitch, roll = Rotation.from_quat(np.asarray(rotation_xyzw, np.float64)).as_euler("ZYX")
    return float(yaw), float(pitch), float(roll)


def extrapolate(world_T_a: Float64, world_T_b: Float64, share: float) -> Float64:
    """Continue the motion from pose `a` to pose `b` (4, 4) by `share` of it, at constant speed and turn rate."""
    from scipy.spatial.transform import Rotation  # takes a while to import

    a_T_b = inverse(world_T_a) @ world_T_b
    step = np.eye(4)
    step[:3, :3] = Rotation.from_rotvec(Rotation.from_matrix(a_T_b[:3, :3]).as_rotvec() * share).as_matrix()
    step[:3, 3] = a_T_b[:3, 3] * share
    return np.asarray(world_T_b @ step, np.float64)


def wrap_angle(angle_rad: Float64) -> Float64:
    """Wrap angles [rad] to [-pi, pi)."""
    wrapped: Float64 = (angle_rad + np.pi) % (2 * np.pi) - np.pi
    return wrapped
