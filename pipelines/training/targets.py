"""Which cells find which object: those near its middle, on the level that fits its size (Tian et al., ICCV 2019)."""

from dataclasses import dataclass

import torch
from torch import Tensor

_RADIUS = 1.5
"""Strides from the middle of an object within which cells shall find it."""
_SIZES_PX = {8: (0.0, 80.0), 16: (48.0, 208.0), 32: (128.0, 1e5)}
"""Longer sides of the objects that each stride finds; where two overlap, both do."""


@dataclass(frozen=True)
class Truths:
    """Boxes of a batch [px], padded to the most of an image."""

    xyxy: Tensor
    """(B, G, 4)."""
    class_id: Tensor
    """(B, G); -1 is padding."""
    ignored_xyxy: Tensor
    """(B, I, 4) what is neither to be found nor a mistake; padded with empty boxes."""


@dataclass(frozen=True)
class Targets:
    """What a batch should give."""

    xyxy: Tensor
    """(B, N, 4), of cells with an object."""
    class_id: Tensor
    """(B, N), of cells with an object."""
    is_object: Tensor
    """(B, N)."""
    counts: Tensor
    """(B, N) whether the cell's scores are judged at all."""


def assign(points: Tensor, strides: Tensor, truths: Truths) -> Targets:
    """Give each object the cells around its middle, and a cell of several objects the smallest.

    Args:
        points: (2, N) middles of the cells [px].
        strides: (N,) [px].
        truths: Of a batch.
    """
    sides = truths.xyxy[..., 2:] - truths.xyxy[..., :2]
    chosen = _near_middle(truths.xyxy, points, strides) & _fits(sides.amax(-1), strides)
    chosen &= (truths.class_id >= 0)[:, :, None]
    area = torch.where(chosen, sides.prod(-1)[:, :, None], torch.inf)
    owner, is_object = area.argmin(1), chosen.any(1)
    xyxy = truths.xyxy.gather(1, owner[:, :, None].expand(-1, -1, 4))
    ignored = _within(truths.ignored_xyxy, points).any(1)
    return Targets(xyxy, truths.class_id.gather(1, owner), is_object, is_object | ~ignored)


def _near_middle(xyxy: Tensor, points: Tensor, strides: Tensor) -> Tensor:
    """Tell which cells are near the middle of which box and in it, or are those around it where it is small."""
    off = points - ((xyxy[..., :2] + xyxy[..., 2:]) / 2)[..., None]
    far = off.abs().amax(2) / strides
    return (far < _RADIUS) & (_within(xyxy, points) | (far <= 0.5))


def _fits(longest: Tensor, strides: Tensor) -> Tensor:
    """Tell which cells (N,) are of a stride for objects (B, G) as long as these: (B, G, N)."""
    fits = torch.zeros(*longest.shape, len(strides), dtype=torch.bool, device=longest.device)
    for stride, (low, high) in _SIZES_PX.items():
        fits |= ((longest >= low) & (longest < high))[..., None] & (strides == stride)
    return fits


def _within(xyxy: Tensor, points: Tensor) -> Tensor:
    """Tell which points (2, N) lie in which boxes (B, G, 4): (B, G, N)."""
    x, y = points[0], points[1]
    left, top, right, bottom = (xyxy[..., i, None] for i in range(4))
    return (x > left) & (x < right) & (y > top) & (y < bottom)
