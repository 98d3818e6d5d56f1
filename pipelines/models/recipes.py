"""Trainings by the name of their model, from logs to a file with its card."""

import ctypes
import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import torch

from fbench.pipelines.fusion.early.rgbd import RGBD_WEIGHTS
from fbench.pipelines.models import bev_network, network
from fbench.pipelines.models.bev_samples import BevSettings, bev_samples
from fbench.pipelines.models.bev_train import BevTraining
from fbench.pipelines.models.loop import Loop
from fbench.pipelines.models.measured_logs import rgbd_samples
from fbench.pipelines.models.onnx_files import read_weights
from fbench.pipelines.models.samples import RgbdSettings, TrainingSettings, samples
from fbench.pipelines.models.settings import LoopSettings
from fbench.pipelines.models.train import Training
from fbench.pipelines.models.weights import AUTO
from fbench.pipelines.sensors.bev.detector import BUILTIN
from fbench.pipelines.sensors.camera.detector import CITY_WEIGHTS
from fbench.replay.contracts.faults import FaultLog

ModelName = Literal["camera", "rgbd", "learned3d"]
_CURVE_STEPS = 100  # One mean of the loss for so many steps
_WARM_START_DIVISOR = 4  # Of steps and learning rate where a training starts from existing weights
_LOOPS: Mapping[ModelName, tuple[Any, LoopSettings]] = {
    "camera": (Training, TrainingSettings()), "rgbd": (Training, RgbdSettings()),
    "learned3d": (BevTraining, BevSettings()),
}  # fmt: skip
_BUILTIN: Mapping[ModelName, Path] = {"camera": CITY_WEIGHTS, "rgbd": RGBD_WEIGHTS, "learned3d": BUILTIN}


@dataclass(frozen=True)
class TrainRequest:
    """What is trained, from what, and how."""

    model: ModelName
    logs: Sequence[Path]
    seed: int | None = None  # `None`: the recipe's own
    steps: int | None = None  # The same
    device: str = "cpu"
    threads: int = 2
    weights: Path | Literal["auto"] | None = None  # To start from: a file, the built-in ones, or random ones


@dataclass(eq=False)
class Recipe:
    """One training, ready to run. Raises LogError where the logs teach nothing, ModelError where the weights to start
    from are of another network.
    """

    request: TrainRequest
    faults: FaultLog = field(default_factory=FaultLog)  # What is wrong with the logs

    def __post_init__(self) -> None:
        request = self.request
        torch.set_num_threads(request.threads)
        _keep_freed_memory()
        if request.device == "cuda":  # the same weights each time on one kind of card
            os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
            torch.use_deterministic_algorithms(True)
        path = _BUILTIN[request.model] if request.weights == AUTO else request.weights
        self._weights = None if path is None else read_weights(path)
        how = request.device, request.threads, self._weights
        loop, settings = _LOOPS[request.model]
        settings = self._change(settings)
        if self._weights is not None:  # so that those of another network are refused before all logs are read
            loop([], settings, *how)
        self.loop: Loop[Any, Any, Any, Any] = loop(self._samples(), settings, *how)

    def _samples(self) -> list[Any]:
        logs, threads = self.request.logs, self.request.threads
        if self.request.model == "camera":
            return samples(logs, self.faults)
        if self.request.model == "rgbd":
            return rgbd_samples(logs, threads, self.faults)
        return bev_samples(logs, threads, self.faults)

    def _change(self, settings: Any) -> Any:
        asked = {"seed": self.request.seed, "steps": self.request.steps}
        if self._weights is not None:
            steps, rate = settings.steps // _WARM_START_DIVISOR, settings.learning_rate / _WARM_START_DIVISOR
            settings = replace(settings, steps=steps, learning_rate=rate)
        return replace(settings, **{name: value for name, value in asked.items() if value is not None})

    @property
    def num_recorded(self) -> int:
        """Number of samples from recordings, not from simulated logs."""
        return sum(sample.is_recorded for sample in self.loop.samples)

    def finish(self, trained: Any, out: Path) -> Path:
        """Write the network, and beside it a card of what it was made from; return the card's path."""
        logs, losses = [path.name for path in self.request.logs], self.loop.losses
        card = {
            "model": self.request.model, "seed": self.loop.settings.seed, "steps": self.loop.settings.steps,
            "samples": len(self.loop.samples), "recorded_samples": self.num_recorded, "logs": len(logs),
            "device": self.request.device, "threads": self.request.threads, "torch": torch.__version__,
        }  # fmt: skip
        export = bev_network.export if self.request.model == "learned3d" else network.export
        export(trained, out, {name: str(value) for name, value in card.items()})
        means = [
            round(sum(part) / len(part), 4)
            for at in range(0, len(losses), _CURVE_STEPS)
            if (part := losses[at : at + _CURVE_STEPS])
        ]
        digest = sha256(out.read_bytes()).hexdigest()
        names = "\n".join(sample.name for sample in self.loop.samples)  # with ids of logs
        more = {
            "weights_sha256": None if self._weights is None else self._weights.sha256,  # from which it started
            "settings": asdict(self.loop.settings), "logs": logs, "samples_sha256": sha256(names.encode()).hexdigest(),
            "loss_every_100_steps": means, "sha256": digest,
        }  # fmt: skip
        path = out.with_suffix(".json")
        path.write_text(json.dumps({**card, **more}, indent=1) + "\n", encoding="utf-8")
        return path


_M_TRIM_THRESHOLD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -4, -8  # of glibc's malloc.h


def _keep_freed_memory() -> None:
    """Have glibc keep what is freed, for all threads: new pages from the kernel took up to a fifth of forward and
    backward on a CPU.
    """
    if sys.platform == "linux":
        try:
            set_option = ctypes.CDLL(None).mallopt
        except AttributeError:  # another C library
            return
        for name, value in ((_M_TRIM_THRESHOLD, -1), (_M_MMAP_MAX, 0), (_M_ARENA_MAX, 1)):
            set_option(name, value)
