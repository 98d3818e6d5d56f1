"""The plan of a replay: what runs on which part of a log, and how."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fbench.replay.conditions.disturb import Disturbance
from fbench.replay.contracts.faults import FaultBudget
from fbench.replay.contracts.protocols import Pipeline
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.overlap import Overlap
from fbench.replay.engine.service_queue import LatencyModel
from fbench.replay.logs.setup import StampParams
from fbench.replay.runs import manifest

NUM_MEDIA = 24


@dataclass(frozen=True)
class Plan:
    """What to run and how."""

    pipeline: Pipeline
    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    sync: SyncParams = field(default_factory=SyncParams)
    stamps: StampParams = field(default_factory=StampParams)
    excerpt: Excerpt = field(default_factory=Excerpt)
    topics: Sequence[str] = ()  # Patterns with which the log was opened, for the manifest
    sensors: Sequence[str] = ()
    """Patterns of the sensors that the pipeline gets, see `contracts.sensor_settings`; empty: all."""
    variant: manifest.VariantEntry | None = None  # Which variant the pipeline is, for the manifest
    inputs: Sequence[manifest.InputEntry] = ()  # Files that decided how it was read, for the manifest
    disturbance: Disturbance = field(default_factory=Disturbance)  # What disturbs the messages
    truth: manifest.TruthEntry | None = None  # The file that truth comes from, for the manifest
    max_between_ns: int = 0
    """Frames between truths that aren't farther apart get truth by interpolation, see `TruthTimes`; 0: none does."""
    clock: Clock = field(default_factory=Clock)
    latency: LatencyModel | None = None
    """How long the pipeline is taken to need, so that it misses frames that come meanwhile; `None`: lockstep."""
    overlap: Overlap | None = None  # Processes that observe frames; `None`: the pipeline does one after the other
    budget: FaultBudget = field(default_factory=FaultBudget)
    """So much data may be lost without the run being incomplete."""
    redact: bool = False  # Leave out of the run what tells whose log it is; see `redact`
    num_media: int = NUM_MEDIA  # So many frames at least keep images and points for reports, where the log has as many
    progress: Callable[[int], None] = lambda num_frames: None
    failed: Callable[[BaseException], None] = lambda error: None
    """Told of every exception that counts as a failed frame."""
