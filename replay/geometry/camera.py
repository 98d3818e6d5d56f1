"""Projection into images and back: camera x right, y down, z forward; pixel centers at integers."""

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Array, Bool, Float64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.geometry.iou import corners
from fbench.replay.geometry.lenses import lens_of
from fbench.replay.geometry.transforms import inverse, transform

NEAR_M = 0.1
"""Points closer than this to the image plane count as behind the camera; for a fisheye, closer to the camera."""
_SAMPLES = 17  # Points along each edge of a box where a lens bends it
EDGES = np.array([(i, j) for i in range(8) for j in range(i + 1, 8) if (i ^ j) in (1, 2, 4)])
"""Corners (12, 2) at both ends of each edge, numbered as `corners` does."""


def curves(points: Float64, num: int, near_m: float) -> Float64:
    """Points (N, 12, `num`, 3) along the edges of boxes with corners (N, 8, 3) in camera coordinates [m]. They are
    evenly spread as seen from the camera. Edges are cut off where they come nearer to the image plane than `near_m`,
    NaN where nothing is left; with 0 they stay whole.
    """
    a, b = points[:, EDGES[:, 0]], points[:, EDGES[:, 1]]
    if near_m > 0:
        a, b = _cut(a, b, near_m * (1 + 1e-9))
    length_a, length_b = (np.sqrt((xyz * xyz).sum(axis=2))[..., None] for xyz in (a, b))
    share = np.linspace(0.0, 1.0, num)
    # The point on the edge whose direction is (1 - share) a/|a| + share b/|b|.
    with np.errstate(invalid="ignore", divide="ignore"):
        at = share * length_a / ((1 - share) * length_b + share * length_a)
    at = np.where(np.isfinite(at), at, share)[..., None]
    return np.asarray((1 - at) * a[:, :, None] + at * b[:, :, None], np.float64)


