"""One replay from the command line: open, replay, score, report."""

import json
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path

from fbench.replay.cli.fault_text import explained
from fbench.replay.cli.progress import frame_progress
from fbench.replay.cli.scoring import score_folder
from fbench.replay.clock import Pace, make_clock
from fbench.replay.config.source import LogSource
from fbench.replay.excerpt import Excerpt
from fbench.replay.fault_budget import FaultBudget
from fbench.replay.faults import FaultLog
from fbench.replay.files import replace_text
from fbench.replay.host import describe_host
from fbench.replay.pipeline_name import parse_name
from fbench.replay.plugins import load, opened_pipeline
from fbench.replay.protocols import KeepsStderr, Pipeline
from fbench.replay.protocols import UsesLog
from fbench.replay.read_ahead import DEFAULT, opened_ahead
from fbench.replay.restamp import StampParams
from fbench.replay.run import Plan, replay
from fbench.replay.scores import ScoreOptions
from fbench.replay.store import Run
from fbench.replay.sync import SyncParams


@dataclass(frozen=True)
class Job:
    """Everything that `fbench replay` was asked for."""

    log: LogSource
    pipeline: str
    settings: list[str] = field(default_factory=list)
    sensors: list[str] = field(default_factory=list)
    out: Path | None = None
    overwrite: bool = False
    rate: str = "max"
    sync: SyncParams = field(default_factory=SyncParams)
    stamps: StampParams = field(default_factory=StampParams)
    excerpt: Excerpt = field(default_factory=Excerpt)
    read_ahead: int | None = DEFAULT
    """Messages to decode in advance; `None`: as many as fit into the memory set aside for it."""
    budget: FaultBudget = field(default_factory=FaultBudget)
    scoring: ScoreOptions = field(default_factory=ScoreOptions)
    report: bool = False
    debug: bool = False
    """Show the traceback of the first frame that fails."""

    @property
    def folder(self) -> Path:
        """Where the run goes."""
        return self.out or Path("runs") / f"{self.log.path.stem}-{short_name(self.pipeline)}"


def short_name(pipeline: str) -> str:
    """A pipeline's name as part of a file name: `dir/mine.py:Mine` becomes `mine-Mine`."""
    return parse_name(pipeline).short


def keep_stderr(pipeline: Pipeline, folder: Path) -> None:
    """Write what the pipeline's program said, if it has one and that said something."""
    text = pipeline.stderr() if isinstance(pipeline, KeepsStderr) else b""
    if text:
        (folder / "stderr.txt").write_bytes(text)


def run_job(job: Job) -> Run:
    """Replay, score, and report if asked to; returns the finished run."""
    clock = make_clock(job.rate, job.sync.max_gap_ns)
    start = time.monotonic()

    def complete(folder: Path) -> None:
        wall_s = round(time.monotonic() - start, 3)
        host = {**describe_host(), "rate": job.rate, "wall_s": wall_s, **_measured(clock.pace)}
        replace_text(folder / "host.json", json.dumps(host, indent=1) + "\n")
        keep_stderr(pipeline, folder)
        score_folder(folder, job.scoring)

    faults = FaultLog()
    name = short_name(job.pipeline)
    # What a plug-in prints must not get between the lines of --json.
    with (
        redirect_stdout(sys.stderr),
        opened_pipeline(job.pipeline, job.settings) as (pipeline, parameters),
        explained(faults),
        frame_progress(f"{job.log.path.name} → {name}") as progress,
    ):
        plan = Plan(
            pipeline,
            name,
            parameters,
            sync=job.sync,
            stamps=job.stamps,
            excerpt=job.excerpt,
            topics=job.log.topics,
            sensors=job.sensors,
            inputs=job.log.inputs,
            clock=clock,
            budget=job.budget,
            progress=progress,
            failed=_first_traceback(job.debug),
        )
        if isinstance(pipeline, UsesLog):
            pipeline.use_log(job.log.open(faults))
        with opened_ahead(job.log.open, faults, job.read_ahead) as reader:
            replay(reader, plan, job.folder, faults, job.overwrite, complete)
    run = Run(job.folder)
    if job.report:
        load("reports", "html")().write([run], job.folder / "report.html")
    return run


def _first_traceback(debug: bool) -> Callable[[BaseException], None]:
    """Return what shows the first exception that it is told of, if that is wanted."""
    left = [True] if debug else []

    def show(error: BaseException) -> None:
        if left:
            left.pop()
            traceback.print_exception(error, file=sys.stderr)

    return show


def _measured(pace: Pace) -> dict[str, float]:
    """What is known of the pace, for host.json."""
    values = {"achieved_rate": pace.achieved, "p99_late_ms": pace.p99_late_ms, "max_late_ms": pace.max_late_ms}
    return {name: round(value, 3) for name, value in values.items() if value is not None}
