"""What clusters of a LiDAR are like, in numbers that tell road users from other things."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.points.inside import SortedPoints
from fbench.replay.arrays import Float64, Int64

FEATURES = (
    "length_m", "width_m", "top_m", "reach_m", "bottom_m", "log2_points", "filling_m", "upper_share", "over_share",
    "near_share",
)  # fmt: skip
"""Names of the columns of `features`:

- length_m, width_m: longer and shorter edge of the rectangle around the cluster [m]
- top_m: height above ground of the highest point in the cluster or over its rectangle [m]
- reach_m: top_m plus the widest gap [m] between heights of the cluster's points, from the ground up: between sparse
  beams it may be higher than it was seen to be
- bottom_m: height of its lowest point [m]
- log2_points: logarithm of the number of points to base 2
- filling_m: mean distance of the points from the nearest edge of the rectangle [m]: vegetation fills it
- upper_share: share of the points above the middle between the lowest and the highest
- over_share: of the cluster's points and those over its rectangle, the share of the latter: poles and trees go on
- near_share: of all points on and beside its rectangle, the share of others: parts of something larger have neighbours
"""
_OVER_MARGIN_M = 0.3
_NEAR_MARGIN_M = 0.6


@dataclass(frozen=True, eq=False)
class Standing:
    """What stands on the ground."""

    xy_height: Float64
    """(N, 3) x and y in body coordinates and height above ground [m], sorted by cluster, those of none first."""
    first: Int64
    """(M + 1,) rows where the clusters begin, and the end."""
    tall: Float64
    """(K, 3) the same of points above the height up to which they are clustered."""


def features(standing: Standing, rectangles: Float64) -> Float64:
    """Describe clusters by `FEATURES` (M, F); `rectangles` (M, 6) are those of `fit_rectangles`."""
    first = standing.first
    num = np.diff(first).astype(np.float64)
    height = standing.xy_height[first[0] :, 2]
    begin = first[:-1] - first[0]
    bottom, top = np.minimum.reduceat(height, begin), np.maximum.reduceat(height, begin)
    upper = np.add.reduceat((height > np.repeat((bottom + top) / 2, np.diff(first))).astype(np.float64), begin)
    extent = np.sort(rectangles[:, [2, 4]] - rectangles[:, [1, 3]], axis=1)
    over = SortedPoints(standing.tall).inside(rectangles, _OVER_MARGIN_M)
    near = SortedPoints(standing.xy_height).inside(rectangles, _NEAR_MARGIN_M)[:, 0]
    highest = np.maximum(top, over[:, 1])
    columns = (
        extent[:, 1], extent[:, 0], highest, highest + _widest_gaps(height, begin), bottom, np.log2(num),
        rectangles[:, 5], upper / num, over[:, 0] / (over[:, 0] + num), 1.0 - num / np.maximum(near, num),
    )  # fmt: skip
    return np.column_stack(columns)


def _widest_gaps(height: Float64, begin: Int64) -> Float64:
    """Widest gap (M,) between neighbouring ones of 0 and the heights (N,) of each cluster [m]."""
    cluster = np.repeat(np.arange(len(begin)), np.diff(begin, append=len(height)))
    ordered = height[np.lexsort((height, cluster))]
    gap = np.diff(ordered, prepend=0.0)
    gap[begin] = ordered[begin]
    widest: Float64 = np.maximum.reduceat(gap, begin)
    return widest