def _cut(a: Float64, b: Float64, near_m: float) -> tuple[Float64, Float64]:
    za, zb = a[..., 2], b[..., 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = ((near_m - za) / (zb - za))[..., None]
        crossing = a + share * (b - a)
    behind_a, behind_b = (za < near_m)[..., None], (zb < near_m)[..., None]
    crossing = np.where(behind_a & behind_b, np.nan, crossing)
    crossing[..., 2] = np.where(np.isnan(crossing[..., 2]), np.nan, near_m)
    return np.where(behind_a, crossing, a), np.where(behind_b, crossing, b)


def border_hits(points: Float64, rays: Float64, near_m: float) -> Bool:
    """Tell which rays (M, 3) from the origin meet which boxes with corners (N, 8, 3) farther than `near_m`: (N, M)."""
    axes = points[:, [1, 2, 4]] - points[:, :1]
    square = (axes * axes).sum(axis=2)
    scaled = axes / np.where(square > 0, square, 1.0)[..., None]
    # In units of the box, whose corners are 0 and 1, along its axes.
    origin = -(scaled * points[:, :1]).sum(axis=2)[:, None]
    ahead = (rays[None, :, None] * scaled[:, None]).sum(axis=3)
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = -origin / ahead, (1 - origin) / ahead
    inside = (ahead == 0) & (origin >= 0) & (origin <= 1)
    enter = np.where(inside, -np.inf, np.fmin(first, second)).max(axis=2, initial=-np.inf)
    leave = np.where(inside, np.inf, np.fmax(first, second)).min(axis=2, initial=np.inf)
    return np.asarray((leave > enter) & (leave > near_m) & (square > 0).all(axis=1)[:, None], np.bool_)


def is_pinhole(camera: CameraModel) -> bool:
    """Tell whether a camera has no lens distortion, as after rectification. Raises LogError where it isn't modeled."""
    return lens_of(camera) is None


def not_projectable(camera: CameraModel) -> str | None:
    """Say why points can't be projected into a camera; `None` where they can."""
    try:
        lens_of(camera)
    except LogError as error:
        return str(error)
    return None


def can_project(rig: Rig, name: str) -> bool:
    """Tell whether a camera has transform, intrinsics, and a distortion that is modeled."""
    return name not in rig.bare and name in rig.cameras and not_projectable(rig.cameras[name]) is None


def require_projection(rig: Rig, name: str) -> None:
    """Refuse a camera without projection. Raises LogError without transform or intrinsics, or where distortion isn't
    modeled.
    """
    if name in rig.bare:
        raise LogError(f"camera '{name}' has no transform to the body; add it with --rig", "CAL001")
    if name not in rig.cameras:
        raise LogError(f"camera '{name}' has no intrinsics; add them with --rig", "CAL001")
    why = not_projectable(rig.cameras[name])
    if why is not None:
        raise LogError(f"camera '{name}': {why}; rectify the images", "CAL001")


def project(camera: CameraModel, xyz: Array) -> tuple[Float64, Float64]:
    """Project points (N, 3) in camera coordinates [m]; returns pixels (N, 2) and depths (N,) [m].

    u = f X/Z + c (thesis, Calibration), where a lens bends X/Z and Y/Z before. Depth is Z, for a fisheye the distance.
    Points nearer than `NEAR_M`, and those that a lens can't see, get NaN pixels. Raises LogError where the camera's
    distortion isn't modeled.
    """
    p = np.asarray(xyz, np.float64)
    lens = lens_of(camera)
    depth = np.sqrt((p * p).sum(axis=1)) if lens is not None and lens.is_wide else p[:, 2]
    if lens is not None:
        uv = _to_pixels(camera, lens.bend(p))
        uv[~(depth > NEAR_M)] = np.nan
        return uv, depth
    safe = np.where(depth > NEAR_M, depth, np.nan)
    u = (camera.K[0, 0] * p[:, 0] + camera.K[0, 1] * p[:, 1]) / safe + camera.K[0, 2]
    v = camera.K[1, 1] * p[:, 1] / safe + camera.K[1, 2]
    return np.stack([u, v], axis=1), depth


def _to_pixels(camera: CameraModel, xy: Float64) -> Float64:
    u = camera.K[0, 0] * xy[:, 0] + camera.K[0, 1] * xy[:, 1] + camera.K[0, 2]
    return np.stack([u, camera.K[1, 1] * xy[:, 1] + camera.K[1, 2]], axis=1)


def rays(camera: CameraModel, uv: Array) -> Float64:
    """Unit vectors (N, 3) in camera coordinates of pixels (N, 2), NaN without. Raises LogError as `project` does."""
    uv = np.asarray(uv, np.float64)
    y = (uv[:, 1] - camera.K[1, 2]) / camera.K[1, 1]
    x = (uv[:, 0] - camera.K[0, 2] - camera.K[0, 1] * y) / camera.K[0, 0]
    lens = lens_of(camera)
    if lens is not None:
        return lens.undistort(np.stack([x, y], axis=1))
    ahead = np.stack([x, y, np.ones(len(x))], axis=1)
    return np.asarray(ahead / np.sqrt((ahead * ahead).sum(axis=1))[:, None], np.float64)


def project_body(rig: Rig, name: str, xyz: Array) -> tuple[Float64, Float64]:
    """Project points (N, 3) in body coordinates into camera `name`; see `project`."""
    require_projection(rig, name)
    return project(rig.cameras[name], transform(inverse(rig.body_T_sensor(name)), xyz))


def in_image(camera: CameraModel, uv: Float64) -> Bool:
    """Tell which pixels (N, 2) lie inside the image; NaN doesn't."""
    width, height = camera.size_wh
    u, v = uv[:, 0], uv[:, 1]
    return np.asarray((u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5), np.bool_)


def project_boxes(rig: Rig, name: str, boxes: Boxes3D) -> tuple[Float64, Bool]:
    """Outline boxes (body coordinates) in camera `name`, clipped to the image. Returns rectangles (N, 4) left, top,
    right, bottom [px], NaN where not `seen`, and `seen` (N,). The part of a box behind the camera is cut off at
    `NEAR_M` before it is projected, and so is what its lens doesn't see.
    """
    require_projection(rig, name)
    camera, points = rig.cameras[name], _camera_corners(rig, name, boxes)
    lens = lens_of(camera)
    outline = _in_front(points)
    if lens is not None:
        outline = curves(points, _SAMPLES, 0.0 if lens.is_wide else NEAR_M).reshape(len(points), 12 * _SAMPLES, 3)
    uv = project(camera, outline.reshape(-1, 3))[0].reshape(*outline.shape[:2], 2)
    if lens is not None:  # what a lens sees of a box ends at its edges and at the border of what it sees at all
        hits = border_hits(points, lens.border, NEAR_M)[..., None]
        uv = np.concatenate([uv, np.where(hits, _to_pixels(camera, lens.bend(lens.border)), np.nan)], axis=1)
    width, height = camera.size_wh
    low = np.maximum(np.fmin.reduce(uv, axis=1), -0.5)
    high = np.minimum(np.fmax.reduce(uv, axis=1), [width - 0.5, height - 0.5])
    rectangles = np.concatenate([low, high], axis=1)
    rectangles[~(high > low).all(axis=1)] = np.nan
    seen: Bool = np.all(np.isfinite(rectangles), axis=1)
    return rectangles, seen


def project_edges(rig: Rig, name: str, boxes: Boxes3D, num: int = 9) -> Float64:
    """Pixels (N, 12, `num`, 2) along the edges of boxes (body coordinates), which a lens bends; NaN where not seen."""
    require_projection(rig, name)
    camera = rig.cameras[name]
    lens = lens_of(camera)
    near_m = 0.0 if lens is not None and lens.is_wide else NEAR_M
    points = curves(_camera_corners(rig, name, boxes), num, near_m)
    return project(camera, points.reshape(-1, 3))[0].reshape(*points.shape[:-1], 2)


def _camera_corners(rig: Rig, name: str, boxes: Boxes3D) -> Float64:
    camera_T_body = inverse(rig.body_T_sensor(name))
    return transform(camera_T_body, corners(boxes).reshape(-1, 3)).reshape(-1, 8, 3)


def _in_front(points: Float64) -> Float64:
    """Corners (N, 8, 3) in front of the camera, and the points (N, 12, 3) where edges pass the near plane, else NaN."""
    near = NEAR_M * (1 + 1e-9)
    a, b = points[:, EDGES[:, 0]], points[:, EDGES[:, 1]]
    crossing = (a[..., 2] > near) != (b[..., 2] > near)
    rise = np.where(crossing, b[..., 2] - a[..., 2], np.nan)
    cut = a + ((near - a[..., 2]) / rise)[..., None] * (b - a)
    cut[..., 2] = np.where(crossing, near, np.nan)
    held = np.where((points[..., 2] > near)[..., None], points, np.nan)
    return np.concatenate([held, cut], axis=1)
