"""Compiled occupancy: who is where on each lane, and who is next on one's way."""

from typing import NamedTuple

import numpy as np

from fbench.datasets.city.traffic.network import AXLE, HERE, WINDOW, Roads
from fbench.datasets.city.traffic.path_kernel import nearest_point, neighbor, sideways
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.geometry.kernels import kernel, kernel_part

_BESIDE_M = 0.3  # Who is less than this beside the new lane's middle has left the old one


class Occupancy(NamedTuple):
    """Bodies on lanes, by lane and then along it. A body is on each lane that it reaches into."""

    first: Array  # (L + 1,)
    who: Array
    at_m: Float64  # Its middle, counted from the lane's beginning; may be before it or beyond the end


@kernel_part
def left_side(me: np.void) -> int:
    """On which side of its new lane a mover still is: 1 left, -1 right, 0 neither."""
    rear = me["base_m"] + me["at_m"] - AXLE * me["length_m"]
    rest, _ = sideways((rear - me["side_from_m"]) / me["side_for_m"])
    side = me["side_m"] * rest
    if side > _BESIDE_M:
        return 1
    return -1 if side < -_BESIDE_M else 0


@kernel
def left_sides(movers: Array) -> Array:
    """See `left_side`; (N,)."""
    sides = np.empty(len(movers), np.int64)
    for i in range(len(movers)):
        sides[i] = left_side(movers[i])
    return sides


@kernel
def occupancy(path: Float64, lanes: Array, movers: Array, way: Array) -> Occupancy:
    """Find who is where."""
    num = len(movers)
    most = 2 * num * WINDOW  # each is on a lane once, and on those beside it
    on, whos, ats = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    count = 0
    for i in range(num):
        me = movers[i]
        rear, front = me["at_m"] - 0.5 * me["length_m"], me["at_m"] + 0.5 * me["length_m"]
        side = left_side(me)
        k, offset = HERE, 0.0
        while offset > rear and k > 0:
            k -= 1
            offset -= lanes[way[i, k]]["length_m"]
        while k < WINDOW and offset < front:
            lane = way[i, k]
            on[count], whos[count], ats[count] = lane, i, me["at_m"] - offset
            count += 1
            old = neighbor(lanes[lane], side)
            if side != 0 and old >= 0:
                on[count], whos[count] = old, i
                ats[count] = nearest_point(path, lanes[lane], lanes[old], me["at_m"] - offset)
                count += 1
            offset += lanes[lane]["length_m"]
            k += 1
    first = np.zeros(len(lanes) + 1, np.int64)
    for lane in on[:count]:
        first[lane + 1] += 1
    for lane in range(len(lanes)):
        first[lane + 1] += first[lane]
    filled = np.zeros(len(lanes), np.int64)
    who, at = np.empty(count, np.int64), np.empty(count)
    for n in range(count):
        lane = on[n]
        row = first[lane] + filled[lane]
        while row > first[lane] and at[row - 1] > ats[n]:
            at[row], who[row] = at[row - 1], who[row - 1]
            row -= 1
        at[row], who[row] = ats[n], whos[n]
        filled[lane] += 1
    return Occupancy(first, who, at)


@kernel_part
def next_on(taken: Occupancy, lane: int, s: float, i: int) -> int:
    """Row of the first body beyond `s` on a lane other than `i`, -1 for none."""
    for row in range(taken.first[lane], taken.first[lane + 1]):
        if taken.at_m[row] > s and taken.who[row] != i:
            return row
    return -1


@kernel_part
def last_on(taken: Occupancy, lane: int, s: float, i: int) -> int:
    """Row of the last body up to `s` on a lane other than `i`, -1 for none."""
    for row in range(taken.first[lane + 1] - 1, taken.first[lane] - 1, -1):
        if taken.at_m[row] <= s and taken.who[row] != i:
            return row
    return -1


@kernel
def leader(roads: Roads, movers: Array, way: Array, taken: Occupancy, i: int, far_m: float) -> tuple[float, int]:
    """Net gap to whoever is next on a mover's way (WINDOW,), and who; -1: none."""
    lanes, me = roads.lanes, movers[i]
    best, who, offset = np.inf, -1, 0.0
    for k in range(HERE, WINDOW):
        if offset - me["at_m"] > far_m:
            break
        s = me["at_m"] - offset
        row = next_on(taken, way[k], s, i)
        if row >= 0:
            n = taken.who[row]
            gap = taken.at_m[row] - s - 0.5 * (movers[n]["length_m"] + me["length_m"])
            if gap < best:
                best, who = gap, n
        gap, n = _parting(roads, movers, taken, way[k], s, i)
        if gap < best:
            best, who = gap, n
        if row >= 0:
            break
        offset += lanes[way[k]]["length_m"]
    return best, who


@kernel_part
def leader_on_neighbor(
    roads: Roads, movers: Array, way: Array, taken: Occupancy, i: int, side: int, far_m: float
) -> tuple[float, int]:
    """Net gap to whoever is next on the lanes left (1) or right (-1) of a mover's way, and who; -1: none."""
    lanes, me = roads.lanes, movers[i]
    offset = 0.0
    for k in range(HERE, WINDOW):
        lane = neighbor(lanes[way[k]], side)
        if lane < 0 or offset - me["at_m"] > far_m:
            break
        s = nearest_point(roads.path, lanes[way[k]], lanes[lane], me["at_m"] - offset)
        row = next_on(taken, lane, s, i)
        if row >= 0:
            n = taken.who[row]
            return taken.at_m[row] - s - 0.5 * (movers[n]["length_m"] + me["length_m"]), n
        offset += lanes[way[k]]["length_m"]
    return np.inf, -1


@kernel_part
def _parting(roads: Roads, movers: Array, taken: Occupancy, lane: int, s: float, i: int) -> tuple[float, int]:
    """The next who has just turned off to a lane that begins where this one does."""
    best, who = np.inf, -1
    for m in range(roads.lanes[lane]["split_from"], roads.lanes[lane]["split_to"]):
        other = roads.splits[m]
        for row in range(taken.first[other["lane"]], taken.first[other["lane"] + 1]):
            n, at = taken.who[row], taken.at_m[row]
            if n != i and at > s and at - 0.5 * movers[n]["length_m"] < other["until_m"]:
                gap = at - s - 0.5 * (movers[n]["length_m"] + movers[i]["length_m"])
                if gap < best:
                    best, who = gap, n
    return best, who


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
