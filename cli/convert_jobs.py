"""Conversion, export and preview of logs from the command line."""

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from fbench.cli.show import console, fault_lines, frame_progress, import_progress, message_progress, print_json
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK, ConfigError
from fbench.replay.contracts.faults import FaultLog, explain_losses
from fbench.replay.data.files import swap
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.formats.export import Export, Exported, export
from fbench.replay.logs.convert.run import Converted, Wish, convert
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.open import open_container
from fbench.replay.logs.partial_rig import partial_rig
from fbench.replay.logs.setup import StampParams
from fbench.replay.setup.source import LogSource

_NO_USE = "LOG012"  # Topics that fbench has no use for are converted like all others


def run_convert(source: Path, target: Target, wish: Wish, as_json: bool) -> int:
    """Convert a log and print what was written; returns the exit code."""
    faults = FaultLog()
    with explain_losses(faults):
        container = open_container(source, faults)
        total = sum(container.counts.values())
        with message_progress(f"{source.name} → {target.path.name}", total) as progress:
            result = convert(container, target, wish, progress)
    rows = [row for row in faults.rows() if row["code"] != _NO_USE]
    if as_json:
        print_json({**_content(result), "faults": rows})
    else:
        _print(result, rows)
    return EXIT_LOSSY if faults.lost else EXIT_OK


def _content(result: Converted) -> dict[str, object]:
    return {**asdict(result), "path": str(result.path)}


def _print(result: Converted, rows: list[dict[str, Any]]) -> None:
    out = console()
    table = Table(box=None, pad_edge=False)
    table.add_column("topic", overflow="fold")
    table.add_column("messages", justify="right")
    for topic, num in result.messages.items():
        table.add_row(topic, str(num))
    out.print(table)
    for line in _lines(result, rows):
        out.print(line, markup=False, soft_wrap=True)


def _lines(result: Converted, rows: list[dict[str, Any]]) -> Iterator[str]:
    for topic, num in result.left_out.items():
        yield f"left out: {num} messages on {topic}, which fbench doesn't understand"
    yield from fault_lines(rows)
    rigs = f", {result.num_rigs} {'rig' if result.num_rigs == 1 else 'rigs'}" if result.num_rigs else ""
    parts = f" in {len(result.parts)} parts" if result.parts else ""
    total = sum(result.messages.values())
    yield f"id: {result.log_id}"
    yield f"log: {result.path}: {total} messages{rigs}, {result.num_bytes / 1e6:.3g} MB{parts}"


def run_export(job: Export, as_json: bool) -> int:
    """Export, and print what was written and what was left out; returns the exit code. Raises ConfigError where files
    can't or mustn't be written. Raises FbenchError where a source can't be read, or the format can't hold what it has.
    """
    faults = FaultLog()
    printer = console()
    done: list[Exported] = []
    with explain_losses(faults), import_progress(len(job.sources)) as progress:
        for exported in export(job, faults, progress):
            done.append(exported)
            with progress.finished(exported.num_frames):
                if not as_json:
                    printer.print(_line(exported).replace("\n", " "), markup=False, soft_wrap=True)
    rows = faults.rows()
    if as_json:
        path = str(job.place.path)
        print_json({"format": job.request.format, "path": path, "sequences": _export_job_content(done), "faults": rows})
    else:
        for line in [*fault_lines(rows), f"{job.request.format}: {job.place.path}"]:
            printer.print(line, markup=False, soft_wrap=True)
    return EXIT_LOSSY if faults.lost else EXIT_OK


def _export_job_content(done: Sequence[Exported]) -> list[dict[str, object]]:
    return [
        {
            "name": one.name, "frames": one.num_frames, "rows": one.num_rows, "left_out": dict(one.left_out),
            "view": one.view,
        }
        for one in done
    ]  # fmt: skip


def _line(one: Exported) -> str:
    left = ", ".join(f"{num} {reason}" for reason, num in one.left_out.items())
    found = f"{one.name}: {one.num_rows} rows in {one.num_frames} frames, {one.view}"
    return f"{found}; left out: {left}" if left else found


