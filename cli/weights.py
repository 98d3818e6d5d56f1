"""`fbench weights`: detectors for real images."""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from fbench.cli import options
from fbench.cli.progress import byte_progress, message_progress, replay_progress
from fbench.cli.show import console, fault_lines, make_table, print_json, say
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.files import expand_user, make_parent
from fbench.replay.data.scores import format_count

if TYPE_CHECKING:
    from fbench.pipelines.models.weights import Entry

_SHOWN = {"absent": "–", "good": "yes", "damaged": "damaged"}
_STEPS_A_LINE = 100

app = typer.Typer(help="List and fetch camera detectors for real images.", no_args_is_help=True)


@app.command("list", epilog=options.examples("weights list"))
def list_(json: options.Json = False) -> None:
    """List the detectors that fbench knows by name, and which of them are here; needs no network."""
    from fbench.pipelines.models.weights import CATALOGUE

    show_weights(CATALOGUE, json)


@app.command("get", epilog=options.examples("weights get"))
def get(
    name: Annotated[str, Argument(help="Weights, such as deimv2-femto; see `fbench weights list`.")],
    file: Annotated[
        Path | None,
        Option("--from", metavar="FILE", help="Use this file, which you downloaded, instead of downloading it."),
    ] = None,
) -> None:
    """Fetch a detector, check it against its published sha256, and keep it in fbench's cache."""
    from fbench.pipelines.models.weights import find_entry

    get_weights(find_entry(name), file)


@app.command("train", epilog=options.examples("weights train"))
def train(
    logs: Annotated[
        list[Path],
        Argument(
            metavar="LOGS...", help="Logs with truth, or folders of them: 2D for camera and rgbd, 3D for learned3d."
        ),
    ],
    out: Annotated[Path, Option("--out", "-o", metavar="FILE.onnx", help="File for the weights.")],
    model: Annotated[
        Literal["camera", "rgbd", "learned3d"],
        Option(help="The camera detector, the one with points in its image, or the bird's-eye network of learned3d."),
    ] = "camera",
    weights: Annotated[
        str | None,
        Option(
            metavar="FILE|auto",
            help="Weights to start from ('auto': the built-in ones); steps and learning rate default to a quarter.",
        ),
    ] = None,
    seed: Annotated[
        int | None, Option(min=0, max=2**63 - 1, help="Seed of the initial weights and of the augmentation.")
    ] = None,
    steps: Annotated[int | None, Option(min=1, help="Number of training steps; use fewer for a trial.")] = None,
    device: Annotated[Literal["cpu", "cuda"], Option(help="Device on which to train.")] = "cpu",
    threads: Annotated[int, Option(min=1, max=256, help="Number of CPU threads.")] = 2,
    overwrite: Annotated[bool, Option("--overwrite", help="Replace an existing file, and its card.")] = False,
) -> None:
    """Train a built-in detector again, or one for your own logs; run it again to continue after an interruption."""
    try:
        import onnx  # noqa: F401
        import torch
    except ImportError as error:
        raise ConfigError(f"training needs {error.name}: pip install 'fbench[torch]'") from error
    if out.suffix != ".onnx":
        raise ConfigError(f"{out}: expected a name that ends in .onnx")
    if out.is_dir():
        raise ConfigError(f"{out}: is a folder; name a file for the weights")
    for path in (out, out.with_suffix(".json")):
        if path.exists() and not overwrite:
            raise ConfigError(f"{path}: exists; replace it with --overwrite, or name another file with -o")
    make_parent(out)
    if device == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device cuda: torch finds no CUDA device here")
    from fbench.pipelines.models.recipes import Recipe, TrainRequest
    from fbench.pipelines.models.weights import AUTO, resolve

    start = AUTO if weights == AUTO else None if weights is None else resolve(expand_user(weights))
    recipe = Recipe(TrainRequest(model, _find_logs(logs, model), seed, steps, device, threads, start))
    loop = recipe.loop
    num_recorded = recipe.num_recorded
    num = format_count(len(loop.samples), "frame" if model == "learned3d" else "image")
    num += f" ({num_recorded} recorded)" if 0 < num_recorded < len(loop.samples) else ""
    say(f"{num}, {format_count(loop.settings.steps, 'step')}, seed {loop.settings.seed}")
    say(*fault_lines([row for row in recipe.faults.rows() if row["behaviour"] == "count"]))
    checkpoint = out.with_suffix(".checkpoint")
    if checkpoint.is_file():
        loop.resume(checkpoint)
        say(f"goes on from step {loop.step}")
    try:
        with message_progress(out.name, loop.settings.steps) as progress:
            network = loop.run(checkpoint, _reporter(progress))
    except KeyboardInterrupt:
        if checkpoint.is_file():
            sys.stderr.write("run the same command again to go on from the last checkpoint\n")
        raise
    card = recipe.finish(network, out)
    checkpoint.unlink()
    say(f"weights: {out}", f"card: {card}")


