"""From disparity to points in body coordinates, thinned so that what follows is fast."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.checks import require_ranges
from fbench.pipelines.stereo.cells_kernel import gather
from fbench.pipelines.stereo.rectify import Rectifier
from fbench.replay.arrays import Float32, Float64

_HEIGHT_M = 6.0
"""Points farther above or below the camera [m] are left out."""


@dataclass(frozen=True)
class DepthParams:
    """Pixels become points; those of one cell of columns, disparity and height become one, their mean.

    Cells grow with depth as its error does, so that each holds about as much noise: dZ = Z^2 / (f B) dd.
    """

    max_range_m: float = 40.0
    """Farther depths [m] are left out, the sky with them."""
    cell_px: int = 4
    """Columns of a cell [px] of the shrunk image."""
    cell_disparity_px: float = 0.5
    """Its range of disparities [px]."""
    cell_height_m: float = 0.25
    """Its height [m]."""
    min_pixels: int = 8
    """Cells with fewer pixels are noise."""

    def __post_init__(self) -> None:
        ranges = {
            "max_range_m": (1.0, 500.0), "cell_px": (1, 100), "cell_disparity_px": (0.05, 100.0),
            "cell_height_m": (0.05, 10.0), "min_pixels": (1, 10_000),
        }  # fmt: skip
        require_ranges("stereo.depth", self, ranges)


def points(disparity: Float32, how: Rectifier, nearest_m: float, params: DepthParams) -> Float64:
    """Points (N, 3) [m] in body coordinates, in lexicographic order.

    Takes disparities (H, W) [px] of the rectified left image, NaN where unknown; nearer depths are left out, too.
    """
    K, t = how.camera.K, how.body_T_camera[:3, 3]
    per_px = np.array([[1 / K[0, 0], -K[0, 2] / K[0, 0]], [1 / K[1, 1], -K[1, 2] / K[1, 1]]])
    limits = np.array([min(nearest_m, params.max_range_m), params.max_range_m])
    cells = np.array([params.cell_px, params.cell_disparity_px, params.cell_height_m])
    z_m = np.array([t[2] - _HEIGHT_M, t[2] + _HEIGHT_M])
    columns = np.ascontiguousarray(disparity.T)
    xyz, num = gather(columns, K[0, 0] * how.baseline_m, per_px, how.body_T_camera, limits, cells, z_m)
    xyz = xyz[num >= params.min_pixels]
    return xyz[np.lexsort(xyz.T[::-1])]
