"""What `fbench log preview` does and prints."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.replay.cli.fault_text import explained, fault_lines
from fbench.replay.cli.progress import frame_progress
from fbench.replay.cli.show import console, print_json
from fbench.replay.config.source import LogSource
from fbench.replay.errors import ConfigError
from fbench.replay.excerpt import Excerpt
from fbench.replay.faults import FaultLog
from fbench.replay.files import swap
from fbench.replay.logs.partial_rig import partial_rig
from fbench.replay.restamp import StampParams
from fbench.replay.sync import SyncParams

if TYPE_CHECKING:
    from fbench.reports.preview.content import Content

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
    """Read a log, draw it, and print where and what was found.

    Raises:
        ConfigError: where the folder exists or can't be written.
        LogError: where the log can't be read, or has no frames.
    """
    from fbench.reports.preview.collect import Wish, collect
    from fbench.reports.preview.preview import write_preview

    faults = FaultLog()
    with explained(faults), new_folder(job.folder, job.overwrite) as folder:
        reader = job.log.open(faults)
        with frame_progress(f"{job.log.path.name}: reading") as progress:
            wish = Wish(job.num, job.sync, job.stamps, job.excerpt)
            material = collect(reader, partial_rig(reader), wish, faults, progress)
        content = write_preview(material, folder)
    if job.as_json:
        print_json(_content(job, content, faults))
    else:
        _print(job, content, faults)


@contextmanager
def new_folder(folder: Path, overwrite: bool) -> Iterator[Path]:
    """Give a folder under a temporary name, which becomes `folder` when all went well.

    Raises:
        ConfigError: where `folder` is there already and isn't to be replaced, or can't be written.
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


def _content(job: PreviewJob, content: "Content", faults: FaultLog) -> dict[str, object]:
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


def _print(job: PreviewJob, content: "Content", faults: FaultLog) -> None:
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
