"""Which bodies are so near to each other that one has to look whether they touch."""

import numpy as np

from fbench.replay.arrays import Array, Float64


def near_pairs(now: Float64, then: Float64, sizes: Float64, margin_m: float) -> Array:
    """Pairs (M, 2) of bodies that may come nearer than 2 margins, whether they go on from `now` to `then` or stay.

    `now` and `then` (N, 9) are poses, `sizes` (N, 2) lengths and widths. Circles around the bodies, along x and y.
    """
    x, y = then[:, 0], then[:, 1]
    gone = np.sqrt((x - now[:, 0]) ** 2 + (y - now[:, 1]) ** 2)
    reach = 0.5 * np.sqrt(sizes[:, 0] ** 2 + sizes[:, 1] ** 2) + gone + margin_m
    order = np.argsort(x, kind="stable")
    ahead = x[order] + reach[order] + reach.max(initial=0.0) + 1e-6  # nobody beyond it is near, give or take rounding
    num = np.searchsorted(x[order], ahead, side="right") - np.arange(len(x)) - 1
    first = np.repeat(np.arange(len(x)), num)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(num) - num, num)
    i, j = order[first], order[second]
    both = reach[i] + reach[j]
    near = (x[j] - x[i] < both) & (np.abs(y[j] - y[i]) < both)
    return np.ascontiguousarray(np.column_stack([i[near], j[near]]))
