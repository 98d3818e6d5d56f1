"""What each sensor could see of an object: field of view, distance, size in the image, and what is in front of it."""

import numpy as np

from fbench.pipelines.fusion.fusion_kernels import hidden_shares, nearest_by_bearing
from fbench.pipelines.fusion.lift import Sighting
from fbench.pipelines.points.ground import Plane
from fbench.replay.arrays import Bool, Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Rig
from fbench.replay.geometry.camera import in_image, project_body

_BINS = 720
_SECTORS = 36
_HIDES_M = (0.5, 2.2)
_BEHIND_M = 1.5
_STEEPNESS = 2.0


def blocking(xyz: Float64, plane: Plane | None) -> Float64:
    """Points (M, 3) of those (N, 3) that hide what is behind them: as high as cars."""
    if plane is None:
        return xyz
    height = xyz[:, 2] - plane.z_m(xyz)
    return xyz[(height > _HIDES_M[0]) & (height < _HIDES_M[1])]


def hidden(targets: Boxes3D, eye_m: Float64, points: Float64, boxes: list[Sighting]) -> Float64:
    """Share (N,) of each object's width that something nearer hides from `eye_m` (2,): LiDAR points (M, 3), or what
    a camera there sees.
    """
    nearest = nearest_by_bearing(np.ascontiguousarray(points[:, :2] - eye_m), _BINS)
    for s in boxes:
        begin, end = (int(np.floor(_bin(np.array(s.bearing_rad + side * s.half_rad)))) for side in (-1, 1))
        rows = np.arange(begin, end + 1) % _BINS
        nearest[rows] = np.minimum(nearest[rows], s.near_m * (1 + 2 * s.std))
    off = targets.center_m[:, :2] - eye_m
    reach = np.maximum(np.hypot(off[:, 0], off[:, 1]), 0.1)
    half_rad = targets.size_lwh_m[:, 1] / 2 / np.maximum(reach, 1.0)
    near = reach - targets.size_lwh_m[:, 0] / 2 - _BEHIND_M
    return hidden_shares(nearest, np.arctan2(off[:, 1], off[:, 0]), half_rad, near)


def in_camera(rig: Rig, camera: str, targets: Boxes3D, half_px: float) -> Float64:
    """Probability (N,) that a working camera sees objects that nothing hides: 0 outside of its image, one half where
    they are `half_px` high.
    """
    uv, depth = project_body(rig, camera, targets.center_m)
    model = rig.cameras[camera]
    height = model.K[1, 1] * targets.size_lwh_m[:, 2] / np.maximum(depth, 0.1)
    share = 1 / (1 + (half_px / np.maximum(height, 1e-3)) ** (2 * _STEEPNESS))
    return np.where(in_image(model, uv), share, 0.0)


def in_sectors(targets: Boxes3D, eye_m: Float64, points: Float64) -> Bool:
    """Tell which objects (N,) lie in a direction in which a sensor at `eye_m` (2,) sees anything: its points (M, 3)."""
    off = points[:, :2] - eye_m
    seen = np.isfinite(nearest_by_bearing(np.ascontiguousarray(off), _SECTORS))
    seen = np.any([np.roll(seen, shift) for shift in (-2, -1, 0, 1, 2)], axis=0)
    at = np.arctan2(targets.center_m[:, 1] - eye_m[1], targets.center_m[:, 0] - eye_m[0])
    return np.asarray(seen[(_bin(at) / _BINS * _SECTORS).astype(np.int64) % _SECTORS], np.bool_)


def _bin(angle_rad: Float64) -> Float64:
    return np.asarray((angle_rad + np.pi) / (2 * np.pi) * _BINS, np.float64)
