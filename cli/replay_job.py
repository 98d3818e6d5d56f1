"""One replay from the command line: open, replay, score, report."""

import json
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path

from fbench.cli.progress import frame_progress
from fbench.cli.scoring import score_folder
from fbench.cli.show import explained
from fbench.replay.contracts.faults import FaultBudget, FaultLog, parse_budget
from fbench.replay.contracts.plugins import give_log, guarded, load, opened_pipeline, parse_name
from fbench.replay.contracts.protocols import KeepsStderr, Pipeline
from fbench.replay.contracts.sensor_settings import make_sensors
from fbench.replay.contracts.variants import Variant, sensors_of, variant_of
from fbench.replay.data.files import replace_text
from fbench.replay.data.rig import LogInfo
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.engine.clock import Pace, make_clock
from fbench.replay.engine.excerpt import Excerpt, make_excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.loop import NUM_MEDIA, Plan, replay
from fbench.replay.engine.read_ahead import DEFAULT, make_limit, opened_ahead
from fbench.replay.logs.setup import StampParams
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import VariantEntry, describe_host
from fbench.replay.runs.redaction import public_name, public_pipeline
from fbench.replay.runs.secrets import without_secrets
from fbench.replay.setup.source import LogSource, LogWish, log_source
from fbench.replay.truth.times import make_max_between_ns


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
    max_between_ns: int = 0
    """Frames between truths that aren't farther apart get truth by interpolation; 0: none does."""
    read_ahead: int | None = DEFAULT
    """Messages to decode in advance; `None`: as many as fit into the memory set aside for it."""
    budget: FaultBudget = field(default_factory=FaultBudget)
    scoring: ScoreOptions = field(default_factory=ScoreOptions)
    no_media: bool = False
    redact: bool = False
    report: bool = False
    debug: bool = False
    """Show the traceback of the first frame that fails."""

    @property
    def variant(self) -> Variant | None:
        """The variant that the pipeline is, if it is one."""
        return variant_of(self.pipeline)

    @property
    def name(self) -> str:
        """The pipeline's, for the manifest."""
        if (variant := self.variant) is not None:
            return without_secrets(variant.name)
        return short_name(public_pipeline(self.pipeline) if self.redact else self.pipeline)

    def folder(self, info: LogInfo) -> Path:
        """Where the run of a log goes."""
        log = public_name(info) if self.redact else without_secrets(self.log.path.stem)
        return self.out or Path("runs") / f"{log}-{self.name.replace('/', '-')}"


def short_name(pipeline: str) -> str:
    """A pipeline's name as part of a file name: `dir/mine.py:Mine` becomes `mine-Mine`, a variant is called as it says.

    Raises:
        ConfigError: where the file of a variant can't be used.
    """
    variant = variant_of(pipeline)
    return parse_name(without_secrets(pipeline)).short if variant is None else without_secrets(variant.file_name)


def keep_stderr(pipeline: Pipeline, folder: Path) -> None:
    """Write what the pipeline's program said, if it has one and that said something; without credentials."""
    data = pipeline.stderr() if isinstance(pipeline, KeepsStderr) else b""
    if data:
        text = without_secrets(data.decode(errors="surrogateescape"))
        (folder / "stderr.txt").write_bytes(text.encode(errors="surrogateescape"))


