"""Constant false alarm rate (CFAR) detection along range, on power in decibels.

The LOG/CFAR: a cell is a target where it exceeds the mean of the logarithmic power of the cells around it by a
constant, whatever that mean is: V. G. Hansen and H. R. Ward, "Detection Performance of the Cell Averaging LOG/CFAR
Receiver", IEEE Trans. Aerospace and Electronic Systems 8(5), 1972. Guard cells keep a target out of its own mean: M. A.
Richards, "Fundamentals of Radar Signal Processing", chapter on CFAR.
"""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Array, Bool, Float32, Int64
from fbench.replay.errors import ConfigError

_MOST = 100_000


@dataclass(frozen=True)
class CfarParams:
    """Parameters of the CFAR; the unit of power is that of the image, a grey value."""

    guard: int = 15
    """Cells left out on either side of the one under test; half a car's length, so that a car isn't its own clutter."""
    training: int = 20
    """Cells averaged on either side beyond the guard cells; fewer at the ends of the range."""
    threshold: float = 40.0
    """How far a target exceeds the mean of the training cells."""
    min_range_m: float = 4.0
    """Nearer cells show the own car."""
    peak_only: bool = True
    """Keep only cells above their nearer and not below their farther neighbour along range."""
    max_points: int = 10_000
    """Of more targets those that exceed the mean by most are kept."""

    def __post_init__(self) -> None:
        for name, value, least in (
            ("guard", self.guard, 0),
            ("training", self.training, 1),
            ("max_points", self.max_points, 0),
        ):
            if not least <= value <= _MOST:
                raise ConfigError(f"cfar.{name}={value}: expected {least} to {_MOST}")
        if not (np.isfinite(self.threshold) and 0 <= self.min_range_m < np.inf):
            raise ConfigError(
                f"cfar.threshold={self.threshold}, cfar.min_range_m={self.min_range_m}: expected finite numbers, and a "
                "range that isn't negative"
            )


def detect(power: Array, range_step_m: float, params: CfarParams) -> tuple[Int64, Int64]:
    """Find targets in an image (R, A) of power: a row a range cell, row r at `range_step_m * r`, a column an azimuth.

    Returns:
        Rows and columns (N,) of the targets, by column, then row.
    """
    excess = power - clutter(power, params.guard, params.training)
    found = excess > params.threshold
    found[: int(np.ceil(params.min_range_m / range_step_m))] = False
    if params.peak_only:
        found &= _peaks(power)
    columns, rows = np.nonzero(found.T)
    if len(rows) > params.max_points:
        strongest = np.sort(np.argsort(-excess[rows, columns], kind="stable")[: params.max_points])
        rows, columns = rows[strongest], columns[strongest]
    return rows, columns


def clutter(power: Array, guard: int, training: int) -> Float32:
    """Mean power (R, A) of the training cells of each cell; infinite where it has none."""
    sums, cells = (_around(of, guard, training) for of in (power, np.ones((len(power), 1), power.dtype)))
    with np.errstate(divide="ignore", invalid="ignore"):
        mean: Float32 = sums / cells
    mean[cells[:, 0] == 0] = np.inf
    return mean


def _around(cells: Array, guard: int, training: int) -> Float32:
    """Sums (R, A) of the training cells; exact, since grey values of a column sum to less than 2^24."""
    wide, narrow = (_sums(cells, min(reach, len(cells))) for reach in (guard + training, guard))
    around: Float32 = wide - narrow
    return around


def _sums(cells: Array, reach: int) -> Float32:
    """Sums (R, A) over `reach` cells on either side and the cell itself, along range."""
    import cv2

    size = (1, 2 * reach + 1)
    return np.asarray(cv2.boxFilter(cells, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_CONSTANT))


def _peaks(power: Array) -> Bool:
    peaks: Bool = np.ones(power.shape, bool)
    peaks[1:] &= power[1:] > power[:-1]
    peaks[:-1] &= power[:-1] >= power[1:]
    return peaks
