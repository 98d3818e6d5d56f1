"""Trainings by the name of their model, from logs to a file with its card."""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import torch

from fbench.pipelines.models import bev_network, network
from fbench.pipelines.models.bev_samples import BevSettings, bev_samples
from fbench.pipelines.models.bev_train import BevTraining
from fbench.pipelines.models.loop import Loop
from fbench.pipelines.models.measured_logs import rgbd_samples
from fbench.pipelines.models.samples import RgbdSettings, TrainingSettings, samples
from fbench.pipelines.models.train import Training
from fbench.replay.contracts.faults import FaultLog

ModelName = Literal["camera", "rgbd", "learned3d"]
_CURVE_STEPS = 100  # One mean of the loss for so many steps


@dataclass(frozen=True)
class TrainRequest:
    """What is trained, from what, and how."""

    model: ModelName
    logs: Sequence[Path]
    seed: int | None = None  # `None`: the recipe's own
    steps: int | None = None  # The same
    device: str = "cpu"
    threads: int = 2


@dataclass(eq=False)
class Recipe:
    """One training, ready to run. Raises LogError where the logs teach nothing."""

    request: TrainRequest
    faults: FaultLog = field(default_factory=FaultLog)  # What is wrong with the logs

    def __post_init__(self) -> None:
        request = self.request
        torch.set_num_threads(request.threads)
        if request.device == "cuda":  # the same weights each time on one kind of card
            os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
            torch.use_deterministic_algorithms(True)
        device, threads = request.device, request.threads
        logs = request.logs, threads, self.faults
        self.loop: Loop[Any, Any, Any, Any]
        if request.model == "camera":
            self.loop = Training(samples(request.logs, self.faults), self._change(TrainingSettings()), device, threads)
        elif request.model == "rgbd":
            self.loop = Training(rgbd_samples(*logs), self._change(RgbdSettings()), device, threads)
        else:
            self.loop = BevTraining(bev_samples(*logs), self._change(BevSettings()), device, threads)

    def _change(self, settings: Any) -> Any:
        asked = {"seed": self.request.seed, "steps": self.request.steps}
        return replace(settings, **{name: value for name, value in asked.items() if value is not None})

    def finish(self, trained: Any, out: Path) -> Path:
        """Write the network, and beside it a card of what it was made from; return the card's path."""
        logs, losses = [path.name for path in self.request.logs], self.loop.losses
        card = {
            "model": self.request.model, "seed": self.loop.settings.seed, "steps": self.loop.settings.steps,
            "samples": len(self.loop.samples), "logs": len(logs), "device": self.request.device,
            "threads": self.request.threads, "torch": torch.__version__,
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
            "settings": asdict(self.loop.settings), "logs": logs, "samples_sha256": sha256(names.encode()).hexdigest(),
            "loss_every_100_steps": means, "sha256": digest,
        }  # fmt: skip
        path = out.with_suffix(".json")
        path.write_text(json.dumps({**card, **more}, indent=1) + "\n", encoding="utf-8")
        return path
