"""One import from the command line: which sequences go into which logs, and what is said of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fbench.replay.cli.import_report import counts_line, joined_lines, log_line
from fbench.replay.cli.progress import ImportProgress, import_progress
from fbench.replay.cli.show import console, print_json
from fbench.replay.errors import EXIT_DATA, EXIT_LOSSY, EXIT_OK, ConfigError, LogError
from fbench.replay.excerpt import make_excerpt
from fbench.replay.imports.guard import GuardedImporter
from fbench.replay.imports.log_names import log_names
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
        RunError: where the importer fails.
    """
    importer = GuardedImporter(make_importer(job.dataset, list(job.settings)), job.dataset)
    _require_place(job)
    wished = _frames(job.frames)
    known = importer.names(job.source)
    if not known:
        raise LogError(f"{job.source}: no sequence of {job.dataset} in it")
    names = chosen_names(known, job.scenes)
    wish = ImportWish(names, wished, BadInput(job.skip_bad))
    targets = _targets(job, known, names)
    with import_progress(len(names)) as progress:
        logs = _imported(job, importer, wish, targets, progress)
    _print_end(job, logs, wish.bad)
    return _exit_code(logs, wish.bad)


def _imported(
    job: ImportJob,
    importer: GuardedImporter,
    wish: ImportWish,
    targets: Mapping[str, Target],
    progress: ImportProgress,
) -> list[ImportedLog]:
    logs = []
    for log in import_recordings(importer, job.source, wish, targets, progress):
        logs.append(log)
        with progress.finished(0 if log.written is None else sum(log.written.messages.values())):
            if len(wish.names) > 1 and not job.as_json:
                _print(f"{log.name}: {log_line(log)}")
    return logs


def _exit_code(logs: Sequence[ImportedLog], bad: BadInput) -> int:
    if all(log.state == "failed" for log in logs):
        return EXIT_DATA
    return EXIT_LOSSY if bad.num else EXIT_OK


def _require_place(job: ImportJob) -> None:
    """See early that something can be written."""
    out = job.out
    if out.resolve() == job.source.resolve():
        raise ConfigError(f"{out}: is the dataset's own folder; choose another one for the logs")
    if out.suffix not in SUFFIXES:
        if out.exists() and not out.is_dir():
            raise ConfigError(f"{out}: is a file; expected a name that ends in .mcap or .parquet, or a folder for logs")
    elif not out.absolute().parent.is_dir():
        raise ConfigError(f"{out}: can't be written (no folder {out.absolute().parent})")


def _targets(job: ImportJob, known: Sequence[str], names: Sequence[str]) -> Mapping[str, Target]:
    """Which sequence goes into which log."""
    if job.out.suffix in SUFFIXES:
        if len(names) != 1:
            raise ConfigError(
                f"{job.out}: {len(names)} sequences don't fit into one log; choose one with --scenes, such as "
                f"'{names[0]}', or give a folder"
            )
        return {names[0]: Target(job.out, job.overwrite)}
    try:
        job.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{job.out}: can't be written ({error.strerror})") from error
    files = log_names(known)
    return {name: Target(job.out / f"{files[name]}.{job.form}", job.overwrite) for name in names}


def _frames(text: str | None) -> FrameRange:
    excerpt = make_excerpt(None, None, text)
    return FrameRange(excerpt.first, excerpt.stop)


def _print_end(job: ImportJob, logs: Sequence[ImportedLog], bad: BadInput) -> None:
    if job.as_json:
        print_json({"logs": [_content(log) for log in logs], "skipped": bad.num, "first_skipped": bad.texts})
        return
    for line in logs[0].lines if len(logs) == 1 else joined_lines(logs):
        _print(line)
    for text in bad.texts:
        _print(f"skipped: {text}")
    if bad.num > len(bad.texts):
        _print(f"skipped: and {bad.num - len(bad.texts)} more")
    _print(f"log: {log_line(logs[0])}" if len(logs) == 1 else f"logs: {counts_line(logs)}, in {job.out}")


def _content(log: ImportedLog) -> dict[str, object]:
    messages = {} if log.written is None else dict(log.written.messages)
    num_bytes = None if log.written is None else log.written.num_bytes
    return {
        "name": log.name, "path": str(log.path), "state": log.state, "bytes": num_bytes, "messages": messages,
        "summary": list(log.lines), "skipped": log.num_skipped,
    }  # fmt: skip


def _print(line: str) -> None:
    """Print one line, whatever names in it a dataset gave."""
    console().print(line.replace("\n", " "), markup=False, soft_wrap=True)
