"""The request of a replay: every option of `fbench replay` by its name."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

from pydantic import TypeAdapter

from fbench.replay.conditions.disturb import Disturbance
from fbench.replay.conditions.spec import parse_conditions, with_absolute_files
from fbench.replay.contracts.devices import Device, check_device
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultBudget, parse_budget
from fbench.replay.contracts.plugins import pipeline_parameters
from fbench.replay.contracts.sensor_settings import make_sensors
from fbench.replay.contracts.variants import Variant, sensors_of, variant_of
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.engine.clock import make_clock
from fbench.replay.engine.excerpt import Excerpt, make_excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.overlap import make_overlap
from fbench.replay.engine.read_ahead import make_limit
from fbench.replay.engine.service_queue import PROFILE, LatencyModel, make_latency
from fbench.replay.logs.setup import BoxSource, StampParams
from fbench.replay.setup.source import LogRequest, LogSource, log_source
from fbench.replay.truth.times import make_max_between_ns

_RECORDED = "recorded"
_TAKE_DETECTIONS = (None, _RECORDED, "track")
_DETECT_EVERY = "detect_every"


def choose_pipeline(name: str | None, detections: BoxSource | None) -> str:
    """Name the pipeline; detections in a file imply one. Raises ConfigError for none, or one that can't read them."""
    if detections is None and name is None:
        raise ConfigError("which pipeline? give --pipeline NAME (see fbench plugins), or --detections PATH")
    variant = None if name is None else variant_of(name)
    if detections is not None and (name if variant is None else variant.base) not in _TAKE_DETECTIONS:
        raise ConfigError(f"--detections are results already, so --pipeline {name} can't be used with them")
    return name or _RECORDED