if TYPE_CHECKING:
    from fbench.reports.preview.collect import Content

TIMEOUT_NS = 1_000_000_000
"""So long a frame waits for its sensors: also what a replay would find too late is drawn, as wrong stamps make it."""


@dataclass(frozen=True)
class PreviewJob:
    """Everything that `fbench log preview` was asked for."""

    log: LogSource
    out: Path | None = None
    overwrite: bool = False
    num: int = 6
    sync: SyncParams = field(default_factory=lambda: SyncParams(timeout_ns=TIMEOUT_NS))
    stamps: StampParams = field(default_factory=StampParams)
    excerpt: Excerpt = field(default_factory=Excerpt)
    as_json: bool = False

    @property
    def folder(self) -> Path:
        """Where the pictures go."""
        return self.out or Path(f"{self.log.path.resolve().stem}-preview")


def run_preview(job: PreviewJob) -> None:
    """Read a log, draw it, and print where and what was found. Raises ConfigError where the folder exists or can't be
    written. Raises LogError where the log can't be read, or has no frames.
    """
    from fbench.reports.preview.collect import PreviewRequest, collect
    from fbench.reports.preview.preview import write_preview

    faults = FaultLog()
    with explain_losses(faults), new_folder(job.folder, job.overwrite) as folder:
        reader = job.log.open(faults)
        with frame_progress(f"{job.log.path.name}: reading") as progress:
            wish = PreviewRequest(job.num, job.sync, job.stamps, job.excerpt)
            material = collect(reader, partial_rig(reader), wish, faults, progress)
        content = write_preview(material, folder)
    if job.as_json:
        print_json(_preview_job_content(job, content, faults))
    else:
        _preview_job_print(job, content, faults)


@contextmanager
def new_folder(folder: Path, overwrite: bool) -> Iterator[Path]:
    """Give a folder under a temporary name, which becomes `folder` when all went well. Raises ConfigError where
    `folder` is there already and isn't to be replaced, or can't be written.
    """
    if folder.exists() and not overwrite:
        raise ConfigError(f"{folder}: exists already; choose another with --out, or --overwrite it")
    if folder.exists() and not (folder / "index.html").is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(f"{folder}: isn't a preview, so it isn't overwritten; choose another with --out")
    partial = folder.with_name(f".{folder.name}.partial-{os.getpid()}")
    try:
        partial.mkdir(parents=True)
    except OSError as error:
        raise ConfigError(f"{folder}: can't be written ({error.strerror}); choose another with --out") from error
    try:
        yield partial
        swap(partial, folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _preview_job_content(job: PreviewJob, content: "Content", faults: FaultLog) -> dict[str, object]:
    return {
        "folder": str(job.folder),
        "sheet": str(job.folder / "index.html"),
        "sensors": [asdict(row) for row in content.sensors],
        "verdicts": [asdict(verdict) for verdict in content.verdicts],
        "gaps": list(content.gaps),
        "frames": [frame.index for frame in content.frames],
        "pictures": [asdict(shown) for shown in content.pictures],
        "faults": faults.rows(),
    }


def _preview_job_print(job: PreviewJob, content: "Content", faults: FaultLog) -> None:
    out = console()
    for verdict in content.verdicts:
        mark = "!" if verdict.is_bad else " "
        out.print(f"{mark} {verdict.what} {verdict.about}: {verdict.text}", markup=False, soft_wrap=True)
    for gap in content.gaps:
        out.print(f"  not shown: {gap}", markup=False, soft_wrap=True)
    for line in fault_lines(faults.rows()):
        out.print(line, markup=False, soft_wrap=True)
    frames = f"{len(content.frames)} {'frame' if len(content.frames) == 1 else 'frames'}"
    sheet = job.folder / "index.html"
    out.print(f"preview: {sheet} ({frames}, {len(content.pictures)} pictures)", markup=False, soft_wrap=True)
