"""Stereo pairs of a rig, and the rectification of their images."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import TypeAlias

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Float32, Float64
from fbench.replay.data.images import Pixels
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.geometry.camera import project, rays
from fbench.replay.geometry.transforms import inverse, transform

Maps: TypeAlias = tuple[Float32, Float32]
MAX_ANGLE_DEG = 10.0
_BASELINE_M = (0.05, 2.0)
_MIN_SIDE_PX = 32


@dataclass(frozen=True)
class Pair:
    """Two cameras side by side."""

    left: str
    right: str
    baseline_m: float


@dataclass(frozen=True, eq=False)
class Rectified:
    """How the images of a pair are brought into one plane, rows on rows."""

    size_wh: tuple[int, int]
    left_map: Maps
    right_map: Maps
    rectified_T_left: Float64  # Matrix (4, 4) that turns camera coordinates of the left camera
    camera: CameraModel  # The left camera, rectified
    baseline_m: float

    def images(self, left: Pixels, right: Pixels) -> tuple[Pixels, Pixels]:
        """Rectify two images."""
        import cv2

        one = cv2.remap(left, *self.left_map, cv2.INTER_LINEAR)
        other = cv2.remap(right, *self.right_map, cv2.INTER_LINEAR)
        return np.asarray(one, np.uint8), np.asarray(other, np.uint8)


def pairs(rig: Rig) -> Sequence[Pair]:
    """Cameras of one size that look the same way, up to 10 degrees, 0.05 to 2 m beside each other."""
    names, found = [name for name in rig.sensors("camera") if name in rig.cameras], list[Pair]()
    cosine = np.cos(np.radians(MAX_ANGLE_DEG))
    for left, right in permutations(names, 2):
        if rig.cameras[left].size_wh == rig.cameras[right].size_wh:
            left_T_right = inverse(rig.body_T_sensor(left)) @ rig.body_T_sensor(right)
            along, *others = left_T_right[:3, 3]
            parallel = left_T_right[2, 2] >= cosine and left_T_right[0, 0] >= cosine
            if parallel and _BASELINE_M[0] <= along <= _BASELINE_M[1] and max(np.abs(others)) < 0.4 * along:
                found.append(Pair(left, right, float(along)))
    return found


def rectify(rig: Rig, pair: Pair) -> Rectified:
    """Rectify a pair. Raises LogError where a lens distortion isn't modeled, or images are too small to be matched."""
    import cv2

    if min(rig.cameras[pair.left].size_wh) < _MIN_SIDE_PX:
        raise LogError(f"stereo of {pair.left} and {pair.right}: images of less than {_MIN_SIDE_PX} px a side")

    left, right = rig.cameras[pair.left], rig.cameras[pair.right]
    right_T_left = inverse(rig.body_T_sensor(pair.right)) @ rig.body_T_sensor(pair.left)
    size, straight = left.size_wh, np.zeros(5)
    one, other, left_P, right_P = cv2.stereoRectify(
        left.K, straight, right.K, straight, size, right_T_left[:3, :3].copy(), right_T_left[:3, 3].reshape(3, 1),
        flags=cv2.CALIB_ZERO_DISPARITY, alpha=0,
    )[:4]  # fmt: skip
    turn = np.eye(4)
    turn[:3, :3] = one
    flat = CameraModel(np.asarray(left_P[:, :3], np.float64), size)
    baseline_m = float(-right_P[0, 3] / right_P[0, 0])
    return Rectified(size, _map(left, flat, one), _map(right, flat, other), turn, flat, baseline_m)


def _map(camera: CameraModel, flat: CameraModel, rectified_R_camera: Float64) -> Maps:
    """Where each pixel of a rectified image is in the recorded one, whatever its lens."""
    width, height = flat.size_wh
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    back = np.eye(4)
    back[:3, :3] = rectified_R_camera.T
    uv, _ = project(camera, transform(back, rays(flat, np.stack([u.ravel(), v.ravel()], axis=1))))
    places = np.nan_to_num(uv, nan=-1e4).astype(np.float32).reshape(height, width, 2)
    return np.ascontiguousarray(places[..., 0]), np.ascontiguousarray(places[..., 1])
