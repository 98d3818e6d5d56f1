"""Sweeps: one log at several rates, what is dropped and what outputs are worth, and the largest rate kept up with."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from fbench.api.runs import replay
from fbench.api.scores import IN_LOCKSTEP
from fbench.metrics.latency import warm_up_frames
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.files import replace_text
from fbench.replay.data.scores import FORECAST, LOCKSTEP, STREAMING
from fbench.replay.engine.clock import make_clock
from fbench.replay.engine.service_queue import LatencyModel, OverloadPolicy, ServiceQueue
from fbench.replay.runs.folder import Run
from fbench.replay.setup.request import ReplayRequest

MISSES_PERCENT = 1
"""A rate is sustained while less than so many percent of the frames miss their deadline."""
SLOWEST, FASTEST = Fraction(1, 1024), Fraction(1024)
_STEPS = 20  # Of the bisection: the last is below a millionth of the first
_METRICS = ("f1", "mota", "hota")


@dataclass(frozen=True)
class SweepRequest:
    """Replays of one log at several rates. Raises ConfigError where an option isn't as expected."""

    replay: ReplayRequest
    """With latency; its `out` gets a folder a rate, its own rate plays no part."""
    rates: Sequence[str]
    """How many times as fast as in real time the log passes."""
    budget_ms: float = 100.0
    """A frame that isn't done so long after it was ready misses its deadline, in time of the wall clock."""

    def __post_init__(self) -> None:
        if self.replay.latency is None:
            raise ConfigError("how long does the pipeline take? give --latency, such as fixed:80ms or measured")
        if not self.rates:
            raise ConfigError("--rates: names no rate, such as 0.5,1,2")
        if not 0 < self.budget_ms < math.inf:
            raise ConfigError(f"--budget-ms {self.budget_ms:g}: expected more than 0")
        for rate in self.rates:
            try:
                is_paced = make_clock(rate, 0).rate is not None
            except ConfigError:
                is_paced = False
            if not is_paced:
                raise ConfigError(f"--rates {rate}: expected positive numbers, such as 0.5,1,2")


@dataclass(frozen=True)
class SweepRow:
    """What became of the frames at one rate."""

    rate: float
    frames: int
    dropped: int
    missed: int
    """Dropped, or done too late."""
    staleness_ms: float | None
    """Mean age, in log time, of the outputs that counted."""
    scores: Mapping[str, Mapping[str, float | None]]
    """By slice (`lockstep`, `streaming`, `streaming, forecast`), then by metric, in the pipeline's own space."""


@dataclass(frozen=True)
class RateSweep:
    """A finished sweep."""

    folder: Path
    rows: Sequence[SweepRow]
    sustainable_rate: float | None
    """The largest rate at which less than 1 % of the frames miss their deadline, to 3 digits; `None`: no rate is."""


def sweep(request: SweepRequest, progress: Callable[[int, int], None] = lambda done, total: None) -> RateSweep:
    """Replay the log at each rate, and once in lockstep, and write `sweep.json`. `progress` gets how many rates are
    done, of how many. Raises as `replay` does.
    """
    options = request.replay.resolve()
    folder = request.replay.out or Path("runs/sweep")
    if folder.exists() and not request.replay.overwrite:
        raise ConfigError(f"{folder}: exists already; choose another with --out, or --overwrite it")
    rows, runs = list[SweepRow](), list[Run]()
    rates = list(dict.fromkeys(request.rates))
    for num, rate in enumerate(rates):
        progress(num, len(rates))
        one = replace(request.replay, rate=rate, out=folder / f"rate-{rate}")
        runs.append(replay(one, lockstep=runs[0].folder / IN_LOCKSTEP if runs else None).run)
        rows.append(_row(runs[-1], request.budget_ms))
    model = options.latency or LatencyModel()
    ready_ns = [frame.ready_ns or 0 for frame in runs[0].frames]
    fixed_ns, lockstep = model.fixed_ns, runs[0].folder / IN_LOCKSTEP
    service_ns = _read_times_ns(Run(lockstep)) if fixed_ns is None else [fixed_ns] * len(ready_ns)
    if model.profile is not None:
        service_ns = model.profile.draw_run_ns(model.seed, Run(lockstep))
    largest = find_sustainable_rate(ready_ns, service_ns, model.policy, round(request.budget_ms * 1e6))
    found = RateSweep(folder, rows, largest)
    replace_text(folder / "sweep.json", json.dumps(sweep_content(found), indent=1, allow_nan=False) + "\n")
    return found


def sweep_content(found: RateSweep) -> dict[str, object]:
    """Return a sweep as it stands in `sweep.json`."""
    return {"sustainable_rate": found.sustainable_rate, "rates": [dict(vars(row)) for row in found.rows]}


def _row(run: Run, budget_ms: float) -> SweepRow:
    latency, native = run.manifest.latency, run.scores[0].matching
    rate = Fraction(1) if latency is None else Fraction(repr(latency.rate))
    late_ns = int(round(budget_ms * 1e6) * rate)
    times = [(frame.ready_ns, frame.done_ns) for frame in run.frames]
    missed = sum(done is None or (ready is not None and done - ready > late_ns) for ready, done in times)
    scores: dict[str, dict[str, float | None]] = {name: {} for name in (LOCKSTEP, STREAMING, FORECAST)}
    for score in run.scores:
        if score.slice in scores and score.matching == native and score.metric in _METRICS:
            scores[score.slice][score.metric] = score.value
    age = next(score.value for score in run.scores if score.metric == "staleness")
    return SweepRow(float(rate), len(times), sum(done is None for _, done in times), missed, age, scores)


def _read_times_ns(run: Run) -> list[int]:
    """Times [ns] of all frames of a run; one that warmed something up takes as long as the median of the others."""
    total, cold = run.frame_times["total"], warm_up_frames(run.frame_times, run.compiled_frames)
    warm = sorted(ns for frame, ns in total.items() if frame not in cold) or sorted(total.values())
    usual = warm[len(warm) // 2]
    return [usual if frame.index in cold else total.get(frame.index, usual) for frame in run.frames]


def find_sustainable_rate(
    ready_ns: Sequence[int], service_ns: Sequence[int], policy: OverloadPolicy, budget_ns: int
) -> float | None:
    """Return the largest rate at which less than 1 % of the frames miss their deadline, by bisection between 1/1024 and
    1024, to 3 digits; `None` where frames miss it at any rate.

    Args:
        ready_ns: When frames are ready [ns, log time], ascending.
        service_ns: How long each takes [ns, time of the wall clock].
        policy: What becomes of frames that come while the pipeline works.
        budget_ns: How long after it is ready a frame may be done [ns, time of the wall clock].
    """

    def keeps_up(rate: Fraction) -> bool:
        queue = ServiceQueue[int, None](policy, lambda frame: (None, int(service_ns[frame] * rate)))
        limit_ns, missed = int(budget_ns * rate), 0
        for frame, service in queue.run(enumerate(ready_ns)):
            missed += service is None or service.done_ns - ready_ns[frame] > limit_ns
        return 100 * missed < MISSES_PERCENT * len(ready_ns)

    low, high = SLOWEST, FASTEST
    if not keeps_up(low):
        return None
    if keeps_up(high):
        return float(high)
    for _ in range(_STEPS):
        middle = Fraction(math.sqrt(low * high)).limit_denominator(10**9)
        low, high = (middle, high) if keeps_up(middle) else (low, middle)
    step = Fraction(10) ** (math.floor(math.log10(low)) - 2)
    below = math.floor(low / step)
    return float(step * next(num for num in (below + 1, below) if num == below or keeps_up(step * num)))
