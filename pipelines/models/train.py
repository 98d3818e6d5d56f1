"""The training of the city's camera detector: targets and loss."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from fbench.pipelines.models.loop import Loop
from fbench.pipelines.models.network import CityDetector, cell_strides, cells
from fbench.pipelines.models.samples import CLASSES, RgbdSettings, Sample, TrainingSettings
from fbench.pipelines.models.views import Batcher, View
from fbench.pipelines.sensors.camera.channels import NUM_CHANNELS
from fbench.replay.data.arrays import Array

_RADIUS = 1.5  # Strides from the middle of an object within which cells shall find it
_SIZES_PX = {8: (0.0, 80.0), 16: (48.0, 208.0), 32: (128.0, 1e5)}
"""Longer sides of the objects that each stride finds; where two overlap, both do."""


@dataclass(frozen=True)
class Truths:
    """Boxes of a batch [px], padded to the most of an image."""

    xyxy: Tensor  # (B, G, 4)
    class_id: Tensor  # (B, G); -1 is padding
    ignored_xyxy: Tensor  # (B, I, 4) what is neither to be found nor a mistake; padded with empty boxes


@dataclass(frozen=True)
class Targets:
    """What a batch should give."""

    xyxy: Tensor  # (B, N, 4), of cells with an object
    class_id: Tensor  # (B, N), of cells with an object
    is_object: Tensor  # (B, N)
    counts: Tensor  # (B, N) whether the cell's scores are judged at all


def assign(points: Tensor, strides: Tensor, truths: Truths) -> Targets:
    """Give each object of a batch the cells around its middle, and a cell of several objects the smallest. Takes the
    middles (2, N) [px] and strides (N,) [px] of the cells.
    """
    sides = truths.xyxy[..., 2:] - truths.xyxy[..., :2]
    # Cells near the middle of a box and in it, or those around it where it is small.
    off = points - ((truths.xyxy[..., :2] + truths.xyxy[..., 2:]) / 2)[..., None]
    far = off.abs().amax(2) / strides
    chosen = (far < _RADIUS) & (_within(truths.xyxy, points) | (far <= 0.5)) & _fits(sides.amax(-1), strides)
    chosen &= (truths.class_id >= 0)[:, :, None]
    area = torch.where(chosen, sides.prod(-1)[:, :, None], torch.inf)
    owner, is_object = area.argmin(1), chosen.any(1)
    xyxy = truths.xyxy.gather(1, owner[:, :, None].expand(-1, -1, 4))
    ignored = _within(truths.ignored_xyxy, points).any(1)
    return Targets(xyxy, truths.class_id.gather(1, owner), is_object, is_object | ~ignored)


def _fits(longest: Tensor, strides: Tensor) -> Tensor:
    """Tell which cells (N,) are of a stride for objects (B, G) as long as these: (B, G, N)."""
    fits = torch.zeros(*longest.shape, len(strides), dtype=torch.bool, device=longest.device)
    for stride, (low, high) in _SIZES_PX.items():
        fits |= ((longest >= low) & (longest < high))[..., None] & (strides == stride)
    return fits


def _within(xyxy: Tensor, points: Tensor) -> Tensor:
    x, y = points[0], points[1]
    left, top, right, bottom = (xyxy[..., i, None] for i in range(4))
    return (x > left) & (x < right) & (y > top) & (y < bottom)


_BOX_WEIGHT = 2.0
_MISS, _ALARM = 2.0, 0.75  # How much scores of cells with an object, and of others, weigh


def loss(logits: Tensor, boxes: Tensor, targets: Targets) -> Tensor:
    """Return the loss of a batch: scores should tell how well the box fits (varifocal loss, Zhang et al., CVPR 2021),
    boxes should fit (GIoU, Rezatofighi et al., CVPR 2019). Takes logits (B, C, N) and boxes (B, 4, N) [px].
    """
    found, wanted = boxes.transpose(1, 2)[targets.is_object], targets.xyxy[targets.is_object]
    fit = giou(found, wanted)
    total = max(1, len(fit))
    # How well the box of each cell fits, under the class of its object; 0 elsewhere: (B, C, N).
    scores = torch.zeros_like(logits)
    image, cell = targets.is_object.nonzero(as_tuple=True)
    scores[image, targets.class_id[targets.is_object], cell] = fit.detach().clamp(0, 1)
    # Scores of empty cells weigh by how high they are.
    weight = torch.where(scores > 0, _MISS * scores, _ALARM * logits.detach().sigmoid().square())
    each = functional.binary_cross_entropy_with_logits(logits, scores, weight, reduction="none")
    of_scores = (each * targets.counts[:, None]).sum()
    return of_scores / total + _BOX_WEIGHT * (1 - fit).sum() / total


def giou(a: Tensor, b: Tensor) -> Tensor:
    """Generalised overlap of boxes (N, 4) and (N, 4), -1 to 1."""
    shared = (torch.minimum(a[:, 2:], b[:, 2:]) - torch.maximum(a[:, :2], b[:, :2])).clamp(min=0).prod(1)
    union = (a[:, 2:] - a[:, :2]).prod(1) + (b[:, 2:] - b[:, :2]).prod(1) - shared
    hull = (torch.maximum(a[:, 2:], b[:, 2:]) - torch.minimum(a[:, :2], b[:, :2])).prod(1)
    return shared / union.clamp(min=1e-6) - (hull - union) / hull.clamp(min=1e-6)


class Training(Loop[Sample, TrainingSettings, CityDetector, list[View]]):
    """The city's camera detector under way, with points or without."""

    def make_network(self) -> CityDetector:
        """Return the network with its first weights."""
        return CityDetector(len(CLASSES), 3 + NUM_CHANNELS * isinstance(self.settings, RgbdSettings))

    def batches(self, first: int, last: int) -> Iterator[list[View]]:
        """Yield the views of steps `first` to before `last`."""
        return Batcher(self.samples, self.settings, self.threads).batches(first, last)

    def judge(self, batch: list[View]) -> Tensor:
        """Return the loss of the network on some views."""
        images, truths = _tensors(batch, self.device)
        logits, boxes = self.network(images)
        size = (images.shape[3], images.shape[2])
        return loss(logits, boxes, assign(cells(*size).to(self.device), cell_strides(*size).to(self.device), truths))


def _tensors(views: Sequence[View], device: str) -> tuple[Tensor, Truths]:
    pixels = torch.from_numpy(np.stack([view.pixels for view in views])).to(device)
    images = (pixels.permute(0, 3, 1, 2).float() / 255).contiguous(memory_format=torch.channels_last)
    wanted, ignored = [view.class_id >= 0 for view in views], [view.class_id < 0 for view in views]
    xyxy = _pad([view.xyxy[rows] for view, rows in zip(views, wanted, strict=True)], 0.0)
    ids = _pad([view.class_id[rows, None] for view, rows in zip(views, wanted, strict=True)], -1.0)
    others = _pad([view.xyxy[rows] for view, rows in zip(views, ignored, strict=True)], 0.0)
    return images, Truths(xyxy.to(device), ids[:, :, 0].long().to(device), others.to(device))


def _pad(rows: Sequence[Array], value: float) -> Tensor:
    most = max(1, *(len(part) for part in rows))
    filled = [np.pad(part, ((0, most - len(part)), (0, 0)), constant_values=value) for part in rows]
    return torch.from_numpy(np.stack(filled).astype(np.float32))
