"""Options that say what a log is, beside its name."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fbench.replay.logs.setup import BoxSource

Config = Annotated[
    str | None,
    typer.Option("--config", metavar="FILE", help="An fbench.toml; else the one beside the log; 'none': none at all."),
]
RigFiles = Annotated[
    list[Path] | None,
    typer.Option("--rig", metavar="FILE", help="Calibration: TOML, URDF, Kalibr or camera_info YAML; repeatable."),
]
TruthFile = Annotated[
    Path | None, typer.Option("--truth", metavar="PATH", help="Ground truth from this file or folder.")
]
TruthFormat = Annotated[
    str | None, typer.Option("--truth-format", metavar="FORMAT", help="Of --truth, where its content doesn't tell.")
]
TruthFrame = Annotated[
    str,
    typer.Option(
        "--truth-frame", metavar="NAME", help="Coordinate frame, or camera, of --truth, where the file doesn't tell."
    ),
]
DetectionsFile = Annotated[
    Path | None,
    typer.Option("--detections", metavar="PATH", help="Score these results of another system, from a file or folder."),
]
PipelineOrFile = Annotated[
    str | None,
    typer.Option(
        "--pipeline", "-p", metavar="NAME",
        help="A name (see fbench plugins), FILE.py:CLASS, FILE.toml, recorded:TOPIC or 'exec:COMMAND'.",
    ),
]  # fmt: skip
_RECORDED = "recorded"
_TAKE_RESULTS = (None, _RECORDED, "track")


def box_source(path: Path | None, form: str | None, frame: str) -> "BoxSource | None":
    """Return a file of boxes as the command line names it; `frame` is the camera too, where there are 2D boxes."""
    from fbench.replay.logs.setup import BoxSource

    return None if path is None else BoxSource(path, form, frame, frame)


def pipeline_of(name: str | None, results: "BoxSource | None") -> str:
    """Return which pipeline is meant: results need none to be named.

    Raises:
        ConfigError: where none is named, or another than results are for.
    """
    from fbench.replay.errors import ConfigError
    from fbench.replay.variants import variant_of

    if results is None and name is None:
        raise ConfigError("which pipeline? give --pipeline NAME (see fbench plugins), or --detections PATH")
    variant = None if name is None else variant_of(name)
    if results is not None and (name if variant is None else variant.base) not in _TAKE_RESULTS:
        raise ConfigError(f"--detections are results already, so --pipeline {name} can't be used with them")
    return name or _RECORDED
