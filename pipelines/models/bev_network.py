"""The bird's-eye network, and its export to ONNX."""

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from fbench.pipelines.models.network import Residual, Separable, Unit
from fbench.pipelines.models.onnx_files import convert, save
from fbench.pipelines.sensors.bev.decoding import NUM_OUTPUTS, SCORE
from fbench.pipelines.sensors.bev.grid import NUM_CHANNELS, SIDE

_STEM, _WIDTHS, _NECK = 32, (48, 96, 160), 64
_PRIOR = 0.01  # See `network.py`


class BevNetwork(nn.Module):
    """What each cell of 4 x 4 cells of the input holds.

    Input (B, `NUM_CHANNELS`, H, W) as `grid.rasterize` draws it, H and W multiples of 16. Output (B, `NUM_OUTPUTS`,
    H / 4, W / 4) as `decoding` reads it, but with the logit of a center.
    """

    def __init__(self) -> None:
        super().__init__()
        near, middle, far = _WIDTHS
        self.stem = Unit(NUM_CHANNELS, _STEM, 3, 2)
        self.fourth = nn.Sequential(Unit(_STEM, near, 3, 2), Residual(near), Residual(near))
        self.eighth = nn.Sequential(Unit(near, middle, 3, 2), *(Residual(middle) for _ in range(3)))
        self.sixteenth = nn.Sequential(Unit(middle, far, 3, 2), *(Residual(far) for _ in range(3)))
        self.inputs = nn.ModuleList([Unit(width, _NECK, 1) for width in _WIDTHS])
        self.joined = nn.ModuleList([Separable(_NECK, 5) for _ in range(2)])
        self.what = nn.Sequential(Separable(_NECK, 5), nn.Conv2d(_NECK, 8, 1))
        self.where = nn.Sequential(Separable(_NECK, 5), nn.Conv2d(_NECK, NUM_OUTPUTS - 8, 1))
        nn.init.constant_(self.what[1].bias[SCORE : SCORE + 1], float(torch.logit(torch.tensor(_PRIOR))))

    def forward(self, points: Tensor) -> Tensor:
        """See the class."""
        fourth = self.fourth(self.stem(points))
        eighth = self.eighth(fourth)
        sixteenth = self.sixteenth(eighth)
        fine, middle, coarse = (unit(x) for unit, x in zip(self.inputs, (fourth, eighth, sixteenth), strict=True))
        middle = self.joined[0](middle + functional.interpolate(coarse, scale_factor=2.0, mode="nearest"))
        fine = self.joined[1](fine + functional.interpolate(middle, scale_factor=2.0, mode="nearest"))
        return torch.cat([self.what(fine), self.where(fine)], 1)


class _Exported(nn.Module):
    def __init__(self, network: BevNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, points: Tensor) -> Tensor:
        found = self.network(points)
        return torch.cat([found[:, :1].sigmoid(), found[:, 1:]], 1)


def export(network: BevNetwork, path: Path, card: Mapping[str, str]) -> None:
    """Write an ONNX file: input `points` (B, C, `SIDE`, `SIDE`), output `cells`; the card becomes its metadata."""
    blank = torch.zeros(1, NUM_CHANNELS, SIDE, SIDE)
    model = convert(_Exported(network.cpu()), blank, ("points", "cells"))
    save(model, path, {"description": "fbench's bird's-eye network", **card})
