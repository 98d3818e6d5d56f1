"""Errors of what the ego sees of a box: its nearest surface, its distances from the ego's axes, and its contour.

All are of footprints in the ground plane, in body coordinates, so the ego is at the origin and looks along x.
"""

import numpy as np

from fbench.replay.data.arrays import Bool, Float64

_CORNERS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2  # Counter-clockwise; face k joins corners k and k + 1
_NORMALS = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]])


def corners(center_xy_m: Float64, size_lw_m: Float64, yaw_rad: Float64) -> Float64:
    """Return the corners (N, 4, 2) of footprints: centers (N, 2), length and width (N, 2), headings (N,)."""
    return np.asarray(center_xy_m[:, None] + _turn(_CORNERS * size_lw_m[:, None], yaw_rad))


def _turn(points: Float64, yaw_rad: Float64) -> Float64:
    c, s = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    x, y = points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def distances_to_outline(points: Float64, outline: Float64) -> Float64:
    """Return how far (N, K) points (N, K, 2) are from the outlines of footprints (N, 4, 2), also from inside."""
    x, y, nearest = points[..., 0], points[..., 1], np.full(points.shape[:2], np.inf)
    for start, end in zip(range(4), (1, 2, 3, 0), strict=True):  # numpy is slow in sums and minima of short axes
        from_x, from_y = outline[:, start, :1], outline[:, start, 1:]
        side_x, side_y = outline[:, end, :1] - from_x, outline[:, end, 1:] - from_y
        x0, y0 = x - from_x, y - from_y
        share = np.clip((x0 * side_x + y0 * side_y) / np.maximum(side_x**2 + side_y**2, 1e-300), 0, 1)
        x0, y0 = x0 - share * side_x, y0 - share * side_y
        nearest = np.minimum(nearest, np.sqrt(x0**2 + y0**2))
    return nearest


def surface_distances(outline: Float64) -> Float64:
    """Return the distance (N,) of the origin from the nearest point of footprints (N, 4, 2); 0 inside of them."""
    side = np.roll(outline, -1, axis=1) - outline
    left = side[..., 0] * -outline[..., 1] - side[..., 1] * -outline[..., 0] >= 0
    return np.where(left.all(axis=1), 0.0, distances_to_outline(np.zeros((len(outline), 1, 2)), outline)[:, 0])


def support_distances(outline: Float64) -> Float64:
    """Return the signed distances (N, 2) of footprints (N, 4, 2) from the ego's lateral axis (x) and from its path
    ahead (y): of the nearest point; 0 where a footprint lies on both sides.
    """
    a, b, c, d = outline.transpose(1, 0, 2)
    low = np.minimum(np.minimum(a, b), np.minimum(c, d))
    high = np.maximum(np.maximum(a, b), np.maximum(c, d))
    return np.where(low > 0, low, np.where(high < 0, high, 0.0))


def seen_corners(outline: Float64, yaw_rad: Float64) -> Bool:
    """Tell which corners (N, 4) belong to a side that faces the origin; all where the origin is inside."""
    normals = _turn(np.broadcast_to(_NORMALS, (len(outline), 4, 2)), yaw_rad)
    toward = normals * -outline
    faces = toward[..., 0] + toward[..., 1] > 0
    seen = faces | np.roll(faces, 1, axis=1)
    return np.asarray(seen | ~seen.any(axis=1, keepdims=True))


def contour_errors(truth: Float64, truth_yaw_rad: Float64, estimates: Float64) -> Float64:
    """Return the mean distance (N,) of the corners of truth (N, 4, 2) that the ego sees from the estimates' outlines
    (N, 4, 2).
    """
    far, seen = distances_to_outline(truth, estimates), seen_corners(truth, truth_yaw_rad)
    return np.asarray((far * seen).sum(axis=1) / seen.sum(axis=1))
