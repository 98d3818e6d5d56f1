"""What all points of a sensor say about a place in the image: something is there, or rays went through it."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.points.ordering import lexicographic_order
from fbench.replay.arrays import Float64
from fbench.replay.data import Rig
from fbench.replay.geometry.camera import in_image, project_body

_INSET = 0.15
"""This share of a box is left out on each side, since a box is wider than what it shows."""
_WINDOW_M = 3.0
"""Depth [m] of a window that holds the points of one object."""
_DENSE = 0.5
"""Of several windows the nearest counts that has this share of the points of the fullest."""


@dataclass(frozen=True, eq=False)
class Rays:
    """All points of one kind of sensor in an image, those on the ground too; sorted by depth."""

    uv_px: Float64
    """(N, 2) [px]."""
    depth_m: Float64
    """(N,) along the optical axis [m]."""

    @classmethod
    def of(cls, rig: Rig, camera: str, xyz: Float64 | None) -> "Rays":
        """Project points (N, 3) in body coordinates; `None`: no sensor delivered."""
        if xyz is None:
            return cls(np.zeros((0, 2)), np.zeros(0))
        uv, depth = project_body(rig, camera, xyz)
        seen = np.flatnonzero(in_image(rig.cameras[camera], uv))
        uv, depth = uv.take(seen, axis=0), depth.take(seen)
        order = lexicographic_order(depth, *uv.T[::-1])
        return cls(uv.take(order, axis=0), depth.take(order))

    def depths(self, xyxy_px: Float64) -> Float64:
        """Depths of the points in the middle of a box (4,), ascending."""
        left, top, right, bottom = xyxy_px
        x, y = _INSET * (right - left), _INSET * (bottom - top)
        u, v = self.uv_px.T
        inside = (u > left + x) & (u < right - x) & (v > top + y) & (v < bottom - y)
        return np.asarray(self.depth_m[inside], np.float64)


def seen_through(depths_m: Float64, near_m: float, far_m: float) -> float:
    """Share of the rays reaching `near_m` [m] or beyond, given ascending depths (N,), that go on beyond `far_m`.

    NaN where no ray reaches that far: something hides the place, or the sensor sees nothing there.
    """
    begin, end = np.searchsorted(depths_m, [near_m, far_m])
    num = len(depths_m) - begin
    return float((len(depths_m) - end) / num) if num else np.nan


def nearest_dense(depths_m: Float64, least: int) -> float:
    """Depth [m] of the nearest dense part of ascending depths (N,), its median; NaN where none has `least` points.

    What lies behind an object, and is seen beside it or through its windows, doesn't count: neither a mean nor a
    median of all would leave it out.
    """
    if len(depths_m) < least:
        return float("nan")
    stop = np.searchsorted(depths_m, depths_m + _WINDOW_M, side="right")
    num = stop - np.arange(len(depths_m))
    if num.max() < least:
        return float("nan")
    begin = int(np.argmax(num >= max(least, _DENSE * num.max())))
    return float(np.median(depths_m[begin : stop[begin]]))
