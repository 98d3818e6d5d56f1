"""Rectification: which two cameras give depth, and how their images are brought into one plane."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.data.arrays import Float64
from fbench.replay.data.images import Pixels
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.geometry.camera import is_pinhole, require_projection
from fbench.replay.geometry.stereo_pairs import MAX_ANGLE_DEG, Pair, Rectified, pairs, rectified
from fbench.replay.geometry.transforms import inverse

_STRAIGHT_PX = 0.05  # Rows that differ by less than this count as the same: images were rectified before


def choose_pair(rig: Rig, log_name: str, left: str | None, right: str | None) -> Pair:
    """Return the pair with the longest baseline, the first by name of equally long ones, or of those named. Raises
    ConfigError where a name isn't that of a camera. Raises LogError where the rig has no such pair, or a camera of it
    can't be projected into.
    """
    cameras = rig.sensors("camera")
    for side, name in (("left", left), ("right", right)):
        if name is not None and name not in cameras:
            raise ConfigError(f"stereo.{side}={name}: no such camera{did_you_mean(name, cameras)}")
    fitting = [p for p in pairs(rig) if left in (None, p.left) and right in (None, p.right)]
    if not fitting:
        wanted = (
            f"stereo3d needs two cameras of one size with calibration, parallel within {MAX_ANGLE_DEG:g} degrees, 0.05 "
            "to 2 m side by side"
        )
        if left is not None or right is not None:
            wanted += f" (stereo.left={left or 'any'}, stereo.right={right or 'any'})"
        sizes = {name: "{}x{}".format(*camera.size_wh) for name, camera in rig.cameras.items()}
        present = ", ".join(f"{name} {sizes[name]}" if name in sizes else name for name in cameras) or "no cameras"
        raise LogError(f"log '{log_name}': {wanted}; the log has: {present}", "CFG001")
    pair = min(fitting, key=lambda p: (-round(p.baseline_m, 6), p.left, p.right))
    for name in (pair.left, pair.right):
        require_projection(rig, name)
    return pair


@dataclass(frozen=True, eq=False)
class Rectifier:
    """Makes grey rectified images of one size from those of a pair, with maps that are computed once."""

    pair: Pair
    camera: CameraModel  # The left camera, shrunk and rectified; the right one is the same, `baseline_m` to its right
    baseline_m: float
    body_T_camera: Float64  # (4, 4) pose of the rectified left camera in body coordinates
    maps: Rectified | None  # How shrunk images are rectified; `None` where they are already

    def images(self, left: Pixels, right: Pixels) -> tuple[Pixels, Pixels]:
        """Shrink and rectify two grey images (H, W), to (h, w)."""
        one, other = (_small(image, self.camera.size_wh) for image in (left, right))
        return (one, other) if self.maps is None else self.maps.images(one, other)


def rectifier(rig: Rig, pair: Pair, shrink: int) -> Rectifier:
    """Compute how the images of a pair are shrunk and rectified. Raises LogError where lens distortion isn't modeled,
    or images are too small to be matched.
    """
    small = Rig(rig.mounts, {name: _shrunk(rig.cameras[name], shrink) for name in (pair.left, pair.right)})
    how = rectified(small, pair)
    body_T_left = rig.body_T_sensor(pair.left)
    if _is_straight(small, pair):
        return Rectifier(pair, small.cameras[pair.left], pair.baseline_m, body_T_left, None)
    return Rectifier(pair, how.camera, how.baseline_m, body_T_left @ inverse(how.rectified_T_left), how)


def _shrunk(camera: CameraModel, shrink: int) -> CameraModel:
    """Return the model of images that are made smaller; pixel centers stay at integers."""
    size = np.array(camera.size_wh)
    small = np.maximum(size // shrink, 1)
    K = camera.K.copy()
    K[:2] *= (small / size)[:, None]
    K[:2, 2] += 0.5 * (small / size) - 0.5
    width, height = (int(n) for n in small)
    return CameraModel(K, (width, height), camera.distortion_model, camera.distortion)


def _is_straight(rig: Rig, pair: Pair) -> bool:
    """Tell whether both cameras have the same `K`, no lens, parallel axes, and only x between them."""
    left, right = rig.cameras[pair.left], rig.cameras[pair.right]
    if not (is_pinhole(left) and is_pinhole(right)) or np.abs(left.K - right.K).max() > _STRAIGHT_PX:
        return False
    left_T_right = inverse(rig.body_T_sensor(pair.left)) @ rig.body_T_sensor(pair.right)
    turned = float(np.abs(left_T_right[:3, :3] - np.eye(3)).max())
    aside = float(np.abs(left_T_right[1:3, 3]).max()) / pair.baseline_m
    # Turned by an angle a, pixels move by about a times the distance to the corners; aside, by the share of disparity.
    reach = float(np.hypot(*left.size_wh)) + float(left.K[0, 0])
    return turned * reach < _STRAIGHT_PX and aside * left.size_wh[0] / 8 < _STRAIGHT_PX


def _small(grey: Pixels, size_wh: tuple[int, int]) -> Pixels:
    import cv2

    if grey.shape[::-1] == size_wh:
        return grey
    return np.asarray(cv2.resize(grey, size_wh, interpolation=cv2.INTER_AREA), np.uint8)
