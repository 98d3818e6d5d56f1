"""Each result, best score first, gets the nearest truth box that is free."""

import math

import numpy as np

from fbench.replay.arrays import Array, Bool, Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def match_nearest(
    truth_xy: Float64,
    truth_start: Int64,
    estimate_xy: Float64,
    estimate_start: Int64,
    invalid: Bool,
    limits_m: Float64,
) -> Array:
    """Return the truth row (M, D) of each estimate at each of D largest distances, -1 where there is none.

    Args:
        truth_xy: (N, 2) centres [m], sorted by group (one class of one sample); the first of equally near ones wins.
        truth_start: (G + 1,) offsets of the groups.
        estimate_xy: (M, 2) centres [m], sorted by group, then best score first.
        estimate_start: (G + 1,)
        invalid: (M,) estimates that match nothing.
        limits_m: (D,) pairs match below this distance.
    """
    partner, taken = np.empty((len(estimate_xy), len(limits_m)), np.int64), np.empty(len(truth_xy), np.bool_)
    for d in range(len(limits_m)):
        for t in range(len(taken)):
            taken[t] = False
        for group in range(len(truth_start) - 1):
            for e in range(estimate_start[group], estimate_start[group + 1]):
                partner[e, d] = -1
                if invalid[e]:
                    continue
                nearest, best_m = -1, limits_m[d]
                for t in range(truth_start[group], truth_start[group + 1]):
                    if taken[t]:
                        continue
                    dx, dy = estimate_xy[e, 0] - truth_xy[t, 0], estimate_xy[e, 1] - truth_xy[t, 1]
                    distance_m = math.sqrt(dx * dx + dy * dy)
                    if distance_m < best_m:
                        nearest, best_m = t, distance_m
                if nearest >= 0:
                    taken[nearest] = True
                    partner[e, d] = nearest
    return partner
