"""Height of the ground under each point, without knowing how high the sensors sit or how they are tilted."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import ndimage

from fbench.pipelines.checks import require_ranges
from fbench.pipelines.points.ground_kernel import fullest_bands, heights, lowest_rows
from fbench.replay.arrays import Bool, Float64, Int64


@dataclass(frozen=True)
class GroundParams:
    """How the ground is found: a plane through the lowest points of all cells, then a surface of limited slope."""

    cell_m: float = 2.0
    """Edge of the cells [m] whose lowest points stand for the ground."""
    outliers: float = 0.05
    """Share of a cell's points that may lie below the ground."""
    range_m: float = 60.0
    """Farthest points [m] that take part."""
    max_tilt: float = 0.16
    """Steepest plane [m/m], by tilt of the sensors or of the road."""
    max_slope: float = 0.06
    """Steepest deviation from the plane [m/m]."""
    tolerance_m: float = 0.2
    """Height [m] below which a point belongs to the ground."""
    where: ClassVar[str] = "lidar.ground"
    """Dotted name of these parameters."""

    def __post_init__(self) -> None:
        # Cells and range bound the size of the grid.
        ranges = {
            "cell_m": (0.5, 100.0), "outliers": (0.0, 0.5), "range_m": (1.0, 500.0), "max_tilt": (0.0, 1.0),
            "max_slope": (0.0, 1.0), "tolerance_m": (0.0, 10.0),
        }  # fmt: skip
        require_ranges(self.where, self, ranges)


@dataclass(frozen=True)
class Plane:
    """z = slope_x x + slope_y y + height_m, in body coordinates."""

    slope_x: float
    slope_y: float
    height_m: float

    def z_m(self, xyz: Float64) -> Float64:
        """Height (N,) [m] of the plane at points (N, 2 or 3)."""
        z: Float64 = self.slope_x * xyz[:, 0] + self.slope_y * xyz[:, 1] + self.height_m
        return z


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Points that tell of the ground, and in which cells they lie."""

    xyz: Float64
    """(N, 3) [m] in body coordinates, all points."""
    is_near: Bool
    """(N,) which of them lie within `range_m`."""
    near: Float64
    """(M, 3) those."""
    cell: Int64
    """(M, 2) their cells."""


def surroundings(xyz: Float64, params: GroundParams) -> Surroundings:
    """Tell which points (N, 3) [m] in body coordinates are near, and put those into cells."""
    is_near = np.hypot(xyz[:, 0], xyz[:, 1]) < params.range_m
    near = xyz.take(np.flatnonzero(is_near), axis=0)
    cell = np.empty((len(near), 2), np.int64)
    cell[:, 0], cell[:, 1] = (np.floor(near[:, axis] / params.cell_m) for axis in (0, 1))
    return Surroundings(xyz, is_near, near, cell)


def lowest_points(around: Surroundings, params: GroundParams) -> Float64:
    """Return the lowest point (M, 3) of each cell, cells in lexicographic order.

    Points are in lexicographic order, which decides between equally low ones. In cells with many points the lowest
    `outliers` of them are passed over: reflections from below the road.
    """
    if not len(around.near):
        return around.near
    lowest: Float64 = around.near[lowest_rows(around.cell, around.near[:, 2], params.outliers)]
    return lowest


def fit_plane(lowest: Float64, params: GroundParams) -> Plane | None:
    """Fit a plane through most of the points (M, 3); `None` where they are too few.

    All tilts of a coarse grid are tried: the best is the one whose most frequent height holds most points, the
    flattest on ties. Least squares on the points near it, with a shrinking band, then refine it.
    """
    if len(lowest) < 3:
        return None
    steps = np.linspace(-params.max_tilt, params.max_tilt, 9)
    tilts = sorted(((a, b) for a in steps for b in steps), key=lambda t: (t[0] ** 2 + t[1] ** 2, t))
    plane = _fullest(lowest, np.array(tilts))
    for band_m in (0.6, 0.4, 0.3, 0.2, 0.2):
        plane = _refined(plane, lowest, band_m)
    return plane


def _fullest(lowest: Float64, slopes: Float64, band_m: float = 0.8) -> Plane:
    """Return the first plane of those with slopes (T, 2) that holds most points in its best band of heights."""
    z = np.sort(lowest[:, 2] - slopes[:, :1] * lowest[:, 0] - slopes[:, 1:] * lowest[:, 1], axis=1)
    num, begin = fullest_bands(z, band_m)
    best = int(np.argmax(num))
    return Plane(float(slopes[best, 0]), float(slopes[best, 1]), float(z[best, begin[best]] + band_m / 2))


def _refined(plane: Plane, lowest: Float64, band_m: float) -> Plane:
    residual = lowest[:, 2] - plane.z_m(lowest)
    inside = np.abs(residual) < band_m
    near = lowest[inside]
    if len(near) < 3:
        return plane
    middle = near.mean(axis=0)
    x, y, z = (near - middle).T
    xx, xy, yy = (x * x).sum(), (x * y).sum(), (y * y).sum()
    xz, yz = (x * z).sum(), (y * z).sum()
    determinant = xx * yy - xy * xy
    if determinant < 1e-3 * (xx + yy) ** 2:  # on a line: keep the tilt
        return Plane(plane.slope_x, plane.slope_y, plane.height_m + float(np.median(residual[inside])))
    a, b = float((xz * yy - yz * xy) / determinant), float((yz * xx - xz * xy) / determinant)
    return Plane(a, b, float(middle[2] - a * middle[0] - b * middle[1]))


def height_above_ground(around: Surroundings, lowest: Float64, plane: Plane, params: GroundParams) -> Float64:
    """Height (N,) [m] of all points above the highest surface under `lowest` (M, 3) that keeps to `max_slope`.

    The surface may deviate from the plane; points too far below the plane (mirrored by puddles and glass) are not
    taken for ground. Beyond `range_m` the plane counts.
    """
    deviation = lowest[:, 2] - plane.z_m(lowest)
    ground = np.abs(deviation) < 0.3 + params.max_slope * np.hypot(lowest[:, 0], lowest[:, 1])
    half = int(np.ceil(params.range_m / params.cell_m))
    # One cell more than needed: a quotient may be rounded up.
    grid = np.full((2 * half + 1, 2 * half + 1), np.inf)
    at = np.floor(lowest[ground, :2] / params.cell_m).astype(np.int64) + half
    grid[at[:, 0], at[:, 1]] = deviation[ground]
    offset = np.arange(-3, 4) * params.cell_m
    cone = params.max_slope * np.hypot(offset[:, None], offset[None, :])
    surface = ndimage.grey_erosion(grid, structure=-cone, mode="constant", cval=np.inf)
    surface = np.where(np.isfinite(surface), surface, 0.0)
    shape = np.array([plane.slope_x, plane.slope_y, plane.height_m])
    return heights(around.xyz, around.is_near, around.cell + half, shape, surface)
