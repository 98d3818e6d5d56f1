"""How much a LiDAR cluster looks like a passenger car."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fbench.pipelines.checks import require_between
from fbench.pipelines.points.inside import SortedPoints
from fbench.pipelines.points.vehicle import fading
from fbench.replay.arrays import Float64, Int64
from fbench.replay.errors import ConfigError

_RISING = ("bottom_m", "top_m", "most_length_m", "most_width_m", "filling_m", "num_over")
_FALLING = ("least_extent_m", "num_points")
_LEAST_STEP = 1e-6


@dataclass(frozen=True)
class CarShapeParams:
    """What a cluster must be like; in each pair, values from the first on are fine, from the second on impossible."""

    bottom_m: tuple[float, float] = (0.75, 1.1)
    """Height of the lowest point [m]: cars stand on the ground, but LiDARs look between rings."""
    top_m: tuple[float, float] = (2.1, 2.5)
    """Height of the highest point [m]."""
    least_extent_m: tuple[float, float] = (1.3, 0.8)
    """Longer edge [m] where only a part is seen."""
    most_length_m: tuple[float, float] = (5.2, 6.5)
    """Longer edge [m]."""
    most_width_m: tuple[float, float] = (2.0, 2.5)
    """Shorter edge [m]."""
    filling_m: tuple[float, float] = (0.12, 0.25)
    """Mean distance of the points from the nearest edge [m]: vegetation fills its rectangle."""
    num_points: tuple[float, float] = (10.0, 4.0)
    """Number of points: a handful is too few to tell."""
    num_over: tuple[float, float] = (0.0, 4.0)
    """Number of points above the height of cars: poles, walls and trees go on."""
    margin_m: float = 0.3
    """How far beside the rectangle points count as above it [m]."""
    where: ClassVar[str] = "lidar.shape"
    """Dotted name of these parameters."""

    def __post_init__(self) -> None:
        require_between(f"{self.where}.margin_m", self.margin_m, 0, 100)
        for name in (*_RISING, *_FALLING):
            for value in getattr(self, name):
                require_between(f"{self.where}.{name}", value, 0)
        for name, sign, word in (*((n, 1, "above") for n in _RISING), *((n, -1, "below") for n in _FALLING)):
            fine, impossible = getattr(self, name)
            if not sign * (impossible - fine) >= _LEAST_STEP:
                raise ConfigError(
                    f"{self.where}.{name}: expected a second value {word} the first, got {fine:g},{impossible:g}"
                )


def plausibility(
    rectangles: Float64, num_points: Int64, bottom_m: Float64, top_m: Float64, tall: Float64, params: CarShapeParams
) -> Float64:
    """Score clusters in [0, 1], as the product of all that is known about cars.

    Takes rectangles (M, 6) as `fit_rectangles` gives them, counts and heights (M,) of the points in them, and the
    points `tall` (N, 3) [m] above the height of cars.
    """
    extent = np.sort(rectangles[:, [2, 4]] - rectangles[:, [1, 3]], axis=1)
    score: Float64 = fading(bottom_m, *params.bottom_m) * fading(top_m, *params.top_m)
    score *= fading(extent[:, 1], *params.least_extent_m) * fading(extent[:, 1], *params.most_length_m)
    score *= fading(extent[:, 0], *params.most_width_m)
    score *= fading(rectangles[:, 5], *params.filling_m) * fading(num_points, *params.num_points)
    likely = np.flatnonzero(score > 0)
    score[likely] *= fading(SortedPoints(tall).inside(rectangles[likely], params.margin_m)[:, 0], *params.num_over)
    return score
