"""Weights and the training of the built-in detector, and what is printed of them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from rich.table import Table

from fbench.cli.show import byte_progress, console, message_progress, print_json
from fbench.replay.contracts.errors import ConfigError

if TYPE_CHECKING:
    from fbench.pipelines.models.weights import Entry

_SHOWN = {"absent": "–", "good": "yes", "damaged": "damaged"}


def show_weights(catalogue: "Sequence[Entry]", as_json: bool) -> None:
    """Print the entries of a catalogue, and what of them is in the cache."""
    from fbench.pipelines.models.weights import state, weights_folder

    folder = weights_folder()
    rows = [(entry, state(entry, folder / entry.file_name)) for entry in catalogue]
    if as_json:
        print_json([_described(entry, folder / entry.file_name, found) for entry, found in rows])
        return
    table = Table(box=None, pad_edge=False)
    for column in ("name", "licence", "COCO AP", "MB", "input", "here", "model"):
        table.add_column(column, justify="right" if column in ("COCO AP", "MB") else "left")
    for entry, found in rows:
        cells = (f"{entry.ap:.1f}", f"{entry.num_bytes / 1e6:.1f}", "x".join(map(str, entry.input_wh)), _SHOWN[found])
        table.add_row(entry.name, entry.licence, *cells, f"{entry.model}, {entry.by}")
    console().print(table)
    _tell(f"kept in {folder}")


def get_weights(entry: "Entry", file: Path | None) -> None:
    """Fetch weights, or take them from a file, unless they are in the cache; say where they are."""
    from fbench.pipelines.models.weights import downloaded, file_blocks, state, store, weights_folder

    target = weights_folder() / entry.file_name
    if state(entry, target) == "good":
        _tell(f"{target}: there already, sha256 checked")
    else:
        blocks = file_blocks(file) if file is not None else downloaded(entry, target)
        with byte_progress(entry.file_name, entry.num_bytes) as progress:
            store(entry, _counted(blocks, progress), str(file or entry.url), target)
        _tell(f"{target}: {entry.model} by {entry.by}, {entry.licence}, sha256 checked")
    _tell(f"use it with --set camera.weights={entry.name}")


def _tell(line: str) -> None:
    console().print(line, soft_wrap=True)


def _counted(blocks: Iterable[bytes], progress: Callable[[int], None]) -> Iterator[bytes]:
    num_bytes = 0
    for block in blocks:
        num_bytes += len(block)
        progress(num_bytes)
        yield block


def _described(entry: "Entry", path: Path, found: str) -> dict[str, object]:
    return {
        "name": entry.name,
        "model": entry.model,
        "by": entry.by,
        "licence": entry.licence,
        "coco_ap": entry.ap,
        "input_wh": list(entry.input_wh),
        "page": entry.page,
        "url": entry.url,
        "sha256": entry.sha256,
        "bytes": entry.num_bytes,
        "path": str(path),
        "state": found,
    }


_SAID_EVERY = 100  # Steps


def train_detector(folder: Path, out: Path, seed: int | None, steps: int | None, device: str, threads: int) -> None:
    """Train on the logs of a folder, go on from a checkpoint beside `out` where there is one, and write an ONNX file.
    Raises ConfigError without torch, logs, or the device.
    """
    torch = _torch()
    if out.suffix != ".onnx":
        raise ConfigError(f"{out}: expected a name that ends in .onnx")
    if not out.absolute().parent.is_dir():
        raise ConfigError(f"{out}: can't be written (no folder {out.absolute().parent})")
    if device == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device cuda: torch finds no CUDA device here")
    torch.set_num_threads(threads)
    from fbench.pipelines.models.network import export
    from fbench.pipelines.models.samples import TrainingSettings, samples
    from fbench.pipelines.models.train import Training

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
