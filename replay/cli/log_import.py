"""`fbench log import`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from fbench.replay.cli.options import Json, Settings


def import_(
    dataset: Annotated[str, typer.Argument(help="Which dataset, such as kitti; see `fbench plugins datasets`.")],
    source: Annotated[Path, typer.Argument(metavar="SRC", help="The dataset's folder.")],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="FILE.mcap or FOLDER.parquet for one sequence, else a folder for all logs."),
    ],
    scenes: Annotated[
        list[str] | None,
        typer.Option("--scenes", metavar="PATTERN", help="Only these sequences, such as 'scene-01*'; repeatable."),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option("--frames", metavar="A:B", help="Only these frames, as the dataset numbers them, B left out."),
    ] = None,
    detections: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Take in another system's results; KITTI's benchmarks have files for them."),
    ] = None,
    settings: Settings = None,
    skip_bad: Annotated[
        bool, typer.Option("--skip-bad", help="Skip and count what can't be used, instead of ending there; exit 4.")
    ] = False,
    form: Annotated[Literal["mcap", "parquet"], typer.Option(help="Of the logs in a folder.")] = "mcap",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing logs.")] = False,
    json: Json = False,
) -> None:
    """Turn a public dataset into fbench logs; an import that was interrupted goes on when it is run again."""
    from fbench.replay.cli.import_job import ImportJob, run_import

    wanted = [] if detections is None else [_detections(dataset, detections)]
    job = ImportJob(
        dataset=dataset,
        source=source,
        out=out,
        settings=[*wanted, *(settings or [])],
        scenes=scenes or [],
        frames=frames,
        skip_bad=skip_bad,
        form=form,
        overwrite=overwrite,
        as_json=json,
    )
    raise typer.Exit(run_import(job))


def _detections(dataset: str, folder: Path) -> str:
    from dataclasses import fields

    from fbench.replay.errors import ConfigError
    from fbench.replay.plugins import default_params, load

    params = default_params(load("datasets", dataset))
    if params is None or "detections" not in {f.name for f in fields(params)}:
        raise ConfigError(f"--detections {folder}: the importer of {dataset} takes no other system's results")
    return f"detections={folder}"
