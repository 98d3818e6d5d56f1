"""The loop of a training: targets, loss, averaged weights, checkpoints from which it goes on."""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from fbench.pipelines.models.network import CityDetector, cell_strides, cells
from fbench.pipelines.models.samples import CLASSES, Batcher, Sample, TrainingSettings, View
from fbench.replay.contracts.errors import ConfigError
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


_STATE = {"made_from", "step", "network", "averaged", "optimizer"}
Report = Callable[[int, float], None]  # Called with the number of steps done and the latest loss


@dataclass(eq=False)
class Training:
    """A network under way. Raises ConfigError where a checkpoint is of other settings or samples."""

    samples: Sequence[Sample]
    settings: TrainingSettings
    device: str = "cpu"

    def __post_init__(self) -> None:
        torch.manual_seed(self.settings.seed)
        self.network = CityDetector(len(CLASSES)).to(self.device, memory_format=torch.channels_last)
        self.averaged = copy.deepcopy(self.network).eval()
        weights = [p for p in self.network.parameters() if p.ndim > 1]  # they decay, biases and scales don't
        others = [p for p in self.network.parameters() if p.ndim <= 1]
        groups = [
            {"params": weights, "weight_decay": self.settings.weight_decay},
            {"params": others, "weight_decay": 0.0},
        ]
        self._optimizer = torch.optim.AdamW(groups, lr=self.settings.learning_rate)
        self.step = 0

    def run(self, checkpoint: Path, report: Report) -> CityDetector:
        """Train to the end, from the checkpoint where there is one; return the averaged network."""
        if checkpoint.is_file():
            self._resume(checkpoint)
        batcher = Batcher(self.samples, self.settings)
        for views in batcher.batches(self.step, self.settings.steps):
            value = self._learn(views)
            self.step += 1
            report(self.step, value)
            if self.step % self.settings.checkpoint_every == 0 or self.step == self.settings.steps:
                self._save(checkpoint)
        return self.averaged

    def _learn(self, views: Sequence[View]) -> float:
        for group in self._optimizer.param_groups:
            group["lr"] = _rate(self.step, self.settings)
        self.network.train()
        images, truths = _tensors(views, self.device)
        logits, boxes = self.network(images)
        size = (images.shape[3], images.shape[2])
        targets = assign(cells(*size).to(self.device), cell_strides(*size).to(self.device), truths)
        value = loss(logits, boxes, targets)
        self._optimizer.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 10.0)
        self._optimizer.step()
        # Less is averaged at the beginning, when weights are far from where they will be.
        _average(self.averaged, self.network, self.settings.average * (1 - math.exp(-(self.step + 1) / 300)))
        return float(value.detach())

    def _save(self, checkpoint: Path) -> None:
        part = checkpoint.with_suffix(".part")
        state = {
            "made_from": self._make_from(), "step": self.step, "network": self.network.state_dict(),
            "averaged": self.averaged.state_dict(), "optimizer": self._optimizer.state_dict(),
        }  # fmt: skip
        torch.save(state, part)
        part.replace(checkpoint)

    def _resume(self, checkpoint: Path) -> None:
        state = _load(checkpoint, self.device)
        if state["made_from"] != self._make_from():
            raise ConfigError(f"{checkpoint}: a checkpoint of other settings or logs; delete it, or name another")
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.step = int(state["step"])

    def _make_from(self) -> dict[str, str]:
        return {"settings": repr(asdict(self.settings)), "samples": " ".join(s.name for s in self.samples)}


def _load(checkpoint: Path, device: str) -> dict[str, Any]:
    try:
        state: dict[str, Any] = torch.load(checkpoint, weights_only=True, map_location=device)
    except (RuntimeError, UnpicklingError, EOFError) as error:
        raise ConfigError(f"{checkpoint}: damaged, or no checkpoint; delete it, or name another") from error
    if not isinstance(state, dict) or set(state) != _STATE:
        raise ConfigError(f"{checkpoint}: no checkpoint of a training; delete it, or name another")
    return state


def _rate(step: int, settings: TrainingSettings) -> float:
    """Return the learning rate: it rises, then falls as a cosine to a fiftieth."""
    if step < settings.warm_up:
        return settings.learning_rate * (step + 1) / settings.warm_up
    done = (step - settings.warm_up) / max(1, settings.steps - settings.warm_up)
    return settings.learning_rate * (0.02 + 0.98 * (1 + math.cos(math.pi * done)) / 2)


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


@torch.no_grad()
def _average(averaged: nn.Module, network: nn.Module, kept: float) -> None:
    for old, new in zip(averaged.state_dict().values(), network.state_dict().values(), strict=True):
        if old.dtype.is_floating_point:
            old.lerp_(new, 1 - kept)
        else:
            old.copy_(new)
