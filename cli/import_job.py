"""One import from the command line: sequences, logs, and the summary."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Literal

from fbench.cli.show import ImportProgress, console, import_progress, print_json
from fbench.datasets.importing.files import format_counts, format_list
from fbench.datasets.importing.guard import GuardedImporter, log_names
from fbench.datasets.importing.run import ImportedLog, import_recordings
from fbench.replay.contracts.errors import EXIT_DATA, EXIT_LOSSY, EXIT_OK, ConfigError, LogError
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportWish, chosen_names
from fbench.replay.contracts.plugins import make_importer
from fbench.replay.engine.excerpt import make_excerpt
from fbench.replay.logs.convert.target import Target

_NUMBER = re.compile(r"(?<![\w.-])-?\d+(?:\.\d+)?(?![\w.]*\d)")
_PAIR = r"\w[^:,()]* \d+"
_PAIRS = re.compile(rf"(?:: | \()({_PAIR}(?:, {_PAIR})*)(?:\)|$)")
"""Counts by name, all that a line says or in brackets: `: Car 3, Van 1`."""
_NAMED = 3
_ALIKE = 3  # So many forms of a line are shown of one subject


def log_line(log: ImportedLog) -> str:
    """Return what became of a sequence."""
    if log.state == "there":
        return f"{log.path} is there already, made the same way"
    skipped = f", {log.num_skipped} skipped" if log.num_skipped else ""
    if log.written is None:
        return f"{log.path} isn't written{skipped}"
    num = sum(log.written.messages.values())
    return f"{log.path}: {num} messages, {log.written.num_bytes / 1e6:.3g} MB{skipped}"


def counts_line(logs: Sequence[ImportedLog]) -> str:
    """Return how many logs came out which way."""
    num = {state: sum(log.state == state for log in logs) for state in ("written", "there", "failed")}
    size = sum(log.written.num_bytes for log in logs if log.written is not None)
    return f"{num['written']} written ({size / 1e6:.3g} MB), {num['there']} there already, {num['failed']} failed"


@dataclass
class _Form:
    """Lines that differ in their numbers only."""

    texts: list[str]  # Between the numbers
    low: list[str]
    high: list[str]
    names: list[str] = field(default_factory=list)

    def add(self, name: str, numbers: list[str]) -> None:
        """Take a line of the sequence `name` in."""
        self.low = [min(pair, key=Decimal) for pair in zip(self.low, numbers, strict=True)]
        self.high = [max(pair, key=Decimal) for pair in zip(self.high, numbers, strict=True)]
        if name not in self.names:
            self.names.append(name)

    def __str__(self) -> str:
        spans = [a if a == b else f"{a}..{b}" for a, b in zip(self.low, self.high, strict=True)]
        return "".join(text for pair in zip(self.texts, [*spans, ""], strict=True) for text in pair)


@dataclass
class _Subject:
    """Lines of one subject, the text before the first colon."""

    forms: dict[tuple[str, ...], _Form] = field(default_factory=dict)
    totals: Counter[str] = field(default_factory=Counter)

    def add(self, name: str, line: str) -> None:
        """Take a line of the sequence `name` in."""
        if counts := _PAIRS.search(line):
            for pair in counts[1].split(", "):
                thing, _, num = pair.rpartition(" ")
                self.totals[thing] += int(num)
            line = line[: counts.start()] + line[counts.end() :]
            if counts[0].startswith(":"):
                return
        texts, numbers = _NUMBER.split(line), _NUMBER.findall(line)
        form = self.forms.setdefault(tuple(texts), _Form(texts, numbers, numbers))
        form.add(name, numbers)


def joined_lines(logs: Sequence[ImportedLog]) -> Iterator[str]:
    """Yield what was found in many sequences.

    Lines alike become one, with the range of each number; counts by name alone are summed up. A line that not all
    sequences have ends with how many do, and with the first ones. Subjects keep the order in which they came; those
    with many forms show the most frequent ones.
    """
    written = [log for log in logs if log.state == "written"]
    subjects: dict[str, _Subject] = {}
    for log in written:
        for line in log.lines:
            subjects.setdefault(line.partition(":")[0], _Subject()).add(log.name, line)
    for title, subject in subjects.items():
        yield from _subject_lines(title, subject, len(written))


def _subject_lines(title: str, subject: _Subject, num_logs: int) -> Iterator[str]:
    ordered = sorted(subject.forms.values(), key=lambda form: -len(form.names))
    for form in ordered[:_ALIKE]:
        yield _shown(form, num_logs)
    if others := ordered[_ALIKE:]:
        num = len({name for form in others for name in form.names})
        yield f"{title}: otherwise in {num} of {num_logs}, see --json"
    if subject.totals:
        yield f"{title}, in all: {format_counts(subject.totals)}"


def _shown(form: _Form, num_logs: int) -> str:
    if len(form.names) == num_logs:
        return str(form)
    return f"{form} [{len(form.names)} of {num_logs}: {format_list(form.names, _NAMED)}]"


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
    form: Form = "mcap"  # Of the logs in a folder
    overwrite: bool = False
    as_json: bool = False


def run_import(job: ImportJob) -> int:
    """Import, and print what was found; returns the exit code. Raises ConfigError where a log can't or mustn't be
    written. Raises LogError naming what is wrong with the dataset. Raises RunError where the importer fails.
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
