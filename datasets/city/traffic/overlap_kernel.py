"""Compiled: the last resort, that nobody ever touches another."""

import numpy as np

from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel

MARGIN_M = 0.05
_DRIVES_MPS = 0.3
"""Who is slower hardly notices that it is stopped."""


@kernel
def overlaps(p: Float64, q: Float64, size_p: Float64, size_q: Float64, margin: float) -> bool:
    """Whether two footprints (poses and length, width) are nearer than a margin: no axis separates them."""
    dx, dy = q[0] - p[0], q[1] - p[1]
    reach = size_p[0] + size_p[1] + size_q[0] + size_q[1] + 2 * margin
    if 4 * (dx * dx + dy * dy) > reach * reach:
        return False
    cp, sp, cq, sq = np.cos(p[6]), np.sin(p[6]), np.cos(q[6]), np.sin(q[6])
    cos, sin = abs(cp * cq + sp * sq), abs(cp * sq - sp * cq)
    lp, wp, lq, wq = 0.5 * size_p[0] + margin, 0.5 * size_p[1] + margin, 0.5 * size_q[0], 0.5 * size_q[1]
    holds: bool = (
        abs(dx * cp + dy * sp) < lp + lq * cos + wq * sin
        and abs(dy * cp - dx * sp) < wp + lq * sin + wq * cos
        and abs(dx * cq + dy * sq) < lq + lp * cos + wp * sin
        and abs(dy * cq - dx * sq) < wq + lp * sin + wp * cos
    )
    return holds


@kernel
def stop_before_touching(movers: Array, now: Float64, then: Float64, sizes: Float64, pairs: Array) -> int:
    """Stop at once who would touch another within the step: whoever is behind, else who has the higher number.

    `now` and `then` (N, 9) are poses at the step's beginning and end; rows of `then` become those of `now` for who is
    stopped. `pairs` (M, 2) are those of `near_pairs`. Returns how many of those who were stopped drove.
    """
    num, changed = 0, True
    while changed:
        changed = False
        for m in range(len(pairs)):
            i, j = pairs[m, 0], pairs[m, 1]
            if movers[i]["frozen"] and movers[j]["frozen"]:
                continue
            margin = 0.0 if movers[i]["frozen"] or movers[j]["frozen"] else MARGIN_M
            if not overlaps(then[i], then[j], sizes[i], sizes[j], margin):
                continue
            who = _yields(movers, now, i, j)
            movers[who]["frozen"] = True
            movers[who]["braking"] = True
            for k in range(now.shape[1]):  # an assignment of the row takes a second more to compile
                then[who, k] = now[who, k]
            if movers[who]["speed_mps"] > _DRIVES_MPS:
                num += 1
            changed = True
    return num


@kernel
def _yields(movers: Array, now: Float64, i: int, j: int) -> int:
    if movers[i]["frozen"] or movers[j]["frozen"]:
        return j if movers[i]["frozen"] else i
    dx, dy = now[j, 0] - now[i, 0], now[j, 1] - now[i, 1]
    i_sees = dx * np.cos(now[i, 6]) + dy * np.sin(now[i, 6])
    j_sees = -dx * np.cos(now[j, 6]) - dy * np.sin(now[j, 6])
    if (i_sees > 0.0) != (j_sees > 0.0):
        return i if i_sees > 0.0 else j
    return max(i, j)
