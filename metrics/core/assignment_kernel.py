"""Compiled assignment: rectangular linear assignment, greedy matching, all steps at once."""

import numpy as np

from fbench.metrics.core.similarity import Blocks
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.geometry.kernels import kernel


@kernel
def assign(cost: Float64, without: float) -> Int64:  # noqa: C901  # apart it compiles twice as long
    """Return the column (n,) of each row, -1 for rows without one, such that the costs (n, m) sum up to the least.

    min(n, m) pairs are made. Those with an infinite cost count as `without`, and are then taken apart again.
    Where no row and no column has two finite costs, these are the pairs, whatever they cost.

    Shortest augmenting paths, David F. Crouse, "On implementing 2D rectangular assignment algorithms", IEEE TAES
    52(4), 2016. Ties are broken as scipy 1.17's `linear_sum_assignment` breaks them, on which the reference tools are
    built: rows enter in their order, the wider side is searched from its end, and free columns go before taken ones.
    """
    n, m = cost.shape
    height, width = (n, m) if n <= m else (m, n)
    column_of, row_of, is_lonely = np.empty(n, np.int64), np.empty(width, np.int64), True
    wide = np.empty((height, width))  # no higher than wide
    for j in range(width):
        row_of[j] = -1
    for i in range(n):
        own = -1
        for j in range(m):
            value = cost[i, j]
            if value < np.inf:
                is_lonely = is_lonely and own < 0 and row_of[j] < 0
                own, row_of[j] = j, i
            else:
                value = without
            if n <= m:
                wide[i, j] = value
            else:
                wide[j, i] = value
        column_of[i] = own
    if is_lonely:
        return column_of

    row_price, partner = np.empty(height), np.empty(height, np.int64)
    column_price, reach = np.empty(width), np.empty(width)
    parent, rest = np.empty(width, np.int64), np.empty(width, np.int64)
    for i in range(height):
        row_price[i], partner[i] = 0.0, -1
    for j in range(width):
        column_price[j], row_of[j] = 0.0, -1
    for start in range(height):
        for j in range(width):
            rest[j], reach[j] = width - 1 - j, np.inf
        length, row, left, end = 0.0, start, width, -1
        while row >= 0:  # until the nearest free column; settled ones are moved to the end of `rest`
            best, lowest, price = -1, np.inf, row_price[row]
            for k in range(left):
                j = rest[k]
                far, through = reach[j], length + wide[row, j] - price - column_price[j]
                if through < far:
                    parent[j], reach[j], far = row, through, through
                if far < lowest or (far == lowest and row_of[j] < 0):
                    lowest, best = far, k
            end, length, left = rest[best], lowest, left - 1
            rest[best], rest[left] = rest[left], end
            row = row_of[end]
        row_price[start] += length
        for k in range(left, width):
            j = rest[k]
            rise = length - reach[j]
            column_price[j] -= rise
            if j != end:
                row_price[row_of[j]] += rise
        while row != start:
            row = parent[end]
            j = end
            end = partner[row]
            row_of[j], partner[row] = row, j

    for i in range(n):
        j = partner[i] if n <= m else row_of[i]
        column_of[i] = j if j >= 0 and cost[i, j] < np.inf else -1
    return column_of


@kernel
def best_places(
    row_start: Int64, column_start: Int64, block_start: Int64, score: Float64, floor: float, offset: float
) -> Int64:
    """Return the place in `score` of the pair of each row (N,), such that scores plus `offset` sum up to the most.

    That is in each step for itself. -1 for rows without a pair; one that would add 0 or less isn't made, nor one whose
    score (B,) is below `floor`. Any pair is worth `offset` more. Offsets of steps are (S + 1,).
    """
    place = np.empty(row_start[-1], np.int64)
    for step in range(len(row_start) - 1):
        first, b = row_start[step], block_start[step]
        n, m = row_start[step + 1] - first, column_start[step + 1] - column_start[step]
        cost = np.empty((n, m))
        for i in range(n):
            for j in range(m):
                value = score[b + i * m + j]
                gain = value + offset
                cost[i, j] = -gain if value >= floor and gain > 0.0 else np.inf
        column_of = assign(cost, 0.0)
        for i in range(n):
            place[first + i] = b + i * m + column_of[i] if column_of[i] >= 0 else -1
    return place


