"""Pinhole projection: camera x right, y down, z forward; pixel centres at integers."""

import numpy as np

from fbench.replay.arrays import Array, Bool, Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import CameraModel, Rig
from fbench.replay.errors import LogError
from fbench.replay.geometry.boxes import corners
from fbench.replay.geometry.transforms import inverse, transform

NEAR_M = 0.1
"""Points closer than this to the image plane count as behind the camera."""


def is_pinhole(camera: CameraModel) -> bool:
    """Tell whether a camera has no lens distortion, as after rectification."""
    return not np.any(camera.distortion)


def require_pinhole(name: str, camera: CameraModel) -> None:
    """Refuse cameras whose distortion isn't modelled yet.

    Raises:
        LogError: naming camera and model.
    """
    if not is_pinhole(camera):
        raise LogError(
            f"camera '{name}': distortion model '{camera.distortion_model}' isn't supported, rectify the images"
        )


def require_projection(rig: Rig, name: str) -> None:
    """Refuse a camera into which points can't be projected.

    Raises:
        LogError: where the rig has no intrinsics of it, or its distortion isn't modelled.
    """
    if name not in rig.cameras:
        raise LogError(f"camera '{name}' has no intrinsics")
    require_pinhole(name, rig.cameras[name])


def project(camera: CameraModel, xyz: Array) -> tuple[Float64, Float64]:
    """Project points (N, 3) in camera coordinates [m]; returns pixels (N, 2) and depths (N,) [m].

    u = f X/Z + c (thesis, Calibration). Points nearer than `NEAR_M` get NaN pixels.
    """
    p = np.asarray(xyz, np.float64)
    depth = p[:, 2]
    safe = np.where(depth > NEAR_M, depth, np.nan)
    u = (camera.K[0, 0] * p[:, 0] + camera.K[0, 1] * p[:, 1]) / safe + camera.K[0, 2]
    v = camera.K[1, 1] * p[:, 1] / safe + camera.K[1, 2]
    return np.stack([u, v], axis=1), depth


def project_body(rig: Rig, name: str, xyz: Array) -> tuple[Float64, Float64]:
    """Project points (N, 3) in body coordinates into camera `name`; see `project`."""
    camera = rig.cameras[name]
    require_pinhole(name, camera)
    return project(camera, transform(inverse(rig.body_T_sensor(name)), xyz))


def in_image(camera: CameraModel, uv: Float64) -> Bool:
    """Tell which pixels (N, 2) lie inside the image; NaN doesn't."""
    width, height = camera.size_wh
    u, v = uv[:, 0], uv[:, 1]
    inside: Bool = (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
    return inside


def project_boxes(rig: Rig, name: str, boxes: Boxes3D) -> tuple[Float64, Bool]:
    """Outline boxes (body coordinates) in camera `name`, clipped to the image.

    Returns rectangles (N, 4) left, top, right, bottom [px], NaN where not `seen`, and `seen` (N,). The part of a
    box behind the camera is cut off at `NEAR_M` before it is projected.
    """
    camera = rig.cameras[name]
    require_pinhole(name, camera)
    camera_T_body = inverse(rig.body_T_sensor(name))
    points = transform(camera_T_body, corners(boxes).reshape(-1, 3)).reshape(-1, 8, 3)
    rectangles = np.array([_outline(camera, p) for p in points]).reshape(-1, 4)
    seen: Bool = np.isfinite(rectangles).all(axis=1)
    return rectangles, seen


_EDGES = np.array([(i, j) for i in range(8) for j in range(i + 1, 8) if (i ^ j) in (1, 2, 4)])


def _outline(camera: CameraModel, points: Float64) -> Float64:
    """Rectangle around the projected convex hull of one box, or NaN."""
    uv, _ = project(camera, _in_front(points))
    if not len(uv):
        return np.full(4, np.nan)
    width, height = camera.size_wh
    low = np.maximum(uv.min(axis=0), -0.5)
    high = np.minimum(uv.max(axis=0), [width - 0.5, height - 0.5])
    return np.concatenate([low, high]) if (high > low).all() else np.full(4, np.nan)


def _in_front(points: Float64) -> Float64:
    """Corners in front of the camera, and the points where edges pass the near plane."""
    near = NEAR_M * (1 + 1e-9)
    a, b = points[_EDGES[:, 0]], points[_EDGES[:, 1]]
    crossing = (a[:, 2] > near) != (b[:, 2] > near)
    a, b = a[crossing], b[crossing]
    share = (2 * near - a[:, 2]) / (b[:, 2] - a[:, 2]) if len(a) else np.zeros(0)
    cut = a + share[:, None] * (b - a)
    return np.concatenate([points[points[:, 2] > near], cut[cut[:, 2] > NEAR_M]])
