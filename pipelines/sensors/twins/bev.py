"""Twin of `bev.grid.rasterize`."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from fbench.pipelines.sensors.bev import grid
from fbench.pipelines.sensors.bev.grid import BevPoints


def rasterize_batch(points: Sequence[BevPoints], device: str) -> Tensor:
    """Draw points of B frames as `grid.rasterize` does: (B, C, `SIDE`, `SIDE`). Slices of height are equal to its, the
    other channels within 1e-6.
    """
    side, num = grid.SIDE, len(points)
    image = torch.zeros(num, grid.NUM_CHANNELS, side * side, device=device)
    lidar, frame = _join([one.lidar for one in points], device)
    borders = torch.tensor(grid.SLICES_M, device=device)
    cell, inside = _cells(lidar)
    kept = inside & (lidar[:, 2] >= borders[0]) & (lidar[:, 2] < borders[-1])
    cell, frame, height = cell[kept], frame[kept], lidar[kept, 2].contiguous()
    part = torch.bucketize(height, borders, right=True) - 1
    flat = image.view(-1)
    ones = torch.ones_like(height)
    _raise_to(flat, _index(frame, part, cell), ones)
    _raise_to(flat, _index(frame, grid.TOP, cell), height / grid.FULL_TOP_M)
    image[:, grid.COUNT] = _count(frame, cell, num)
    radar, frame = _join([one.radar for one in points], device)
    cell, inside = _cells(radar)
    cell, frame, radar = cell[inside], frame[inside], radar[inside]
    stands = (radar[:, 2] >= grid.STANDING_M[0]) & (radar[:, 2] < grid.STANDING_M[1])
    image[:, grid.ECHOES] = _count(frame[stands], cell[stands], num)
    image[:, grid.OTHER_ECHOES] = _count(frame[~stands], cell[~stands], num)
    _raise_to(flat, _index(frame, grid.RECEDING, cell), radar[:, 3] / grid.FULL_MPS)
    _raise_to(flat, _index(frame, grid.APPROACHING, cell), -radar[:, 3] / grid.FULL_MPS)
    image[:, grid.RANGE] = torch.from_numpy(grid.ranges()).to(device).flatten()
    return image.view(num, grid.NUM_CHANNELS, side, side)


def _join(rows: Sequence[np.ndarray], device: str) -> tuple[Tensor, Tensor]:
    """All rows, and the number of the frame of each."""
    frame = np.repeat(np.arange(len(rows)), [len(part) for part in rows])
    return torch.from_numpy(np.concatenate(rows)).to(device), torch.from_numpy(frame).to(device)


def _cells(rows: Tensor) -> tuple[Tensor, Tensor]:
    at = torch.floor((rows[:, :2] + grid.REACH_M) * float(grid.PER_M))
    inside = ((at >= 0) & (at < grid.SIDE)).all(1)
    whole = torch.where(inside[:, None], at, 0.0).long()
    return whole[:, 0] * grid.SIDE + whole[:, 1], inside


def _index(frame: Tensor, channel: Tensor | int, cell: Tensor) -> Tensor:
    return (frame * grid.NUM_CHANNELS + channel) * grid.SIDE**2 + cell


def _raise_to(flat: Tensor, index: Tensor, values: Tensor) -> None:
    """Largest value of each place, at least what is there: in any order the same."""
    flat.scatter_reduce_(0, index, values, "amax")


def _count(frame: Tensor, cell: Tensor, num: int) -> Tensor:
    total = torch.bincount(frame * grid.SIDE**2 + cell, minlength=num * grid.SIDE**2)
    return torch.log1p(total.view(num, -1).float()) / grid.FULL_COUNT
