"""How wrong a batch was."""

import torch
from torch import Tensor
from torch.nn import functional

from fbench.pipelines.training.targets import Targets

_BOX_WEIGHT = 2.0
_MISS, _ALARM = 2.0, 0.75
"""How much scores of cells with an object, and of others, weigh."""


def loss(logits: Tensor, boxes: Tensor, targets: Targets) -> Tensor:
    """Return the loss of a batch: scores should tell how well the box fits (varifocal loss, Zhang et al., CVPR 2021),
    boxes should fit (GIoU, Rezatofighi et al., CVPR 2019).

    Args:
        logits: (B, C, N).
        boxes: (B, 4, N) [px].
        targets: What they should have been.
    """
    found, wanted = boxes.transpose(1, 2)[targets.is_object], targets.xyxy[targets.is_object]
    fit = giou(found, wanted)
    total = max(1, len(fit))
    of_scores = _varifocal(logits, _wanted_scores(logits, targets, fit.detach().clamp(0, 1)), targets.counts)
    return of_scores / total + _BOX_WEIGHT * (1 - fit).sum() / total


def _wanted_scores(logits: Tensor, targets: Targets, fit: Tensor) -> Tensor:
    """How well the box of each cell fits, under the class of its object; 0 elsewhere: (B, C, N)."""
    wanted = torch.zeros_like(logits)
    image, cell = targets.is_object.nonzero(as_tuple=True)
    wanted[image, targets.class_id[targets.is_object], cell] = fit
    return wanted


def _varifocal(logits: Tensor, wanted: Tensor, counts: Tensor) -> Tensor:
    """Sum over all scores; those of empty cells weigh by how high they are."""
    weight = torch.where(wanted > 0, _MISS * wanted, _ALARM * logits.detach().sigmoid().square())
    each = functional.binary_cross_entropy_with_logits(logits, wanted, weight, reduction="none")
    return (each * counts[:, None]).sum()


def giou(a: Tensor, b: Tensor) -> Tensor:
    """Generalised overlap of boxes (N, 4) and (N, 4), -1 to 1."""
    shared = (torch.minimum(a[:, 2:], b[:, 2:]) - torch.maximum(a[:, :2], b[:, :2])).clamp(min=0).prod(1)
    union = (a[:, 2:] - a[:, :2]).prod(1) + (b[:, 2:] - b[:, :2]).prod(1) - shared
    hull = (torch.maximum(a[:, 2:], b[:, 2:]) - torch.minimum(a[:, :2], b[:, :2])).prod(1)
    return shared / union.clamp(min=1e-6) - (hull - union) / hull.clamp(min=1e-6)
