"""What `fbench replay` was asked for, as the command line says it, and the job that this is."""

from dataclasses import dataclass
from pathlib import Path

from fbench.replay.cli.job import Job
from fbench.replay.config.source import LogWish, log_source
from fbench.replay.excerpt import make_excerpt
from fbench.replay.fault_budget import parse_budget
from fbench.replay.read_ahead import make_limit
from fbench.replay.scores import ScoreOptions
from fbench.replay.sensor_choice import make_sensors
from fbench.replay.truth.times import make_max_between_ns


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
