"""The queue in front of a pipeline: when frames are started and done in log time, and which are dropped.

One server works on one frame at a time. A frame arrives when the frame buffer releases it; frames that arrive at one
instant do so in their order. All times are integers in ns, so that equal arrivals and service times give equal
schedules on any host.
"""

import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Generic, Literal, TypeAlias, TypeVar

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Int64
from fbench.replay.engine.latency_profile import MOST_NS, LatencyProfile, load_profile
from fbench.replay.runs.folder import FrameRecord
from fbench.replay.runs.manifest import ProfileEntry

T = TypeVar("T")
R = TypeVar("R")
Overload: TypeAlias = Literal["newest", "fifo", "skip"]
MEASURED = "measured"
MAX_DEPTH = 100_000
PROFILE = "profile:"
_UNITS_NS = {"ns": 1, "us": 1000, "ms": 1_000_000, "s": 1_000_000_000}
_FIXED = re.compile(r"fixed:(\d{1,12}(?:\.\d{1,9})?)(ns|us|ms|s)", re.ASCII)
_FIFO = re.compile(r"fifo:(\d{1,6})", re.ASCII)


@dataclass(frozen=True)
class OverloadPolicy:
    """What becomes of frames that arrive while the pipeline is busy.

    - `newest`: the newest waits; the one that waited before it is dropped. One that arrives just when the pipeline
      becomes free counts as newer, as in sAP (Li et al. 2020), where the latest frame up to an instant is taken.
    - `fifo`: up to `depth` wait and are taken in their order; what arrives when so many wait is dropped.
    - `skip`: none waits, so what arrives is dropped.
    """

    kind: Overload = "newest"
    depth: int = 0

    def __str__(self) -> str:
        return f"fifo:{self.depth}" if self.kind == "fifo" else self.kind


@dataclass(frozen=True)
class LatencyModel:
    """How long the pipeline takes for a frame, and what happens to frames that arrive meanwhile."""

    fixed_ns: int | None = None
    """The same for each frame [ns, of the wall clock]; `None`: as measured in this run, or drawn from `profile`."""
    policy: OverloadPolicy = OverloadPolicy()
    rate: Fraction = Fraction(1)
    """Log time passes so many times as fast as the wall clock."""
    profile: LatencyProfile | None = None
    """Times are drawn from it, with `seed`; `None`: they aren't drawn."""
    seed: int = 0
    entry: ProfileEntry | None = None  # The profile's file, for the manifest

    def service_ns(self, measured_ns: int) -> int:
        """Return how much log time [ns] passes while the pipeline works on a frame for which it took `measured_ns`, as
        it was measured or drawn.
        """
        return min(int((measured_ns if self.fixed_ns is None else self.fixed_ns) * self.rate), MOST_NS)


def make_latency(latency: str | None, overload: str | None, rate: float | None, seed: int = 0) -> LatencyModel | None:
    """Read `--latency` and `--overload`; `None`: lockstep. `rate` is that of the clock, `None` counts as real time;
    `seed` is for what is drawn from a profile. Raises ConfigError where one can't be understood, a profile can't be
    read, or there is an overload without latency.
    """
    if latency is None:
        if overload is not None:
            raise ConfigError(f"--overload {overload}: is about --latency, which is missing")
        return None
    found, path = _FIXED.fullmatch(latency), latency.removeprefix(PROFILE)
    is_drawn = latency.startswith(PROFILE) and bool(path)
    if found is None and latency != MEASURED and not is_drawn:
        raise ConfigError(f"--latency {latency}: expected 'measured', a time such as 'fixed:80ms', or 'profile:FILE'")
    fixed_ns = None if found is None else round(Fraction(found[1]) * _UNITS_NS[found[2]])
    policy = OverloadPolicy() if overload is None else _make_policy(overload)
    times = Fraction("1" if rate is None else repr(rate))
    if fixed_ns is not None and fixed_ns * times > MOST_NS:
        raise ConfigError(f"--latency {latency}: is more than a day of log time, at {float(times):g}x")
    if not is_drawn:
        return LatencyModel(fixed_ns, policy, times)
    profile, digest = load_profile(Path(path))
    return LatencyModel(
        None, policy, times, profile, seed, ProfileEntry(name=Path(path).name, digest=digest, seed=seed)
    )