def run_job(job: Job) -> Run:
    """Replay, score, and report if asked to; returns the finished run."""
    clock = make_clock(job.rate, job.sync.max_gap_ns)
    start = time.monotonic()

    def complete(folder: Path) -> None:
        wall_s = round(time.monotonic() - start, 3)
        host = {**describe_host(), "rate": job.rate, "wall_s": wall_s, **_measured(clock.pace)}
        replace_text(folder / "host.json", json.dumps(host, indent=1) + "\n")
        if not job.redact:
            with guarded(f"pipeline '{job.name}' can't give its stderr"):
                keep_stderr(pipeline, folder)
        score_folder(folder, job.scoring)

    faults = FaultLog()
    # What a plug-in prints must not get between the lines of --json.
    with (
        redirect_stdout(sys.stderr),
        opened_pipeline(job.pipeline, job.settings) as (pipeline, parameters),
        explained(faults),
        frame_progress(f"{job.log.path.name} → {job.name}") as progress,
    ):
        plan = Plan(
            pipeline,
            job.name,
            parameters,
            sync=job.sync,
            stamps=job.stamps,
            excerpt=job.excerpt,
            topics=job.log.topics,
            sensors=sensors_of(job.pipeline, job.sensors),
            variant=variant_entry(job.variant),
            inputs=job.log.used(),
            truth=job.log.truth_entry(),
            max_between_ns=job.max_between_ns,
            clock=clock,
            budget=job.budget,
            redact=job.redact,
            num_media=0 if job.no_media else NUM_MEDIA,
            progress=progress,
            failed=_first_traceback(job.debug),
        )
        give_log(pipeline, job.name, lambda: job.log.open(faults))
        with opened_ahead(job.log.open, faults, job.read_ahead) as reader:
            folder = job.folder(reader.info)
            replay(reader, plan, folder, faults, job.overwrite, complete)
    run = Run(folder)
    if job.report:
        load("reports", "html")().write([run], folder / "report.html")
    return run


def variant_entry(variant: Variant | None) -> VariantEntry | None:
    """Return what the manifest says of a variant."""
    if variant is None:
        return None
    sets = [name for name, _ in variant.settings]
    return VariantEntry(name=variant.name, title=variant.title, base=variant.base, sets=sets)


def _first_traceback(debug: bool) -> Callable[[BaseException], None]:
    """Return what shows the first exception that it is told of, if that is wanted."""
    left = [True] if debug else []

    def show(error: BaseException) -> None:
        if left:
            left.pop()
            sys.stderr.write(without_secrets("".join(traceback.format_exception(error))))

    return show


def _measured(pace: Pace) -> dict[str, float]:
    """What is known of the pace, for host.json."""
    values = {"achieved_rate": pace.achieved, "p99_late_ms": pace.p99_late_ms, "max_late_ms": pace.max_late_ms}
    return {name: round(value, 3) for name, value in values.items() if value is not None}


@dataclass(frozen=True)
class PipelineWish:
    """What replays, and with which sensors."""

    name: str
    settings: list[str]
    sensors: list[str]


@dataclass(frozen=True)
class FrameWish:
    """Which frames there are, what joins them, and which of them are replayed."""

    reference: str | None
    timeout_ms: float | None
    tolerance_ms: float | None
    max_gap_s: float | None
    from_: str | None
    to: str | None
    frames: str | None
    offsets: list[str]
    stamps: str | None
    interpolate_truth_ms: float


@dataclass(frozen=True)
class RunWish:
    """How it goes on, and what is kept of it."""

    out: Path | None
    overwrite: bool
    rate: str
    read_ahead: str
    on_fault: str
    fault_budget: list[str]
    no_media: bool
    redact: bool
    report: bool
    debug: bool


def make_job(log: LogWish, pipeline: PipelineWish, frames: FrameWish, run: RunWish, scoring: ScoreOptions) -> Job:
    """Return the job.

    Raises:
        ConfigError: where an option isn't as expected.
        LogError: where a file beside the log can't be used.
    """
    source = log_source(log)
    return Job(
        log=source,
        pipeline=pipeline.name,
        settings=pipeline.settings,
        sensors=make_sensors(pipeline.sensors),
        out=run.out,
        overwrite=run.overwrite,
        rate=run.rate,
        sync=source.sync(frames.reference, frames.timeout_ms, frames.tolerance_ms, frames.max_gap_s),
        stamps=source.stamps(frames.stamps, frames.offsets),
        excerpt=make_excerpt(frames.from_, frames.to, frames.frames),
        max_between_ns=make_max_between_ns(frames.interpolate_truth_ms),
        read_ahead=make_limit(run.read_ahead),
        budget=parse_budget(run.on_fault, run.fault_budget),
        scoring=scoring,
        no_media=run.no_media,
        redact=run.redact,
        report=run.report,
        debug=run.debug,
    )