@app.command("compare", epilog=options.examples("weights compare"))
def compare(
    log: options.Log,
    weights: Annotated[
        list[str],
        Argument(metavar="MODEL...", help="ONNX files, or names such as deimv2-femto; see `fbench weights list`."),
    ],
    min_score: Annotated[float, Option(metavar="SCORE", help="Rank boxes from this score on.")] = 0.05,
    settings: options.Settings = None,
    config: options.Config = None,
    rig: options.RigFiles = None,
    decoder: options.Decoders = None,
    truth: options.TruthFile = None,
    truth_format: options.TruthFormat = None,
    truth_frame: options.TruthFrame = "",
    sensors: options.Sensors = None,
    from_: options.From = None,
    to: options.To = None,
    frames: options.Frames = None,
    condition: options.Condition = "",
    seed: options.Seed = 0,
    device: options.Device = "cpu",
    out: Annotated[Path, Option("--out", "-o", help="Folder of the runs, weights.json and report.html.")] = Path(
        "runs/weights"
    ),
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Compare camera detectors on one log: precision, recall by distance, time by stage, and size."""
    from fbench.api.detectors import DetectorRequest, compare_detectors, comparison_content, comparison_table
    from fbench.replay.setup.request import ReplayRequest
    from fbench.replay.setup.source import LogRequest

    boxes = options.box_source(truth, truth_format, truth_frame)
    request = ReplayRequest(
        LogRequest(log, config, rig or (), boxes, decoder=decoder or ()), "camera2d", settings=settings or (),
        sensors=sensors or (), from_=from_, to=to, frames=frames, condition=condition, seed=seed, out=out,
        overwrite=overwrite, on_fault="tolerant", no_media=True, device=device,
    )  # fmt: skip
    what = DetectorRequest(request, weights, min_score)
    with replay_progress(f"{log.name} → camera2d") as progress:
        found = compare_detectors(what, progress)
    if json:
        print_json({"folder": str(found.folder), **comparison_content(found)})
        return
    header, rows = comparison_table(found)
    for part in (slice(1, 10), slice(10, None)):
        table = make_table(header[0], *header[part], right=header[3:])
        for row in rows:
            table.add_row(row[0], *row[part])
        console().print(table)
    say(f"scored: {found.num_frames} frames, {found.matching}; precision and recall from the score with the best F1 on")
    say(f"comparison: {found.folder}", f"plots: {found.folder / 'report.html'}")


def show_weights(catalogue: "Sequence[Entry]", as_json: bool) -> None:
    """Print the entries of a catalogue, and what of them is in the cache."""
    from fbench.pipelines.models.weights import state, weights_folder

    folder = weights_folder()
    rows = [(entry, state(entry, folder / entry.file_name)) for entry in catalogue]
    if as_json:
        names = ("name", "model", "by", "licence", "ap", "input_wh", "page", "url", "sha256", "num_bytes")
        public = {"ap": "coco_ap", "num_bytes": "bytes"}
        content = [
            {public.get(name, name): getattr(entry, name) for name in names}
            | {"path": str(folder / entry.file_name), "state": found}
            for entry, found in rows
        ]
        print_json(content)
        return
    table = make_table("name", "licence", "COCO AP", "MB", "input", "here", "model", right=("COCO AP", "MB"))
    for entry, found in rows:
        cells = (f"{entry.ap:.1f}", f"{entry.num_bytes / 1e6:.1f}", "x".join(map(str, entry.input_wh)), _SHOWN[found])
        table.add_row(entry.name, entry.licence, *cells, f"{entry.model}, {entry.by}")
    console().print(table)
    say(f"kept in {folder}")


def get_weights(entry: "Entry", file: Path | None) -> None:
    """Fetch weights, or take them from a file, unless they are in the cache; say where they are."""
    from fbench.pipelines.models.weights import download, file_blocks, state, store, weights_folder

    target = weights_folder() / entry.file_name
    if state(entry, target) == "good":
        say(f"{target}: there already, sha256 checked")
    else:
        blocks = file_blocks(file) if file is not None else download(entry, target)
        with byte_progress(entry.file_name, entry.num_bytes) as progress:
            store(entry, _count(blocks, progress), str(file or entry.url), target)
        say(f"{target}: {entry.model} by {entry.by}, {entry.licence}, sha256 checked")
    say(f"use it with --set camera.weights={entry.name}")


def _count(blocks: Iterable[bytes], progress: Callable[[int], None]) -> Iterator[bytes]:
    num_bytes = 0
    for block in blocks:
        num_bytes += len(block)
        progress(num_bytes)
        yield block


def _find_logs(places: Iterable[Path], model: str) -> Sequence[Path]:
    from fbench.replay.logs.open import find_logs

    what = "training-points" if model == "learned3d" else "training"
    found = dict[Path, Path]()  # By where they are, as a log counts once however it is named
    for place in places:
        hint = "" if place.suffix else f"; to make logs: fbench log simulate {what} -o {place}"
        if not place.exists():
            raise ConfigError(f"{place}: no such file or folder{hint}")
        if not (own := find_logs(place)):
            raise ConfigError(f"{place}: no logs in it{hint}")
        for path in own:
            found.setdefault(path.resolve(), path)
    return list(found.values())


def _reporter(progress: Callable[[int], None]) -> Callable[[int, float], None]:
    begun, losses = monotonic(), list[float]()

    def report(step: int, loss: float) -> None:
        progress(step)
        losses.append(loss)
        if step % _STEPS_A_LINE == 0:
            say(f"step {step}: loss {sum(losses) / len(losses):.3f}, {monotonic() - begun:.0f} s")
            losses.clear()

    return report
