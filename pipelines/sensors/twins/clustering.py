"""Twin of `points.dbscan`, and connected components for other twins."""

import itertools

import torch
from torch import Tensor

_EDGE = 1.25
"""Edge of a cell, as a multiple of the largest radius: rounding never takes neighbors more than one cell apart, up to
1e14 radii from the origin.
"""


def dbscan(points: Tensor, eps: float | Tensor, min_points: int) -> Tensor:
    """Cluster finite points (N, 1 to 3), float64: the numbers (N,) that `points.dbscan.dbscan` gives, -1 for noise.

    Points are compared with those of neighboring rows of cells whose last coordinate is near. The results are equal on
    every device: distances are sums of the same products, and everything else is integers.
    """
    num, order = len(points), lexicographic(points)
    result = torch.full((num,), -1, dtype=torch.int64, device=points.device)
    if not num:
        return result
    rows = points[order]  # from here on, the number of a point is its rank
    radius = torch.as_tensor(eps, dtype=torch.float64, device=points.device).expand(num)[order]
    one, other = _pairs(rows, radius)
    core = torch.bincount(one, minlength=num) >= min_points
    linked = core[one] & core[other]
    root = components(num, one[linked], other[linked])  # the smallest core point of each cluster
    number = torch.where(core, torch.searchsorted(torch.unique(root[core]), root), -1)
    # A point that isn't core goes to the lowest cluster with a core point beside it.
    border = ~core[one] & core[other]
    lowest = torch.full_like(number, num).scatter_reduce_(0, one[border], number[other[border]], "amin")
    result[order] = torch.where(~core & (lowest < num), lowest, number)
    return result


def components(num: int, one: Tensor, other: Tensor) -> Tensor:
    """Lowest number (N,) among what each is linked to, directly or by others. Takes links (P,), (P,), each in both
    directions. Numbers spread over links, and along what they name (Shiloach and Vishkin, Journal of Algorithms 1982).
    """
    label = torch.arange(num, device=one.device)
    while True:
        lower = label.scatter_reduce(0, one, label[other], "amin")
        lower = lower.scatter_reduce(0, label, lower, "amin")  # what names a point tells it of lower numbers
        jumped = lower[lower]
        if torch.equal(jumped, label):
            return label
        label = jumped


def _pairs(rows: Tensor, radius: Tensor) -> tuple[Tensor, Tensor]:
    """Neighbors (P,), (P,), each pair in both directions, a point as its own neighbor, too."""
    num, axes = rows.shape
    largest, last = radius.max(), rows[:, -1].contiguous()
    cells = [_close_gaps(torch.floor(rows[:, axis] / (largest * _EDGE))) for axis in range(axes - 1)]
    line = torch.zeros_like(last, dtype=torch.int64)
    for cell in cells:
        line = line * (2 * num + 2) + cell
    # A key orders points by their line of cells, then by the last coordinate.
    ordered, by_last = torch.sort(last)
    rank = torch.empty_like(by_last)
    rank[by_last] = torch.arange(num, device=rows.device)
    key, by_key = torch.sort(line * num + rank)
    reach = radius * (1 + 1e-9) + last.abs() * 1e-15  # distances are rounded, too
    low, high = torch.searchsorted(ordered, last - reach), torch.searchsorted(ordered, last + reach, right=True)
    found = []
    for steps in itertools.product((-1, 0, 1), repeat=axes - 1):
        beside = torch.zeros_like(line)
        for cell, step in zip(cells, steps, strict=True):
            beside = beside * (2 * num + 2) + cell + step
        begin, end = torch.searchsorted(key, beside * num + low), torch.searchsorted(key, beside * num + high)
        count = (end - begin).clamp_(min=0)
        one = torch.repeat_interleave(torch.arange(num, device=rows.device), count)
        before = count.cumsum(0) - count
        other = by_key[begin[one] + torch.arange(len(one), device=rows.device) - before[one]]
        total = torch.zeros(len(one), dtype=torch.float64, device=rows.device)
        for axis in range(axes):
            off = rows[one, axis] - rows[other, axis]
            total += off * off
        near = total <= torch.minimum(radius[one], radius[other]) ** 2
        found.append(torch.stack([one[near], other[near]]))
    one, other = torch.cat(found, 1)
    return one, other


def _close_gaps(cell: Tensor) -> Tensor:
    """Numbers (N,) from 1 on that differ by one where cells do, and by two where cells are farther apart."""
    unique, inverse = torch.unique(cell, return_inverse=True)
    step = torch.diff(unique, prepend=unique[:1] - 1).clamp(max=2).long()
    return step.cumsum(0)[inverse]


def lexicographic(points: Tensor) -> Tensor:
    """Order (N,) of points (N, D)."""
    order = torch.arange(len(points), device=points.device)
    for axis in range(points.shape[1] - 1, -1, -1):
        order = order[torch.sort(points[order, axis], stable=True).indices]
    return order
