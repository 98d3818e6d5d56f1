"""Compiled: the last resort, that nobody ever touches another."""

import numpy as np

from fbench.datasets.city.traffic.network import Network
from fbench.datasets.city.traffic.path_kernel import poses
from fbench.datasets.city.traffic.state import EMERGENCY, State
from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel

_MARGIN_M = 0.05


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
def _by_x(at: Float64) -> Array:
    """Rows in ascending x: an insertion sort, because compiling numpy's takes seconds."""
    order = np.empty(len(at), np.int64)
    for i in range(len(at)):
        row = i
        while row > 0 and at[order[row - 1], 0] > at[i, 0]:
            order[row] = order[row - 1]
            row -= 1
        order[row] = i
    return order


@kernel
def _near_pairs(now: Float64, at: Float64, sizes: Float64) -> Array:
    """Pairs (M, 2) of bodies that may touch, whether they go on from `now` to `at` (N, 9) or stay."""
    order = _by_x(at)
    reach, longest = np.empty(len(at)), 0.0
    for i in range(len(at)):
        gone = np.sqrt((at[i, 0] - now[i, 0]) ** 2 + (at[i, 1] - now[i, 1]) ** 2)
        reach[i] = 0.5 * np.sqrt(sizes[i, 0] * sizes[i, 0] + sizes[i, 1] * sizes[i, 1]) + gone + _MARGIN_M
        longest = max(longest, reach[i])
    found = np.empty((len(at) * 16, 2), np.int64)
    num = 0
    for m in range(len(order)):
        i = order[m]
        for n in range(m + 1, len(order)):
            j = order[n]
            if at[j, 0] - at[i, 0] > reach[i] + longest or num == len(found):
                break
            if at[j, 0] - at[i, 0] < reach[i] + reach[j] and abs(at[j, 1] - at[i, 1]) < reach[i] + reach[j]:
                found[num, 0], found[num, 1] = i, j
                num += 1
    return found[:num]


@kernel
def stop_before_touching(net: Network, state: State, sizes: Float64, step_s: float) -> None:
    """Stop at once who would touch another within the step: whoever is behind, else who has the higher number."""
    now, then = poses(net, state, 0.0), poses(net, state, step_s)
    pairs = _near_pairs(now, then, sizes)
    changed = True
    while changed:
        changed = False
        for m in range(len(pairs)):
            i, j = pairs[m, 0], pairs[m, 1]
            if state.movers[i]["frozen"] and state.movers[j]["frozen"]:
                continue
            margin = 0.0 if state.movers[i]["frozen"] or state.movers[j]["frozen"] else _MARGIN_M
            if not overlaps(then[i], then[j], sizes[i], sizes[j], margin):
                continue
            who = _yields(state, now, i, j)
            state.movers[who]["frozen"] = True
            state.movers[who]["braking"] = True
            then[who] = now[who]
            if state.movers[who]["speed_mps"] > 0.3:
                state.counters[EMERGENCY] += 1
            changed = True


@kernel
def _yields(state: State, now: Float64, i: int, j: int) -> int:
    if state.movers[i]["frozen"] or state.movers[j]["frozen"]:
        return j if state.movers[i]["frozen"] else i
    dx, dy = now[j, 0] - now[i, 0], now[j, 1] - now[i, 1]
    i_sees = dx * np.cos(now[i, 6]) + dy * np.sin(now[i, 6])
    j_sees = -dx * np.cos(now[j, 6]) - dy * np.sin(now[j, 6])
    if (i_sees > 0.0) != (j_sees > 0.0):
        return i if i_sees > 0.0 else j
    return max(i, j)
