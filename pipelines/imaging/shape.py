"""How much a group of points looks like a vehicle, and where that vehicle's middle is."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.imaging.cloud import Cloud
from fbench.pipelines.imaging.params import ShapeParams
from fbench.pipelines.points.rectangle_kernel import NEAR_M, fit_rectangles
from fbench.pipelines.points.vehicle import VehicleSize, complete, fading
from fbench.replay.arrays import Bool, Float64, Int64

_HEADINGS_RAD = np.radians(np.arange(0.0, 90.0, 3.0))
_OVER_MARGIN_M = 0.3
_CAR = VehicleSize()


@dataclass(frozen=True, eq=False)
class Groups:
    """M groups of points, one after another."""

    cloud: Cloud
    """Their points (N)."""
    first: Int64
    """(M + 1,) rows where groups begin, and the end."""
    rectangles: Float64
    """(M, 6) around them as seen from above, as `fit_rectangles` gives them."""

    @classmethod
    def of(cls, cloud: Cloud, cluster: Int64) -> "Groups":
        """Groups of points whose clusters (N,) ascend from 0."""
        first = np.append(np.flatnonzero(np.diff(cluster, prepend=-1)), len(cluster))
        return cls(cloud, first, fit_rectangles(np.ascontiguousarray(cloud.xyz[:, :2]), first, _HEADINGS_RAD, NEAR_M))

    def __len__(self) -> int:
        return len(self.first) - 1

    @property
    def top_m(self) -> Float64:
        """(M,) height above ground of the highest point [m]."""
        return np.asarray(np.maximum.reduceat(self.cloud.height_m, self.first[:-1]), np.float64)

    @property
    def bottom_m(self) -> Float64:
        """(M,) the same of the lowest point."""
        return np.asarray(np.minimum.reduceat(self.cloud.height_m, self.first[:-1]), np.float64)

    @property
    def moves(self) -> Bool:
        """(M,) whether their points move."""
        return np.asarray(self.cloud.moves[self.first[:-1]], np.bool_)


@dataclass(frozen=True, eq=False)
class Whole:
    """M whole vehicles in body coordinates."""

    center_m: Float64
    """(M, 3) [m]."""
    size_lwh_m: Float64
    """(M, 3) length, width, height [m]."""


def footprints(groups: Groups) -> Whole:
    """Complete what is seen of each group to a vehicle that stands on the ground."""
    cloud = groups.cloud
    whole = complete(groups.rectangles, cloud.viewpoint, _CAR)
    height = np.maximum(groups.top_m, _CAR.height_m)
    ground = np.zeros(len(groups)) if cloud.plane is None else cloud.plane.z_m(whole.center_m)
    center = np.column_stack([whole.center_m, ground + height / 2])
    return Whole(center, np.column_stack([whole.size_lw_m, height]))


def likeness(groups: Groups, params: ShapeParams) -> Float64:
    """Score groups in [0, 1], as the product of all that is known about vehicles.

    Of those that move only their size and number of points are asked: what moves is no wall and no tree.
    """
    shorter, longer = np.sort(groups.rectangles[:, [2, 4]] - groups.rectangles[:, [1, 3]], axis=1).T
    score = fading(np.diff(groups.first), *params.num_points)
    score *= fading(longer, *params.most_length_m) * fading(shorter, *params.most_width_m)
    still = fading(longer, *params.least_extent_m) * fading(groups.rectangles[:, 5], *params.filling_m)
    still *= fading(groups.bottom_m, *params.bottom_m) * fading(groups.top_m, *params.top_m)
    still *= np.where(shorter < params.thin_m, fading(groups.top_m, *params.least_top_m), 1.0)
    score = np.where(groups.moves, score, score * still * params.still)
    likely = np.flatnonzero((score > 0) & ~groups.moves)
    score[likely] *= fading(_num_over(groups.rectangles[likely], groups.cloud.tall), *params.num_over)
    return np.asarray(score, np.float64)


def _num_over(rectangles: Float64, tall: Float64) -> Int64:
    """Count the points (K, 3) over each rectangle (M, 6), widened by a margin."""
    result = np.zeros(len(rectangles), np.int64)
    for at, (heading, low_u, high_u, low_v, high_v, _) in enumerate(rectangles):
        cos, sin, margin = np.cos(heading), np.sin(heading), _OVER_MARGIN_M
        u, v = tall[:, 0] * cos + tall[:, 1] * sin, tall[:, 1] * cos - tall[:, 0] * sin
        over = (u > low_u - margin) & (u < high_u + margin) & (v > low_v - margin) & (v < high_v + margin)
        result[at] = np.count_nonzero(over)
    return result