@dataclass(frozen=True)
class ReplayRequest:
    """One replay; travels as JSON. Raises ConfigError where an option isn't as expected; see `resolve`."""

    log: LogRequest
    pipeline: str
    """A name (see `fbench plugins`), `FILE.py:CLASS`, `FILE.toml`, `recorded:TOPIC` or `exec:COMMAND`; empty: none, for
    a check of the log alone."""
    settings: Sequence[str] = ()
    """Parameters as `NAME=VALUE`, as `--set` takes them."""
    detect_every: int | None = None
    """Detect in every N-th frame only; `None`: as the pipeline's parameters say."""
    sensors: Sequence[str] = ()
    """Patterns of the sensors that the pipeline gets; empty: all."""
    reference: str | None = None
    """Sensor whose stamps are the instants of the frames."""
    timeout_ms: float | None = None
    """How long a frame waits for its sensors, in log time; `None`: as the configuration or the log says, else 30."""
    tolerance_ms: float | None = None
    """How far a stamp may be from the instant of its frame; `None`: as the configuration says, else 50."""
    max_gap_s: float | None = None
    """A longer pause begins a new segment; `None`: as the configuration says, else 2."""
    offset: Sequence[str] = ()
    """What is added to the stamps of sensors, as `SENSOR=MS`."""
    stamps: str | None = None
    """Which time is the instant of measurement: `header` or `log`; `None`: as the configuration says, else `header`."""
    from_: str | None = None
    """First instant: seconds after the first measurement, or a stamp such as `5ns`."""
    to: str | None = None
    """Instant at which to stop, itself excluded."""
    frames: str | None = None
    """Indices of the frames to replay, as `A:B`; B is excluded."""
    condition: str = ""
    """Disturbances of the messages, such as `fog:3+dropout.radar:1`, or a TOML file; empty: none."""
    seed: int = 0
    """Of the random numbers of conditions, and of latency from a profile."""
    interpolate_truth_ms: float = 0.0
    """Frames without truth get it by interpolation between truths at most this far apart; 0: they don't."""
    out: Path | None = None
    """Run folder; `None`: `runs/LOG-PIPELINE`."""
    overwrite: bool = False
    latency: str | None = None
    """How long the pipeline is taken to need: `measured`, a time such as `fixed:80ms`, or drawn from `profile:FILE`;
    `None`: lockstep."""
    overload: str | None = None
    """What becomes of frames that come meanwhile: `newest` (also by `None`), `skip` or `fifo:N`."""
    budget_ms: float = 100.0
    """A frame that takes longer misses its deadline; the run's table of latency counts them."""
    rate: str = "max"
    """Pace: `max`, or a multiple of real time such as `0.5`; with latency, how fast log time passes meanwhile."""
    overlap: int = 1
    """So many processes work on frames at the same time, where the pipeline allows that; 1: one frame after another."""
    read_ahead: str = "auto"
    """Messages to decode in advance: a number, `all` or `auto`."""
    on_fault: str = "strict"
    """`strict`: lost data make a run incomplete; `tolerant`: they are only counted."""
    fault_budget: Sequence[str] = ()
    """Faults that are allowed, as `N` or `CODE=N`."""
    scoring: ScoreOptions = field(default_factory=ScoreOptions)
    no_media: bool = False
    """Keep images and points out of the run."""
    redact: bool = False
    """Leave out of the run what tells whose log it is."""
    report: bool = False
    """Write `report.html` into the run folder, too."""
    device: Device = "cpu"
    """What runs the pipeline's networks: `cpu`, or `cuda` for an NVIDIA GPU."""
    isolate: bool = False
    """Run the pipeline, which is a Python plug-in, in a process of its own."""
    frame_timeout_s: float = 10.0
    """How long a plug-in in a process of its own may take for a frame; one that takes longer is started again."""

    @property
    def variant(self) -> Variant | None:
        """The variant that the pipeline is, if it is one."""
        return variant_of(self.pipeline)

    def absolute(self) -> Self:
        """Return the same with paths that hold in every folder."""
        out = None if self.out is None else self.out.resolve()
        latency = self.latency
        if latency is not None and latency.startswith(PROFILE):
            latency = f"{PROFILE}{Path(latency.removeprefix(PROFILE)).resolve()}"
        condition = with_absolute_files(self.condition)
        return replace(self, log=self.log.absolute(), condition=condition, out=out, latency=latency)

    def to_json(self) -> str:
        """Return it as one line, for another process."""
        return json.dumps(_ADAPTER.dump_python(self, mode="json"))

    @staticmethod
    def from_json(text: str) -> "ReplayRequest":
        """Read what `to_json` returned."""
        return _ADAPTER.validate_python(json.loads(text))  # paths needn't be Unicode

    def resolve(self) -> "ReplayOptions":
        """Read all options, with those of the log's configuration where the request leaves them open. Raises
        ConfigError where an option isn't as expected. Raises LogError where a file beside the log can't be used.
        """
        check_device(self.device)
        source, sensors, settings = log_source(self.log), make_sensors(self.sensors), list(self.settings)
        if not 0 < self.frame_timeout_s < float("inf"):
            raise ConfigError(f"--frame-timeout-s {self.frame_timeout_s:g}: expected more than 0")
        if not 0 < self.budget_ms < float("inf"):
            raise ConfigError(f"--budget-ms {self.budget_ms:g}: expected more than 0")
        if make_overlap(self.overlap) > 1 and (self.latency is not None or self.rate != "max" or self.isolate):
            raise ConfigError(f"--overlap {self.overlap}: can't be used with --latency, --rate or --isolate")
        if self.detect_every is not None:
            if not self.isolate and _DETECT_EVERY not in pipeline_parameters(self.pipeline, []):
                raise ConfigError(
                    f"--detect-every {self.detect_every}: pipeline '{self.pipeline}' has no parameter {_DETECT_EVERY}; "
                    "it decides itself when it detects"
                )
            settings.append(f"{_DETECT_EVERY}={self.detect_every}")
        return ReplayOptions(
            source,
            settings,
            source.sync_params(self.reference, self.timeout_ms, self.tolerance_ms, self.max_gap_s),
            source.stamps(self.stamps, self.offset),
            make_excerpt(self.from_, self.to, self.frames),
            make_disturbance(source, self.condition, self.seed),
            make_max_between_ns(self.interpolate_truth_ms),
            tuple(sensors_of(self.pipeline, sensors) if self.pipeline else sensors),
            make_limit(self.read_ahead),
            parse_budget(self.on_fault, self.fault_budget),
            make_latency(self.latency, self.overload, make_clock(self.rate, 0).rate, self.seed),
        )


@dataclass(frozen=True, eq=False)
class ReplayOptions:
    """What the engine takes of a request, read and checked."""

    log: LogSource
    settings: list[str]
    sync: SyncParams
    stamps: StampParams
    excerpt: Excerpt
    disturbance: Disturbance
    max_between_ns: int  # Frames between truths at most this far apart get truth by interpolation [ns]; 0: none does
    sensors: tuple[str, ...]
    read_ahead: int | None  # Messages to decode in advance; `None`: as many as fit into the memory set aside for it
    budget: FaultBudget
    latency: LatencyModel | None  # `None`: lockstep


def make_disturbance(source: LogSource, condition: str, seed: int) -> Disturbance:
    """Read `--condition` and `--seed`, and when the log's messages were recorded where there are conditions. Raises
    ConfigError where one can't be understood. Raises LogError where the log can't be used.
    """
    if not 0 <= seed < 2**63:
        raise ConfigError(f"--seed {seed}: expected 0 to 2^63 - 1")
    parts = parse_conditions(condition)
    return Disturbance(parts, seed, source.span()) if parts else Disturbance()


_ADAPTER = TypeAdapter(ReplayRequest)
