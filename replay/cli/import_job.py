"""One import from the command line: which sequences go into which logs, and what is said of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fbench.replay.cli.progress import import_progress
from fbench.replay.cli.show import console, print_json
from fbench.replay.errors import EXIT_LOSSY, EXIT_OK, ConfigError
from fbench.replay.excerpt import make_excerpt
from fbench.replay.imports.run import ImportedLog, import_recordings
from fbench.replay.imports.wish import BadInput, FrameRange, ImportWish, chosen_names
from fbench.replay.logs.convert.target import Target
from fbench.replay.plugins import make_importer

Form = Literal["mcap", "parquet"]
SUFFIXES = (".mcap", ".parquet")


@dataclass(frozen=True)
class ImportJob:
    """Everything that `fbench log import` was asked for."""

    dataset: str
    source: Path
    out: Path
    settings: Sequence[str] = ()
    scenes: Sequence[str] = ()
    frames: str | None = None
    skip_bad: bool = False
    form: Form = "mcap"
    """Of the logs in a folder."""
    overwrite: bool = False
    as_json: bool = False


def run_import(job: ImportJob) -> int:
    """Import, and print what was found; returns the exit code.

    Raises:
        ConfigError: where a log can't or mustn't be written.
        LogError: naming what is wrong with the dataset.
    """
    importer = make_importer(job.dataset, list(job.settings))
    _require_place(job)
    names = chosen_names(importer.names(job.source), job.scenes)
    targets = _targets(job, names)
    wish = ImportWish(names, _frames(job.frames), BadInput(job.skip_bad))
    logs: list[ImportedLog] = []
    with import_progress(len(names)) as progress:
        for log in import_recordings(importer, job.source, wish, targets, progress):
            logs.append(log)
            progress.finish()
            if not job.as_json:
                _print_log(log, len(names) > 1)
    if job.as_json:
        print_json({"logs": [_content(log) for log in logs], "skipped": wish.bad.num, "first_skipped": wish.bad.texts})
    else:
        _print_end(job, logs, wish.bad)
    return EXIT_LOSSY if wish.bad.num else EXIT_OK


def _require_place(job: ImportJob) -> None:
    """See early that something can be written."""
    out = job.out
    if out.suffix not in SUFFIXES:
        if out.is_file():
            raise ConfigError(f"{out}: is a file; expected a name that ends in .mcap or .parquet, or a folder for logs")
        return
    if not out.absolute().parent.is_dir():
        raise ConfigError(f"{out}: can't be written (no folder {out.absolute().parent})")


def _targets(job: ImportJob, names: Sequence[str]) -> Mapping[str, Target]:
    """Which sequence goes into which log."""
    if job.out.suffix in SUFFIXES:
        if len(names) != 1:
            raise ConfigError(
                f"{job.out}: {len(names)} sequences don't fit into one log; choose one with --scenes, such as "
                f"'{names[0]}', or give a folder"
            )
        return {names[0]: Target(job.out, job.overwrite)}
    job.out.mkdir(parents=True, exist_ok=True)
    return {name: Target(job.out / f"{_file_name(name)}.{job.form}", job.overwrite) for name in names}


def _file_name(name: str) -> str:
    return "".join(c if c.isalnum() or c in "._-+" else "_" for c in name)


def _frames(text: str | None) -> FrameRange:
    excerpt = make_excerpt(None, None, text)
    return FrameRange(excerpt.first, excerpt.stop)


def _content(log: ImportedLog) -> dict[str, object]:
    messages = {} if log.written is None else dict(log.written.messages)
    num_bytes = None if log.written is None else log.written.num_bytes
    return {
        "name": log.name, "path": str(log.path), "state": log.state, "bytes": num_bytes, "messages": messages,
        "summary": list(log.lines),
    }  # fmt: skip


def _print_log(log: ImportedLog, is_one_of_many: bool) -> None:
    printer = console()
    if is_one_of_many:
        printer.print(f"{log.name}:", markup=False, soft_wrap=True)
    for line in log.lines:
        printer.print(line, markup=False, soft_wrap=True)
    printer.print(_state(log), markup=False, soft_wrap=True)


def _state(log: ImportedLog) -> str:
    if log.state == "there":
        return f"log: {log.path} is there already, from an equal import"
    if log.written is None:
        return f"log: {log.path} isn't written"
    num = sum(log.written.messages.values())
    return f"log: {log.path}: {num} messages, {log.written.num_bytes / 1e6:.3g} MB"


def _print_end(job: ImportJob, logs: Sequence[ImportedLog], bad: BadInput) -> None:
    printer = console()
    if len(logs) > 1:
        num = {state: sum(log.state == state for log in logs) for state in ("written", "there", "failed")}
        counts = f"{num['written']} written, {num['there']} there already, {num['failed']} failed"
        printer.print(f"logs: {counts}, in {job.out}", markup=False, soft_wrap=True)
    for text in bad.texts:
        printer.print(f"skipped: {text}", markup=False, soft_wrap=True)
    if bad.num:
        printer.print(f"skipped in all: {bad.num}", markup=False, soft_wrap=True)
