"""`fbench log import`."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from fbench.cli import options
from fbench.cli.progress import import_progress
from fbench.cli.show import print_json, say
from fbench.replay.contracts.errors import EXIT_DATA, EXIT_LOSSY, EXIT_OK, ConfigError, LogError, output_error
from fbench.replay.data.files import make_parent

if TYPE_CHECKING:
    from fbench.datasets.importing.run import ImportedLog
    from fbench.replay.contracts.importing import BadInput
    from fbench.replay.logs.convert.target import Target

_SUFFIXES = (".mcap", ".parquet")


def import_(
    dataset: Annotated[str, Argument(help="Dataset, such as kitti; see `fbench plugins datasets`.")],
    source: Annotated[Path, Argument(metavar="SRC", help="The dataset's folder.")],
    out: Annotated[
        Path, Option("--out", "-o", help="FILE.mcap or FOLDER.parquet for one sequence, or a folder for several.")
    ],
    scenes: Annotated[
        list[str] | None, Option(metavar="PATTERN", help="Only these sequences, such as 'scene-01*'; repeatable.")
    ] = None,
    frames: Annotated[
        str | None, Option(metavar="A:B", help="Only these frames, numbered as in the dataset, B excluded.")
    ] = None,
    detections: Annotated[
        Path | None, Option(metavar="DIR", help="Also import the results of another system (KITTI's benchmarks).")
    ] = None,
    settings: options.Settings = None,
    skip_bad: Annotated[
        bool, Option("--skip-bad", help="Skip and count unusable input instead of stopping; exit 4.")
    ] = False,
    form: Annotated[Literal["mcap", "parquet"], Option(help="Format of the logs in a folder.")] = "mcap",
    overwrite: Annotated[bool, Option("--overwrite", help="Replace existing logs.")] = False,
    json: options.Json = False,
) -> None:
    """Turn a public dataset into fbench logs; run an interrupted import again to continue it."""
    from fbench.cli.import_lines import log_line
    from fbench.datasets.importing.guard import GuardedImporter
    from fbench.datasets.importing.run import import_recordings
    from fbench.replay.contracts.entry_points import load
    from fbench.replay.contracts.importing import BadInput, FrameRange, ImportRequest, choose_names
    from fbench.replay.contracts.plugins import default_params, make_importer
    from fbench.replay.engine.excerpt import make_excerpt

    if detections is not None:
        params = default_params(load("datasets", dataset))
        if params is None or "detections" not in {f.name for f in fields(params)}:
            raise ConfigError(f"--detections {detections}: the importer of {dataset} takes no other system's results")
        settings = [f"detections={detections}", *(settings or [])]
    importer = GuardedImporter(make_importer(dataset, settings or []), dataset)
    _require_place(out, source)
    excerpt = make_excerpt(None, None, frames)
    known = importer.names(source)
    if not known:
        raise LogError(f"{source}: no sequence of {dataset} in it")
    names = choose_names(known, scenes or [])
    bad = BadInput(skip_bad)
    targets = _choose_targets(out, form, overwrite, known, names)
    logs: list[ImportedLog] = []
    with import_progress(len(names)) as progress:
        request = ImportRequest(names, FrameRange(excerpt.first, excerpt.stop), bad)
        for log in import_recordings(importer, source, request, targets, progress):
            logs.append(log)
            with progress.finish(0 if log.written is None else log.written.num_messages):
                if len(names) > 1 and not json:
                    say(f"{log.name}: {log_line(log)}")
    if json:
        print_json({"logs": [_content(log) for log in logs], "skipped": bad.num, "first_skipped": bad.texts})
    else:
        _print_end(out, logs, bad)
    if all(log.state == "failed" for log in logs):
        raise typer.Exit(EXIT_DATA)
    raise typer.Exit(EXIT_LOSSY if bad.num else EXIT_OK)


def _require_place(out: Path, source: Path) -> None:
    """See early that something can be written."""
    if out.resolve() == source.resolve():
        raise ConfigError(f"{out}: is the dataset's own folder; choose another one for the logs")
    if out.suffix not in _SUFFIXES:
        if out.exists() and not out.is_dir():
            raise ConfigError(f"{out}: is a file; expected a name that ends in .mcap or .parquet, or a folder for logs")
    else:
        make_parent(out)


def _choose_targets(
    out: Path, form: str, overwrite: bool, known: Sequence[str], names: Sequence[str]
) -> "Mapping[str, Target]":
    from fbench.datasets.importing.guard import log_names
    from fbench.replay.logs.convert.target import Target

    if out.suffix in _SUFFIXES:
        if len(names) != 1:
            raise ConfigError(
                f"{out}: {len(names)} sequences don't fit into one log; choose one with --scenes, such as "
                f"'{names[0]}', or give a folder"
            )
        return {names[0]: Target(out, overwrite)}
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(out, error) from error
    files = log_names(known)
    return {name: Target(out / f"{files[name]}.{form}", overwrite) for name in names}


def _print_end(out: Path, logs: "Sequence[ImportedLog]", bad: "BadInput") -> None:
    from fbench.cli.import_lines import join_lines, log_line

    say(*(logs[0].lines if len(logs) == 1 else join_lines(logs)), *(f"skipped: {text}" for text in bad.texts))
    if bad.num > len(bad.texts):
        say(f"skipped: and {bad.num - len(bad.texts)} more")
    num = Counter(log.state for log in logs)
    size = sum(log.written.num_bytes for log in logs if log.written is not None)
    counts = f"{num['written']} written ({size / 1e6:.3g} MB), {num['there']} there already, {num['failed']} failed"
    say(f"log: {log_line(logs[0])}" if len(logs) == 1 else f"logs: {counts}, in {out}")


def _content(log: "ImportedLog") -> dict[str, object]:
    messages = {} if log.written is None else dict(log.written.messages)
    num_bytes = None if log.written is None else log.written.num_bytes
    return {
        "name": log.name, "path": str(log.path), "state": log.state, "bytes": num_bytes, "messages": messages,
        "summary": list(log.lines), "skipped": log.num_skipped,
    }  # fmt: skip
