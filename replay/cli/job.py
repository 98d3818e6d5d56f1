"""One replay from the command line: open, replay, score, report, show."""

import json
import re
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fbench.replay.cli.progress import frame_progress
from fbench.replay.cli.scoring import score_folder
from fbench.replay.cli.show import console, fault_lines, latency_table, null_reasons, score_table
from fbench.replay.clock import Pace, make_clock
from fbench.replay.errors import ConfigError, LogError
from fbench.replay.excerpt import Excerpt
from fbench.replay.fault_budget import FaultBudget
from fbench.replay.faults import FAULTS, FaultLog
from fbench.replay.files import replace_text
from fbench.replay.host import describe_host
from fbench.replay.logs.open import open_log
from fbench.replay.plugins import load, make_pipeline
from fbench.replay.read_ahead import DEFAULT, opened_ahead
from fbench.replay.restamp import StampParams
from fbench.replay.run import Plan, replay
from fbench.replay.scores import ScoreOptions
from fbench.replay.store import Run
from fbench.replay.sync import SyncParams


@dataclass(frozen=True)
class Job:
    """Everything that `fbench replay` was asked for."""

    log: Path
    pipeline: str
    settings: list[str] = field(default_factory=list)
    out: Path | None = None
    overwrite: bool = False
    rate: str = "max"
    sync: SyncParams = field(default_factory=SyncParams)
    stamps: StampParams = field(default_factory=StampParams)
    excerpt: Excerpt = field(default_factory=Excerpt)
    topics: list[str] = field(default_factory=list)
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
        return self.out or Path("runs") / f"{self.log.stem}-{short_name(self.pipeline)}"


def short_name(pipeline: str) -> str:
    """A pipeline's name as part of a file name: `dir/mine.py:Mine` becomes `mine-Mine`."""
    file, _, cls = pipeline.rpartition(":")
    name = f"{Path(file).stem}-{cls}" if file else cls
    return re.sub(r"[^\w.-]+", "_", name)


def run_job(job: Job) -> Run:
    """Replay, score, and report if asked to; returns the finished run."""
    clock = make_clock(job.rate, job.sync.max_gap_ns)
    pipeline, parameters = make_pipeline(job.pipeline, job.settings)
    start = time.monotonic()

    def complete(folder: Path) -> None:
        wall_s = round(time.monotonic() - start, 3)
        host = {**describe_host(), "rate": job.rate, "wall_s": wall_s, **_measured(clock.pace)}
        replace_text(folder / "host.json", json.dumps(host, indent=1) + "\n")
        score_folder(folder, job.scoring)

    faults = FaultLog()
    name = short_name(job.pipeline)
    # What a plug-in prints must not get between the lines of --json.
    with explained(faults), frame_progress(f"{job.log.name} → {name}") as progress, redirect_stdout(sys.stderr):
        plan = Plan(
            pipeline,
            name,
            parameters,
            sync=job.sync,
            stamps=job.stamps,
            excerpt=job.excerpt,
            topics=job.topics,
            clock=clock,
            budget=job.budget,
            progress=progress,
            failed=_first_traceback(job.debug),
        )
        with opened_ahead(lambda met: open_log(job.log, met, job.topics), faults, job.read_ahead) as reader:
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


@contextmanager
def explained(faults: FaultLog) -> Iterator[None]:
    """Add the first fault that was met before it to the message of a log that can't be used."""
    try:
        yield
    except LogError as error:
        first = next((f"{FAULTS[code].text}: {places[0]}" for code, places in sorted(faults.places.items())), None)
        if first is None:
            raise
        raise LogError(f"{error}; before that: {first}", error.code) from error


def to_ns(value: float, unit_ns: float) -> int:
    """Convert a duration to nanoseconds; infinity becomes longer than any log."""
    return round(min(value * unit_ns, 1e18))


def show_run(run: Run, as_json: bool) -> None:
    """Print scores, latency, faults, and where the run is."""
    if as_json:
        names = ("scores.json", "latency.json", "faults.json")
        content = {name.removesuffix(".json"): run.json(name) for name in names}
        manifest = json.loads(run.manifest.model_dump_json())
        print(json.dumps({"run": str(run.folder), "manifest": manifest, **content}, indent=1))  # noqa: T201
        return
    out = console()
    out.print(score_table(run.scores))
    for line in null_reasons(run.scores):
        out.print(f"– {line}", markup=False)
    out.print()
    latency = run.json("latency.json")
    out.print(latency_table(latency))
    out.print(f"{latency['over_budget']} of {latency['frames']} frames over the budget of {latency['budget_ms']:g} ms")
    out.print()
    for line in _status(run):
        out.print(line, markup=False, soft_wrap=True)


def _status(run: Run) -> list[str]:
    manifest = run.manifest
    scored = sum(frame.truth_stamp_ns is not None for frame in run.frames)
    lines = [f"frames: {manifest.num_frames} in {manifest.num_segments} segments, {scored} with truth"]
    missing = Counter(f"{sensor} ({_kind(reason)})" for frame in run.frames for sensor, reason in frame.missing.items())
    lines += [f"missing: {what} in {num} frames" for what, num in sorted(missing.items())]
    counts = run.json("faults.json")
    for sensor, num in counts["late_messages"].items():
        lines += [f"late: {num} messages of {sensor} came after their frame was released"] if num else []
    for sensor, num in counts["unused_messages"].items():
        lines += [f"unused: {num} messages of {sensor}, which frames don't need"] if num else []
    lines += [f"fault: {line}" for line in fault_lines(run)]
    if not manifest.complete:
        lines.append("INCOMPLETE: data was lost, so these numbers aren't those of the whole log")
    report = run.folder / "report.html"
    lines.append(_pace(run.json("host.json")))
    return [*lines, f"run: {run.folder}", *([f"report: {report}"] if report.is_file() else [])]


def _measured(pace: Pace) -> dict[str, float]:
    """What is known of the pace, for host.json."""
    values = {"achieved_rate": pace.achieved, "p99_late_ms": pace.p99_late_ms, "max_late_ms": pace.max_late_ms}
    return {name: round(value, 3) for name, value in values.items() if value is not None}


def _pace(host: dict[str, Any]) -> str:
    achieved = f"{host['achieved_rate']:.3g}x" if "achieved_rate" in host else "–"
    if host["rate"] == "max":
        return f"pace: {achieved} real time"
    return (
        f"pace: asked {host['rate']}x, achieved {achieved}, "
        f"p99 late {host['p99_late_ms']:.2g} ms, max {host['max_late_ms']:.2g} ms"
    )


def _kind(reason: str) -> str:
    """A reason without its number: 'late by 12.3 ms' is 'late'."""
    return "late" if reason.startswith("late by") else reason


def open_run(folder: Path) -> Run:
    """Return the run in a folder.

    Raises:
        ConfigError: where there is no such folder.
        RunError: where it isn't a run.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such run folder")
    run = Run(folder)
    _ = run.manifest
    return run
