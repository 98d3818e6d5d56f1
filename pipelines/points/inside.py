"""Points in rectangles seen from above, without comparing all with all."""

import numpy as np

from fbench.pipelines.points.inside_kernel import points_inside
from fbench.replay.arrays import Float64


class SortedPoints:
    """Points by x, so that only those between the least and greatest x of a rectangle are looked at."""

    def __init__(self, points: Float64) -> None:
        """Take points (N, 3): x and y [m], and what is asked for about them, such as heights."""
        self._points = np.ascontiguousarray(points[np.argsort(points[:, 0], kind="stable")])

    def inside(self, rectangles: Float64, margin_m: float) -> Float64:
        """Count the points in each rectangle (M, 5 or more), as `fit_rectangles` gives them, widened by a margin [m],
        and find the highest third coordinate of them, -inf where there are none: (M, 2).
        """
        wide = np.column_stack([rectangles[:, 0], rectangles[:, [1, 3]] - margin_m, rectangles[:, [2, 4]] + margin_m])
        cos, sin = np.cos(wide[:, :1]), np.sin(wide[:, :1])
        x = cos * wide[:, [1, 1, 3, 3]] - sin * wide[:, [2, 4, 2, 4]]
        # A hair more than needed, so that rounding leaves no point out.
        begin = np.searchsorted(self._points[:, 0], x.min(axis=1) - 1e-6)
        end = np.searchsorted(self._points[:, 0], x.max(axis=1) + 1e-6)
        return points_inside(wide, self._points, begin, end)
