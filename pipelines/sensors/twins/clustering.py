"""Twin of `points.dbscan`."""

import torch
from torch import Tensor

_CHUNK = 1 << 25  # Pairs of points that are compared at once


def dbscan(points: Tensor, eps: float | Tensor, min_points: int) -> Tensor:
    """Cluster finite points (N, 1 to 3), float64: the numbers (N,) that `points.dbscan.dbscan` gives, -1 for noise.

    All pairs are compared, which suits a GPU up to some ten thousand points. The results are equal on every device:
    distances are sums of the same products, and everything else is integers.
    """
    num = len(points)
    number = torch.full((num,), -1, dtype=torch.int64, device=points.device)
    if not num:
        return number
    square = torch.as_tensor(eps, dtype=torch.float64, device=points.device).expand(num) ** 2
    pairs = torch.cat([_pairs(points, square, begin) for begin in range(0, num, max(1, _CHUNK // num))])
    core = torch.bincount(pairs[:, 0], minlength=num) >= min_points
    linked = pairs[core[pairs[:, 0]] & core[pairs[:, 1]]]
    rank = torch.empty_like(number)
    rank[_lexicographic(points)] = torch.arange(num, device=points.device)
    root = _components(torch.where(core, rank, num), linked)  # rank of the smallest core point of each cluster
    roots = torch.unique(root[core])
    number[core] = torch.searchsorted(roots, root[core])
    # A point that isn't core goes to the lowest cluster with a core point beside it.
    border = pairs[~core[pairs[:, 0]] & core[pairs[:, 1]]]
    lowest = torch.full_like(number, num).scatter_reduce_(0, border[:, 0], number[border[:, 1]], "amin")
    return torch.where(~core & (lowest < num), lowest, number)


def _pairs(points: Tensor, square: Tensor, begin: int) -> Tensor:
    """Rows (P, 2) of neighbors, a point of itself too, whose first is in the chunk that starts at `begin`."""
    stop = min(len(points), begin + max(1, _CHUNK // len(points)))
    total = torch.zeros(stop - begin, len(points), dtype=torch.float64, device=points.device)
    for axis in range(points.shape[1]):
        off = points[begin:stop, axis, None] - points[None, :, axis]
        total += off * off
    found = (total <= torch.minimum(square[begin:stop, None], square[None, :])).nonzero()
    found[:, 0] += begin
    return found


def _lexicographic(points: Tensor) -> Tensor:
    order = torch.arange(len(points), device=points.device)
    for axis in range(points.shape[1] - 1, -1, -1):
        order = order[torch.sort(points[order, axis], stable=True).indices]
    return order


def _components(label: Tensor, linked: Tensor) -> Tensor:
    """Lowest label (N,) of what is linked (P, 2), directly or by others: labels spread over links, and jump along the
    points that they name (Shiloach and Vishkin 1982).
    """
    named = torch.full((len(label) + 1,), len(label), dtype=torch.int64, device=label.device)
    named[label] = torch.arange(len(label), device=label.device)  # the point with this label
    while True:
        spread = label.scatter_reduce(0, linked[:, 0], label[linked[:, 1]], "amin")
        at = named[spread].clamp(max=len(label) - 1)
        jumped = torch.where(spread < len(label), torch.minimum(spread, spread[at]), spread)
        if torch.equal(jumped, label):
            return label
        label = jumped
