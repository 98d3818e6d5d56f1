"""`fbench weights`: detectors for real images."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from fbench.cli import options as examples
from fbench.cli.options import Json

app = typer.Typer(help="List and fetch camera detectors for real images.", no_args_is_help=True)


@app.command("list", epilog=examples.WEIGHTS_LIST)
def list_(json: Json = False) -> None:
    """List the detectors that fbench knows by name, and which of them are here; needs no network."""
    from fbench.cli.weights_job import show_weights
    from fbench.pipelines.models.weights import CATALOGUE

    show_weights(CATALOGUE, json)


@app.command("get", epilog=examples.WEIGHTS_GET)
def get(
    name: Annotated[str, typer.Argument(help="Which, such as deimv2-femto; see `fbench weights list`.")],
    file: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Take in this file, fetched by hand, instead of downloading it."),
    ] = None,
) -> None:
    """Fetch a detector, check it against its published sha256, and keep it in fbench's cache."""
    from fbench.cli.weights_job import get_weights
    from fbench.pipelines.models.weights import entry_named

    get_weights(entry_named(name), file)


@app.command("train", epilog=examples.WEIGHTS_TRAIN)
def train(
    folder: Annotated[Path, typer.Argument(metavar="LOGS", help="Folder of logs with images and 2D truth.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE.onnx", help="Where the weights go.")],
    seed: Annotated[int | None, typer.Option(min=0, help="Other first weights and other views of the images.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Fewer for a trial.")] = None,
    device: Annotated[Literal["cpu", "cuda"], typer.Option(help="Where to compute.")] = "cpu",
    threads: Annotated[int, typer.Option(min=1, max=256, help="Of the CPU.")] = 2,
) -> None:
    """Train the built-in detector anew, or one for your own logs; interrupted, it goes on where it was."""
    from fbench.cli.weights_job import train_detector

    train_detector(folder, out, seed, steps, device, threads)