def _make_policy(text: str) -> OverloadPolicy:
    known: dict[str, OverloadPolicy] = {"newest": OverloadPolicy("newest"), "skip": OverloadPolicy("skip")}
    if text in known:
        return known[text]
    found = _FIFO.fullmatch(text)
    if found is None or not 1 <= (depth := int(found[1])) <= MAX_DEPTH:
        raise ConfigError(f"--overload {text}: expected 'newest', 'skip', or 'fifo:N' with N from 1 to {MAX_DEPTH}")
    return OverloadPolicy("fifo", depth)


@dataclass(frozen=True)
class Service(Generic[R]):
    """When the pipeline works on a frame [ns, log time], and what comes out."""

    start_ns: int
    done_ns: int
    result: R


class ServiceQueue(Generic[T, R]):
    """Serves frames in the order in which they arrive, or drops them. `serve` works on one, and returns what comes out
    and how long that takes [ns, log time].

    Online: a frame is served as soon as its start is known, so service times may be measured while it runs; at most
    one frame is kept waiting.
    """

    def __init__(self, policy: OverloadPolicy, serve: Callable[[T], tuple[R, int]]) -> None:
        self._policy, self._serve = policy, serve
        self._free_ns: int | None = None  # When the pipeline is done with all frames so far
        self._starts_ns: deque[int] = deque()  # Of frames that hadn't started at the last arrival
        self._waiting: tuple[T, int] | None = None  # The newest frame, while the pipeline is busy, and its arrival

    def run(self, arrivals: Iterable[tuple[T, int]]) -> Iterator[tuple[T, Service[R] | None]]:
        """Yield each frame in order with its service, or `None` where it is dropped. `arrivals`: frames and when they
        arrive [ns, log time], ascending.
        """
        for frame, ready_ns in arrivals:
            yield from self._arrive(frame, ready_ns)
        if self._waiting is not None:
            yield self._start(*self._waiting)
            self._waiting = None

    def _arrive(self, frame: T, ready_ns: int) -> Iterator[tuple[T, Service[R] | None]]:
        if self._waiting is not None:
            free_ns, waiting = self._free_ns, self._waiting
            self._waiting = None
            is_replaced = free_ns is not None and ready_ns <= free_ns
            yield (waiting[0], None) if is_replaced else self._start(*waiting)
        while self._starts_ns and self._starts_ns[0] <= ready_ns:
            self._starts_ns.popleft()
        is_busy = self._free_ns is not None and ready_ns < self._free_ns
        if is_busy and self._policy.kind == "newest":
            self._waiting = frame, ready_ns
        elif is_busy and len(self._starts_ns) >= self._policy.depth:
            yield frame, None
        else:
            yield self._start(frame, ready_ns)

    def _start(self, frame: T, ready_ns: int) -> tuple[T, Service[R]]:
        start_ns = ready_ns if self._free_ns is None else max(ready_ns, self._free_ns)
        result, service_ns = self._serve(frame)
        self._free_ns = start_ns + service_ns
        if self._policy.kind == "fifo" and start_ns > ready_ns:
            self._starts_ns.append(start_ns)
        return frame, Service(start_ns, self._free_ns, result)


def pair_outputs(frames: Sequence[FrameRecord]) -> Int64:
    """Return the row (F,) of the frame whose output counts at the instant of each frame; -1: there is none. A frame
    that failed has an output in which nothing is found; one that was dropped has none.
    """
    source = np.full(len(frames), -1, np.int64)
    latest, segment, pending = -1, -1, deque[tuple[int, int]]()
    for row, frame in enumerate(frames):
        if frame.segment != segment:
            latest, segment, pending = -1, frame.segment, deque()
        if frame.done_ns is not None:
            pending.append((frame.done_ns, row))
        while pending and frame.ready_ns is not None and pending[0][0] <= frame.ready_ns:
            latest = pending.popleft()[1]
        source[row] = latest
    return source