@kernel
def best_rows(  # noqa: C901  # apart it compiles twice as long
    row_start: Int64, column_start: Int64, block_start: Int64, score: Float64, floor: float, favored: Bool
) -> Int64:
    """Row (M,) of each column, -1 without one: in each step as many pairs as there can be, of these those with most
    favored columns (M,), of these those with the highest total. A pair needs a score of `floor`.
    """
    row_of = np.empty(column_start[-1], np.int64)
    for j in range(len(row_of)):
        row_of[j] = -1
    for step in range(len(row_start) - 1):
        first, left, b = row_start[step], column_start[step], block_start[step]
        n, m = row_start[step + 1] - first, column_start[step + 1] - left
        low, high, competes = np.inf, -np.inf, False
        for i in range(n):
            has_other = False
            for j in range(m):
                value = score[b + i * m + j]
                if value >= floor:
                    competes = competes or has_other or row_of[left + j] >= 0
                    has_other, row_of[left + j] = True, first + i
                    low, high = min(low, value), max(high, value)
        if not competes:
            continue
        # Three ranks in one number: k pairs sum to at most k in quality and k * weight in favor, k < weight.
        cost, weight, span = np.empty((n, m)), min(n, m) + 1.0, high - low if high > low else 1.0
        for i in range(n):
            for j in range(m):
                value = score[b + i * m + j]
                rank = weight * weight + weight * favored[left + j] + (value - low) / span
                cost[i, j] = -rank if value >= floor else np.inf
        column_of = assign(cost, 0.0)
        for j in range(m):
            row_of[left + j] = -1
        for i in range(n):
            if column_of[i] >= 0:
                row_of[left + column_of[i]] = first + i
    return row_of


def partners(pairs: Blocks, floor: float, offset: float) -> Int64:
    """Return for each estimate (M,) the truth row with which it makes the best pair of its step, -1 without one.

    Pairs need a similarity of `floor`; they are chosen so that similarity plus `offset` sums up to the most.
    """
    place = best_places(pairs.row_start, pairs.column_start, pairs.start, pairs.values, floor, offset)
    truth, estimate = pairs.locate(place[place >= 0])
    truth_of = np.full(pairs.shape[1], -1, np.int64)
    truth_of[estimate] = truth
    return truth_of


@kernel
def greedy_blocks(
    similarity: Float64, truth_start: Int64, estimate_start: Int64, block_start: Int64, order: Int64, floors: Float64,
    strict: bool, rank: Int64, shared: Bool,
) -> Int64:  # fmt: skip
    """Let estimates choose truth one after the other; returns truth rows (T, M), -1 where there is none.

    See `fbench.metrics.core.matching.match_greedily`.
    """
    partner, taken = np.empty((len(floors), len(order)), np.int64), np.empty(len(rank), np.bool_)
    for f in range(len(floors)):
        for e in range(len(order)):
            partner[f, e] = -1
        for t in range(len(taken)):
            taken[t] = False
        for s in range(len(block_start) - 1):
            first, last = truth_start[s], truth_start[s + 1]
            width = estimate_start[s + 1] - estimate_start[s]
            for place in range(estimate_start[s], estimate_start[s + 1]):
                e = order[place]
                best, best_similarity = -1, 0.0
                for t in range(first, last):
                    value = similarity[block_start[s] + (t - first) * width + e - estimate_start[s]]
                    free = shared[t] or not taken[t]
                    near = value > floors[f] if strict else value >= floors[f]
                    if free and near:
                        better = best < 0 or rank[t] < rank[best]
                        if better or (rank[t] == rank[best] and value > best_similarity):
                            best, best_similarity = t, value
                if best >= 0:
                    taken[best] = True
                    partner[f, e] = best
    return partner


@kernel
def first_come(rows: Int64, columns: Int64, num_rows: int, num_columns: int) -> Int64:
    """Return the row (M,) of each column, -1 where it has none: a pair (P,) is taken where both are still free."""
    taken, row_of = np.empty(num_rows, np.bool_), np.empty(num_columns, np.int64)
    for i in range(num_rows):
        taken[i] = False
    for j in range(num_columns):
        row_of[j] = -1
    for k in range(len(rows)):
        row, column = rows[k], columns[k]
        if not taken[row] and row_of[column] < 0:
            taken[row] = True
            row_of[column] = row
    return row_of
