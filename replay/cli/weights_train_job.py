"""Training the built-in detector, and what is printed of it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import Any

from fbench.replay.cli.progress import message_progress
from fbench.replay.cli.show import console
from fbench.replay.errors import ConfigError

_SAID_EVERY = 100
"""Steps."""


def train_detector(folder: Path, out: Path, seed: int | None, steps: int | None, device: str, threads: int) -> None:
    """Train on the logs of a folder, go on from a checkpoint beside `out` where there is one, and write an ONNX file.

    Raises:
        ConfigError: without torch, logs, or the device.
    """
    torch = _torch()
    if out.suffix != ".onnx":
        raise ConfigError(f"{out}: expected a name that ends in .onnx")
    if not out.absolute().parent.is_dir():
        raise ConfigError(f"{out}: can't be written (no folder {out.absolute().parent})")
    if device == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device cuda: torch finds no CUDA device here")
    torch.set_num_threads(threads)
    from fbench.pipelines.training.export import export
    from fbench.pipelines.training.samples import samples
    from fbench.pipelines.training.settings import TrainingSettings
    from fbench.pipelines.training.train import Training

    settings = TrainingSettings()
    settings = replace(settings, seed=settings.seed if seed is None else seed, steps=steps or settings.steps)
    found = samples(_logs(folder))
    _say(f"{len(found)} images, {settings.steps} steps, seed {settings.seed}")
    checkpoint = out.with_suffix(".checkpoint")
    with message_progress(out.name, settings.steps) as progress:
        network = Training(found, settings, device).run(checkpoint, _reporter(progress))
    export(network, out)
    checkpoint.unlink()
    _say(f"weights: {out}")


def _torch() -> Any:
    try:
        import onnx  # noqa: F401
        import torch
    except ImportError as error:
        raise ConfigError(f"training needs {error.name}: pip install 'fbench[torch]'") from error
    return torch


def _logs(folder: Path) -> Sequence[Path]:
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; to make one: fbench log simulate training -o {folder}")
    found = sorted(path for path in folder.iterdir() if path.suffix in (".mcap", ".parquet"))
    if not found:
        raise ConfigError(f"{folder}: no logs in it; to make them: fbench log simulate training -o {folder}")
    return found


def _reporter(progress: Callable[[int], None]) -> Callable[[int, float], None]:
    begun, losses = monotonic(), list[float]()

    def report(step: int, loss: float) -> None:
        progress(step)
        losses.append(loss)
        if step % _SAID_EVERY == 0:
            _say(f"step {step}: loss {sum(losses) / len(losses):.3f}, {monotonic() - begun:.0f} s")
            losses.clear()

    return report


def _say(line: str) -> None:
    console().print(line, markup=False, soft_wrap=True)
