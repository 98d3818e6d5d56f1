"""Height of the ground under each point, without knowing how high the sensors sit."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.geometry.kernels import kernel, kernel_part


@kernel_part
def _at_rank(values: Float64, rank: int) -> int:
    """Return where the value lies that has this rank in ascending order; of equal ones the first has the lowest."""
    value = np.partition(values, rank)[rank]
    left = rank
    for one in values:
        if one < value:
            left -= 1
    for at, one in enumerate(values):
        if one == value:
            if left == 0:
                return at
            left -= 1
    return 0  # never: the value is one of them


@kernel
def lowest_rows(cell: Int64, z_m: Float64, outliers: float) -> Int64:
    """Return the row of the lowest point of each cell, cells in lexicographic order.

    Takes cells (N, 2) and heights (N,) [m] of at least one point; of equally low points the first counts. In each cell
    the share `outliers` of its lowest points is passed over.
    """
    low = (cell[:, 0].min(), cell[:, 1].min())
    wide = cell[:, 1].max() - low[1] + 1
    number = (cell[:, 0] - low[0]) * wide + cell[:, 1] - low[1]
    first = np.zeros(number.max() + 2, np.int64)
    for one in number:
        first[one + 1] += 1
    first = np.cumsum(first)
    rows, filled = np.empty(len(number), np.int64), first.copy()
    for row, one in enumerate(number):
        rows[filled[one]] = row
        filled[one] += 1
    result = np.empty(len(first), np.int64)
    num = 0
    for one in range(len(first) - 1):
        own = rows[first[one] : first[one + 1]]
        if len(own):
            result[num] = own[_at_rank(z_m[own], int(outliers * len(own)))]
            num += 1
    return result[:num]


@kernel
def heights(xyz: Float64, is_near: Bool, cell: Int64, plane: Float64, surface: Float64) -> Float64:
    """Height (N,) [m] of points (N, 3) above a plane, and, of those that are near, above a surface on it.

    `plane` holds its slopes and its height, `cell` (M, 2) the cells of `surface` (R, C) [m] under the near points.
    """
    result, num = np.empty(len(xyz)), 0
    for row in range(len(xyz)):
        result[row] = xyz[row, 2] - (plane[0] * xyz[row, 0] + plane[1] * xyz[row, 1] + plane[2])
        if is_near[row]:
            result[row] -= surface[cell[num, 0], cell[num, 1]]
            num += 1
    return result


@kernel
def best_bands(z_m: Float64, lower_m: Float64, band_m: float) -> tuple[Int64, Int64]:
    """Return for each row of ascending heights (R, N) [m] how many lie within the best band, less `BELOW` for each far
    below it, and where it begins.

    A band begins with one of the heights and includes both its ends; of equally good ones the lowest counts. Ascending
    `lower_m` (R, N) [m] says how high it may begin before a point counts as far below it: next to nothing lies below
    the ground, so that a band of hoods and roofs of parked cars isn't taken for it.
    """
    most, at = np.full(len(z_m), -np.iinfo(np.int64).max), np.zeros(len(z_m), np.int64)
    for row in range(len(z_m)):
        end = below = 0
        for begin in range(z_m.shape[1]):
            while end < z_m.shape[1] and z_m[row, end] <= z_m[row, begin] + band_m:
                end += 1
            while below < z_m.shape[1] and lower_m[row, below] < z_m[row, begin]:
                below += 1
            value = end - begin - BELOW * below
            if value > most[row]:
                most[row], at[row] = value, begin
    return most, at


BELOW = 2  # A point far below what is taken for the ground outweighs so many that lie on it
DIP_M, CREST_M = 0.3, 500.0
"""What is lower than the ground by more than this [m] lies far below it, unless the ground falls off as on a crest of
this radius [m]; that of roads for 50 km/h is no smaller."""


@dataclass(frozen=True)
class GroundParams(CheckedParams, prefix="lidar.ground"):
    """How the ground is found: a plane through the lowest points of all cells, then a surface of limited slope. Limits
    of cells and range bound the size of the grid.
    """

    cell_m: float = in_range(2.0, 0.5, 100)  # Edge of the cells [m] whose lowest points stand for the ground.
    outliers: float = in_range(0.05, 0, 0.5)  # Share of a cell's points that may lie below the ground.
    range_m: float = in_range(60.0, 1, 500)  # Farthest points [m] that take part.
    max_tilt: float = in_range(0.16, 0, 1)  # Steepest plane [m/m], by tilt of the sensors or of the road.
    max_slope: float = in_range(0.06, 0, 1)  # Steepest deviation from the plane [m/m].
    tolerance_m: float = in_range(0.2, 0, 10)  # Height [m] below which a point belongs to the ground.


@dataclass(frozen=True)
class Plane:
    """z = slope_x x + slope_y y + height_m, in body coordinates."""

    slope_x: float
    slope_y: float
    height_m: float

    def z_m(self, xyz: Float64) -> Float64:
        """Height (N,) [m] of the plane at points (N, 2 or 3)."""
        return self.slope_x * xyz[:, 0] + self.slope_y * xyz[:, 1] + self.height_m


def find_ground(xyz: Float64, params: GroundParams) -> tuple[Plane | None, Bool, Float64]:
    """Find the ground under points (N, 3) [m] in body coordinates and lexicographic order.

    Returns a plane, `None` where too few points tell; which points (N,) are near, within `range_m`; and heights (N,)
    [m] above the ground, see `height_above_ground`. Without a plane no point is near, and heights are 0. The ground is
    seen at the lowest point of each cell, of equally low ones the first. In cells with many points the lowest
    `outliers` of them are passed over: reflections from below the road.
    """
    is_near = np.hypot(xyz[:, 0], xyz[:, 1]) < params.range_m
    near = xyz.take(np.flatnonzero(is_near), axis=0)
    cell = np.empty((len(near), 2), np.int64)
    cell[:, 0], cell[:, 1] = (np.floor(near[:, axis] / params.cell_m) for axis in (0, 1))
    lowest = near[lowest_rows(cell, near[:, 2], params.outliers)] if len(near) else near
    plane = fit_plane(lowest, params)
    if plane is None:
        return None, np.zeros(len(xyz), np.bool_), np.zeros(len(xyz))
    return plane, is_near, height_above_ground(xyz, is_near, cell, lowest, plane, params)


def fit_plane(lowest: Float64, params: GroundParams) -> Plane | None:
    """Fit a plane through most of the points (M, 3); `None` where they are too few.

    All tilts of a coarse grid are tried: the best is the one whose most frequent height holds most points, the
    flattest on ties. Least squares on the points near it, with a shrinking band, then refine it.
    """
    if len(lowest) < 3:
        return None
    slopes, band_m = tilts(params), 0.8
    z = lowest[:, 2] - slopes[:, :1] * lowest[:, 0] - slopes[:, 1:] * lowest[:, 1]
    fall = DIP_M + (lowest[:, 0] ** 2 + lowest[:, 1] ** 2) / (2 * CREST_M)
    lower = np.sort(z + fall, axis=1)
    z.sort(axis=1)
    num, begin = best_bands(z, lower, band_m)
    best = int(np.argmax(num))
    plane = Plane(float(slopes[best, 0]), float(slopes[best, 1]), float(z[best, begin[best]] + band_m / 2))
    for band_m in (0.6, 0.4, 0.3, 0.2, 0.2):
        plane = _refine(plane, lowest, band_m)
    return plane


def tilts(params: GroundParams) -> Float64:
    """Slopes (81, 2) along x and y of planes up to the steepest one, the flattest first."""
    steps = np.linspace(-params.max_tilt, params.max_tilt, 9)
    return np.array(sorted(((a, b) for a in steps for b in steps), key=lambda t: (t[0] ** 2 + t[1] ** 2, t)))


def _refine(plane: Plane, lowest: Float64, band_m: float) -> Plane:
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


def height_above_ground(
    xyz: Float64, is_near: Bool, cell: Int64, lowest: Float64, plane: Plane, params: GroundParams
) -> Float64:
    """Height (N,) [m] of all points above the highest surface under `lowest` (M, 3) that keeps to `max_slope`; `cell`
    (K, 2) are the cells of the near ones.

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
    return heights(xyz, is_near, cell + half, shape, surface)
