"""The loop of a training: optimizer, averaged weights, checkpoints from which it goes on."""

import copy
import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Generic, Protocol, TypeVar

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from fbench.pipelines.models.onnx_files import FirstWeights, load_weights
from fbench.pipelines.models.settings import LoopSettings
from fbench.replay.contracts.errors import ConfigError

_STATE = {"made_from", "step", "losses", "network", "averaged", "optimizer"}
_DAMAGED = (
    RuntimeError, UnpicklingError, EOFError, LookupError, ValueError, TypeError, AttributeError, AssertionError,
    ArithmeticError, struct.error,
)  # fmt: skip
"""What reading a file raises that is no checkpoint: torch takes its bytes for instructions."""
Report = Callable[[int, float], None]  # Called with the number of steps done and the latest loss


class Named(Protocol):
    """A sample."""

    @property
    def name(self) -> str:
        """Log with its id, sensor and stamp."""
        ...


Example = TypeVar("Example", bound=Named)
Settings = TypeVar("Settings", bound=LoopSettings)
Network = TypeVar("Network", bound=nn.Module)
Batch = TypeVar("Batch")


@dataclass(eq=False)
class Loop(ABC, Generic[Example, Settings, Network, Batch]):
    """A network under way, made and judged by a subclass. Raises ConfigError where a checkpoint is of other settings or
    samples, ModelError where it starts from weights of another network. One machine, device and number of threads give
    the same weights each time.
    """

    samples: Sequence[Example]
    settings: Settings
    device: str = "cpu"
    threads: int = 2  # That make the batches
    weights: FirstWeights | None = None  # With none, they are random

    def __post_init__(self) -> None:
        torch.manual_seed(self.settings.seed)
        network = self.make_network()
        if self.weights is not None:
            load_weights(network, self.weights)
        self.network = network.to(self.device, memory_format=torch.channels_last)
        self.averaged = copy.deepcopy(self.network).eval()
        weights = [p for p in self.network.parameters() if p.ndim > 1]  # they decay, biases and scales don't
        others = [p for p in self.network.parameters() if p.ndim <= 1]
        groups = [
            {"params": weights, "weight_decay": self.settings.weight_decay},
            {"params": others, "weight_decay": 0.0},
        ]
        self._optimizer = torch.optim.AdamW(groups, lr=self.settings.learning_rate)
        self.step = 0
        self.losses: list[float] = []  # Of all steps, those before an interruption included

    @abstractmethod
    def make_network(self) -> Network:
        """Return the network with its first weights."""

    @abstractmethod
    def batches(self, first: int, last: int) -> Iterator[Batch]:
        """Yield the batches of steps `first` to before `last`."""

    @abstractmethod
    def judge(self, batch: Batch) -> Tensor:
        """Return the loss of the network on a batch."""

    def run(self, checkpoint: Path, report: Report) -> Network:
        """Train to the end, from the checkpoint where there is one; return the averaged network."""
        if self.step == 0 and checkpoint.is_file():
            self.resume(checkpoint)
        for batch in self.batches(self.step, self.settings.steps):
            value = self._learn(batch)
            self.step += 1
            self.losses.append(value)
            report(self.step, value)
            if self.step % self.settings.checkpoint_every == 0 or self.step == self.settings.steps:
                self._save(checkpoint)
        return self.averaged

    def _learn(self, batch: Batch) -> float:
        for group in self._optimizer.param_groups:
            group["lr"] = _rate(self.step, self.settings)
        self.network.train()
        if self.weights is not None:  # which include batch normalization
            for part in self.network.modules():
                if isinstance(part, nn.BatchNorm2d):
                    part.eval()
        value = self.judge(batch)
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
            "made_from": self._identity(), "step": self.step, "losses": self.losses,
            "network": self.network.state_dict(), "averaged": self.averaged.state_dict(),
            "optimizer": self._optimizer.state_dict(),
        }  # fmt: skip
        torch.save(state, part)
        part.replace(checkpoint)

    def resume(self, checkpoint: Path) -> None:
        """Go on from a checkpoint. Raises ConfigError where it is damaged, or of another training."""
        try:
            self._restore(checkpoint, torch.load(checkpoint, weights_only=True, map_location=self.device))
        except _DAMAGED as error:
            raise ConfigError(f"{checkpoint}: damaged, or no checkpoint; delete it, or name another") from error

    def _restore(self, checkpoint: Path, state: Any) -> None:
        if not isinstance(state, dict) or set(state) != _STATE:
            raise ConfigError(f"{checkpoint}: no checkpoint of a training; delete it, or name another")
        own, its = self._identity(), dict(state["made_from"])
        if its != own:
            other = [name for name in own if its.get(name) != own[name]]
            what = f"a checkpoint of a training with other {' and '.join(other)}"
            raise ConfigError(f"{checkpoint}: {what}; delete it, or name another file with -o")
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.step, self.losses = int(state["step"]), [float(value) for value in state["losses"]]

    def _identity(self) -> dict[str, str]:
        """What decides the weights: with one of these changed, they would be of no training that can be repeated."""
        return {
            "settings": repr(self.settings), "samples": " ".join(sample.name for sample in self.samples),
            "device": self.device, "threads": str(self.threads), "version of torch": str(torch.__version__),
            "weights to start from": "none" if self.weights is None else self.weights.sha256,
        }  # fmt: skip


def _rate(step: int, settings: LoopSettings) -> float:
    """Return the learning rate: it rises, then falls as a cosine to a fiftieth."""
    if step < settings.warm_up:
        return settings.learning_rate * (step + 1) / settings.warm_up
    done = (step - settings.warm_up) / max(1, settings.steps - settings.warm_up)
    return settings.learning_rate * (0.02 + 0.98 * (1 + math.cos(math.pi * done)) / 2)


@torch.no_grad()
def _average(averaged: nn.Module, network: nn.Module, kept: float) -> None:
    pairs = list(zip(averaged.state_dict().values(), network.state_dict().values(), strict=True))
    floats = [(old, new) for old, new in pairs if old.dtype.is_floating_point]
    get_ema_multi_avg_fn(kept)([old for old, _ in floats], [new for _, new in floats], None)
    for old, new in pairs:
        if not old.dtype.is_floating_point:
            old.copy_(new)
