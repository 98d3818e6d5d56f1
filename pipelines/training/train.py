"""The loop of a training: steps, averaged weights, checkpoints from which it goes on."""

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

from fbench.pipelines.training.batches import Batcher
from fbench.pipelines.training.loss import loss
from fbench.pipelines.training.network import CityDetector, cell_strides, cells
from fbench.pipelines.training.samples import Sample
from fbench.pipelines.training.settings import CLASSES, TrainingSettings
from fbench.pipelines.training.targets import Truths, assign
from fbench.pipelines.training.views import View
from fbench.replay.arrays import Array
from fbench.replay.errors import ConfigError

_STATE = {"made_from", "step", "network", "averaged", "optimizer"}
Report = Callable[[int, float], None]
"""Called with the number of steps done and the latest loss."""


@dataclass(eq=False)
class Training:
    """A network under way.

    Raises:
        ConfigError: where a checkpoint is of other settings or samples.
    """

    samples: Sequence[Sample]
    settings: TrainingSettings
    device: str = "cpu"

    def __post_init__(self) -> None:
        torch.manual_seed(self.settings.seed)
        self.network = CityDetector(len(CLASSES)).to(self.device, memory_format=torch.channels_last)
        self.averaged = copy.deepcopy(self.network).eval()
        self._optimizer = torch.optim.AdamW(_groups(self.network, self.settings), lr=self.settings.learning_rate)
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
        _average(self.averaged, self.network, self._kept())
        return float(value.detach())

    def _kept(self) -> float:
        """Average less at the beginning, when weights are far from where they will be."""
        return self.settings.average * (1 - math.exp(-(self.step + 1) / 300))

    def _save(self, checkpoint: Path) -> None:
        part = checkpoint.with_suffix(".part")
        state = {
            "made_from": self._made_from(), "step": self.step, "network": self.network.state_dict(),
            "averaged": self.averaged.state_dict(), "optimizer": self._optimizer.state_dict(),
        }  # fmt: skip
        torch.save(state, part)
        part.replace(checkpoint)

    def _resume(self, checkpoint: Path) -> None:
        state = _loaded(checkpoint, self.device)
        if state["made_from"] != self._made_from():
            raise ConfigError(f"{checkpoint}: a checkpoint of other settings or logs; delete it, or name another")
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.step = int(state["step"])

    def _made_from(self) -> dict[str, str]:
        return {"settings": repr(asdict(self.settings)), "samples": " ".join(s.name for s in self.samples)}


def _loaded(checkpoint: Path, device: str) -> dict[str, Any]:
    try:
        state: dict[str, Any] = torch.load(checkpoint, weights_only=True, map_location=device)
    except (RuntimeError, UnpicklingError, EOFError) as error:
        raise ConfigError(f"{checkpoint}: damaged, or no checkpoint; delete it, or name another") from error
    if not isinstance(state, dict) or set(state) != _STATE:
        raise ConfigError(f"{checkpoint}: no checkpoint of a training; delete it, or name another")
    return state


def _groups(network: nn.Module, settings: TrainingSettings) -> list[dict[str, Any]]:
    """Weights decay, biases and scales don't."""
    named = list(network.named_parameters())
    return [
        {"params": [p for _, p in named if p.ndim > 1], "weight_decay": settings.weight_decay},
        {"params": [p for _, p in named if p.ndim <= 1], "weight_decay": 0.0},
    ]


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
    xyxy = _padded([view.xyxy[rows] for view, rows in zip(views, wanted, strict=True)], 0.0)
    ids = _padded([view.class_id[rows, None] for view, rows in zip(views, wanted, strict=True)], -1.0)
    others = _padded([view.xyxy[rows] for view, rows in zip(views, ignored, strict=True)], 0.0)
    return images, Truths(xyxy.to(device), ids[:, :, 0].long().to(device), others.to(device))


def _padded(rows: Sequence[Array], value: float) -> Tensor:
    """Stack arrays (N, M) of different lengths, at least one row each."""
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
