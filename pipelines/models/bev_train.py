"""The training of the bird's-eye network: targets and loss."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from fbench.pipelines.models.bev_network import BevNetwork
from fbench.pipelines.models.bev_samples import BevSample, BevSettings, BevView
from fbench.pipelines.models.bev_views import BevBatcher
from fbench.pipelines.models.loop import Loop
from fbench.pipelines.sensors.bev.decoding import (
    AXIS,
    FORWARD,
    HEIGHT,
    KINDS,
    KNOWN,
    OFFSET,
    OUT_CELL_M,
    SCORE,
    SIZE,
    SPEED,
    STRIDE,
)
from fbench.pipelines.sensors.bev.grid import REACH_M, SIDE
from fbench.pipelines.sensors.twins.bev import rasterize_batch

_SPREAD = 0.35  # Standard deviation of a center's height in the map of scores, times the object's width + 1 cell
_BESIDE = 0.3  # How much a neighbor of the cell with the center counts for the box


@dataclass(frozen=True)
class BevTargets:
    """What a batch should give; H x W cells."""

    score: Tensor  # (B, H, W) 1 at centers, falling off around them
    counts: Tensor  # (B, H, W) whether a low score is judged
    weight: Tensor  # (B, H, W) how much the cell's box counts
    box: Tensor  # (B, H, W, 9) of the object whose center is nearest
    class_id: Tensor  # (B, H, W)
    is_speed_known: Tensor  # (B, H, W)


def assign(boxes: Tensor, class_id: Tensor, known: Tensor) -> BevTargets:
    """Place objects (B, G, 9) of classes (B, G), -1 to be ignored, on the map; boxes without length are padding."""
    side = SIDE // STRIDE
    middle = (torch.arange(side, device=boxes.device) + 0.5) * OUT_CELL_M - REACH_M
    dx, dy = middle[:, None] - boxes[..., 0, None, None], middle[None, :] - boxes[..., 1, None, None]  # (B, G, H, W)
    square = dx**2 + dy**2
    there = boxes[..., 3] > 0
    wanted = there & (class_id >= 0)
    spread = _SPREAD * (torch.minimum(boxes[..., 4], boxes[..., 3]) + OUT_CELL_M)[..., None, None]
    inside = (dx.abs() <= OUT_CELL_M / 2) & (dy.abs() <= OUT_CELL_M / 2) & wanted[..., None, None]
    height = torch.where(inside, 1.0, torch.exp(-square / (2 * spread**2)).clamp(max=0.95)) * wanted[..., None, None]
    near = (dx.abs() <= 1.5 * OUT_CELL_M) & (dy.abs() <= 1.5 * OUT_CELL_M) & wanted[..., None, None]
    owner = torch.where(near, square, torch.inf).argmin(1)  # (B, H, W)
    is_center = inside.any(1)
    weight = torch.where(is_center, 1.0, _BESIDE * near.any(1).float())
    # Ignored objects: nothing in their place is a mistake.
    c, s = torch.cos(boxes[..., 6, None, None]), torch.sin(boxes[..., 6, None, None])
    along, across = (c * dx + s * dy).abs(), (c * dy - s * dx).abs()
    room = boxes[..., 3:5, None, None] / 2 + OUT_CELL_M / 2
    ignored = ((along < room[:, :, 0]) & (across < room[:, :, 1]) & (there & ~wanted)[..., None, None]).any(1)
    flat = owner.flatten(1)
    box = boxes.gather(1, flat[..., None].expand(-1, -1, boxes.shape[2])).unflatten(1, owner.shape[1:])
    pick = (class_id.gather(1, flat), known.gather(1, flat))
    return BevTargets(height.amax(1), ~ignored, weight, box, *(part.unflatten(1, owner.shape[1:]) for part in pick))


def loss(output: Tensor, targets: BevTargets) -> Tensor:
    """Return the loss of a batch: penalty-reduced focal loss of centers (Law and Deng, CornerNet, ECCV 2018), L1 of the
    boxes of cells at and beside them (Yin et al., CenterPoint, CVPR 2021), cross entropy of classes.
    """
    logits = output[:, SCORE]
    probability = logits.sigmoid()
    is_center = targets.score >= 1
    found = -((1 - probability) ** 2) * functional.logsigmoid(logits)
    empty = -((1 - targets.score) ** 4) * probability**2 * functional.logsigmoid(-logits) * targets.counts
    num = is_center.sum().clamp(min=1)
    of_scores = torch.where(is_center, found, empty).sum() / num
    at = targets.weight > 0
    weight, box, cells = targets.weight[at], targets.box[at], output.permute(0, 2, 3, 1)[at]
    rows, columns = torch.where(at)[1:]
    offset = (box[:, :2] + REACH_M) / OUT_CELL_M - torch.stack([rows, columns], 1) - 0.5
    known = targets.is_speed_known[at].float()
    forward = torch.where(torch.cos(box[:, 6]).abs() > 1e-6, torch.cos(box[:, 6]), torch.sin(box[:, 6])) >= 0
    doubled = torch.stack([torch.sin(2 * box[:, 6]), torch.cos(2 * box[:, 6])], 1)
    binary = functional.binary_cross_entropy_with_logits
    each = (
        2.0 * (cells[:, OFFSET] - offset).abs().sum(1)
        + (cells[:, HEIGHT] - box[:, 2]).abs()
        + 1.5 * (cells[:, SIZE] - box[:, 3:6].clamp(min=0.1).log()).abs().sum(1)
        + 1.0 * (cells[:, AXIS] - doubled).abs().sum(1)
        + 0.2 * binary(cells[:, FORWARD], forward.float(), reduction="none")
        + 0.5 * functional.cross_entropy(cells[:, KINDS], targets.class_id[at], reduction="none")
        + 1.0 * known * (cells[:, SPEED] - box[:, 7:] / 10).abs().sum(1)
        + 0.2 * binary(cells[:, KNOWN], known, reduction="none")
    )
    return of_scores + 0.5 * (weight * each).sum() / weight.sum().clamp(min=1)


class BevTraining(Loop[BevSample, BevSettings, BevNetwork, list[BevView]]):
    """The bird's-eye network under way."""

    def make_network(self) -> BevNetwork:
        """Return the network with its first weights."""
        return BevNetwork()

    def batches(self, first: int, last: int) -> Iterator[list[BevView]]:
        """Yield the views of steps `first` to before `last`."""
        return BevBatcher(self.samples, self.settings, self.threads).batches(first, last)

    def judge(self, batch: list[BevView]) -> Tensor:
        """Return the loss of the network on some views."""
        images = rasterize_batch([one.points for one in batch], self.device)
        boxes, class_id, known = (
            _pad([getattr(one, name) for one in batch]).to(self.device)
            for name in ("boxes", "class_id", "is_speed_known")
        )
        output = self.network(images.contiguous(memory_format=torch.channels_last))
        return loss(output.float(), assign(boxes, class_id, known))


def _pad(rows: Sequence[np.ndarray]) -> Tensor:
    most = max(1, *(len(part) for part in rows))
    return torch.from_numpy(
        np.stack([np.pad(part, ((0, most - len(part)), *((0, 0),) * (part.ndim - 1))) for part in rows])
    )
