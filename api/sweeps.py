"""Sweeps: one log at several rates, what is dropped and what outputs are worth, and the largest rate kept up with."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from shutil import copytree

from fbench.api.replays import name_pipeline, replay
from fbench.api.scores import IN_LOCKSTEP, score_folder
from fbench.api.suites.runner import share_memory
from fbench.metrics.latency import warm_up_frames
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.files import Draft, replace_text
from fbench.replay.data.scores import FORECAST, LOCKSTEP, STREAMING, ScoreOptions
from fbench.replay.engine.clock import make_clock
from fbench.replay.engine.service_queue import LatencyModel, OverloadPolicy, ServiceQueue
from fbench.replay.engine.shared import SharedLogs
from fbench.replay.runs.folder import FRAMES, Run, write_frames
from fbench.replay.runs.manifest import save_manifest
from fbench.replay.setup.request import ReplayRequest
from fbench.reports.html.charts import Axis, Chart, Curve, Page, Table, texts, write_page

MISSES_PERCENT = 1
"""A rate is sustained while less than so many percent of the frames miss their deadline."""
SLOWEST, FASTEST = Fraction(1, 1024), Fraction(1024)
_STEPS = 20  # Of the bisection: the last is below a millionth of the first
_METRICS = ("f1", "mota", "hota")
_LIMITS = (
    "The dashed vertical line is the largest rate that is sustained, where the axis holds it. The dashed horizontal "
    "line is the share of missed deadlines from which on a rate isn’t."
)


@dataclass(frozen=True)
class SweepRequest:
    """Replays of one log at several rates. Raises ConfigError where an option isn't as expected."""

    replay: ReplayRequest
    """With latency; its `out` gets a folder a rate, its own rate plays no part. A frame that isn't done `budget_ms`
    after it was ready misses its deadline, in time of the wall clock.
    """
    rates: Sequence[str]
    """How many times as fast as in real time the log passes."""

    def __post_init__(self) -> None:
        if self.replay.latency is None:
            raise ConfigError("how long does the pipeline take? give --latency, such as fixed:80ms or measured")
        if not self.rates:
            raise ConfigError("--rates: names no rate, such as 0.5,1,2")
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
    log: str
    pipeline: str
    latency: str
    overload: str
    budget_ms: float
    rows: Sequence[SweepRow]
    sustainable_rate: float | None
    """The largest rate at which less than 1 % of the frames miss their deadline, to 3 digits; `None`: no rate is."""


RESULT, PAGE = "sweep.json", "report.html"
"""Files of a sweep, beside the run folders."""


def sweep(request: SweepRequest, progress: Callable[[int, int], None] = lambda done, total: None) -> RateSweep:
    """Replay the log at each rate, and once in lockstep, and write a folder with the runs, `sweep.json` and a page with
    plots, which gets its name when it is whole. `progress` gets how many rates are done, of how many. Raises as
    `replay` does.
    """
    folder = request.replay.out or Path("runs/sweep")
    if folder.exists() and not request.replay.overwrite:
        raise ConfigError(f"{folder}: exists already; choose another with --out, or --overwrite it")
    if folder.exists() and not (folder / RESULT).is_file():
        raise ConfigError(f"{folder}: exists and isn't a sweep, so --overwrite doesn't touch it")
    options, budget_ms = request.replay.resolve(), request.replay.budget_ms
    model = options.latency or LatencyModel()
    with Draft(folder, is_folder=True) as draft, SharedLogs(share_memory(1)) as shared:
        runs, rates = list[Run](), list(dict.fromkeys(request.rates))
        for num, rate in enumerate(rates):
            progress(num, len(rates))
            one = replace(request.replay, rate=rate, out=draft.path / f"rate-{rate}", overwrite=False, report=False)
            paced = replace(model, rate=Fraction(repr(float(rate))))
            run = _repeat_run(runs, paced, draft.path / f"rate-{rate}", one.scoring) if runs else None
            lockstep = runs[0].folder / IN_LOCKSTEP if runs else None
            runs.append(run or replay(one, shared=shared, lockstep=lockstep).run)
        rows = [_row(run, float(rate), budget_ms) for run, rate in zip(runs, rates, strict=True)]
        ready_ns, lockstep = _ready_ns(runs[0]), runs[0].folder / IN_LOCKSTEP
        if model.profile is not None:
            log_id = options.log.open(FaultLog()).info.log_id  # that of a redacted run is another
            service_ns = model.profile.draw_run_ns(model.seed, Run(lockstep), log_id)
        else:
            fixed_ns = model.fixed_ns
            service_ns = _read_times_ns(Run(lockstep)) if fixed_ns is None else [fixed_ns] * len(ready_ns)
        largest = find_sustainable_rate(ready_ns, service_ns, model.policy, round(budget_ms * 1e6))
        names = runs[0].manifest.log.name, name_pipeline(request.replay), request.replay.latency or ""
        found = RateSweep(folder, *names, str(model.policy), budget_ms, rows, largest)
        replace_text(draft.path / RESULT, json.dumps(sweep_content(found), indent=1, allow_nan=False) + "\n")
        _draw(found, draft.path / PAGE)
        draft.publish()
    return found


def _repeat_run(runs: Sequence[Run], model: LatencyModel, folder: Path, scoring: ScoreOptions) -> Run | None:
    """Write the run of another rate at which the pipeline gets the same frames, so that it gives the same, with other
    times; `None`: there is no such run, or times are measured, so that nobody knows beforehand.
    """
    if model.fixed_ns is None:
        return None
    queue = ServiceQueue[int, None](model.policy, lambda frame: (None, model.service_ns(0)))
    served = [service for _, service in queue.run(enumerate(_ready_ns(runs[0])))]
    same = (r for r in runs if [f.is_dropped for f in r.frames] == [service is None for service in served])
    if (run := next(same, None)) is None or (latency := run.manifest.latency) is None:
        return None
    copytree(run.folder, folder)
    times = [(None, None) if service is None else (service.start_ns, service.done_ns) for service in served]
    frames = [replace(f, start_ns=a, done_ns=b) for f, (a, b) in zip(run.frames, times, strict=True)]
    write_frames(folder / FRAMES, frames, run.poses)
    entry = latency.model_copy(update={"rate": float(model.rate)})
    save_manifest(folder / "manifest.json", run.manifest.model_copy(update={"latency": entry}))
    return score_folder(folder, scoring)


def _ready_ns(run: Run) -> list[int]:
    return [frame.ready_ns or 0 for frame in run.frames]


def sweep_content(found: RateSweep) -> dict[str, object]:
    """Return a sweep as it stands in `sweep.json`."""
    names = ("log", "pipeline", "latency", "overload", "budget_ms", "sustainable_rate")
    return {**{name: getattr(found, name) for name in names}, "rates": [dict(vars(row)) for row in found.rows]}


def _draw(found: RateSweep, out: Path) -> None:
    """Write the page with accuracy, age and drops against the rate."""
    rows, rates, parts = found.rows, [row.rate for row in found.rows], (FORECAST, STREAMING, LOCKSTEP)
    names = [f"{rate:g}×" for rate in rates]
    axis = Axis("rate", list(zip(rates, names, strict=True)), is_log=True, limit=found.sustainable_rate)

    def curve(name: str, values: Sequence[float | None]) -> Curve:
        return Curve(name, list(zip(rates, values, strict=True)))

    charts = [
        Chart(metric.upper(), axis, [curve(part, [row.scores[part].get(metric) for row in rows]) for part in parts])
        for metric in _METRICS
    ]
    charts.append(Chart("Age of outputs, ms", axis, [curve("mean", [row.staleness_ms for row in rows])]))
    shares = {"missed": [row.missed for row in rows], "dropped": [row.dropped for row in rows]}
    of = [row.frames for row in rows]
    lines = [curve(name, [100 * a / b for a, b in zip(num, of, strict=True)]) for name, num in shares.items()]
    charts.append(Chart("Frames, %", axis, lines, MISSES_PERCENT))
    kept = "at no rate" if found.sustainable_rate is None else f"up to {found.sustainable_rate:g}×"
    facts = [("Pipeline", found.pipeline), ("Latency", found.latency), ("Overload", found.overload),
             ("Deadline", f"{found.budget_ms:g} ms"), ("Frames", str(max(of))), ("Sustained", kept)]  # fmt: skip
    table = [
        (f"{chart.title}, {one.name}", texts([y for _, y in one.points])) for chart in charts for one in chart.curves
    ]
    notes = [] if found.sustainable_rate is None else [_LIMITS]
    write_page(out, Page("sweep over rates", found.log, facts, charts, Table(["Rate", *names], table), notes))


def _row(run: Run, rate: float, budget_ms: float) -> SweepRow:
    native, late_ns = run.scores[0].matching, int(round(budget_ms * 1e6) * Fraction(repr(rate)))
    times = [(frame.ready_ns, frame.done_ns) for frame in run.frames]
    missed = sum(done is None or (ready is not None and done - ready > late_ns) for ready, done in times)
    scores: dict[str, dict[str, float | None]] = {name: {} for name in (LOCKSTEP, STREAMING, FORECAST)}
    for score in run.scores:
        if score.slice in scores and score.matching == native and score.metric in _METRICS:
            scores[score.slice][score.metric] = score.value
    age = next(score.value for score in run.scores if score.metric == "staleness")
    return SweepRow(rate, len(times), sum(done is None for _, done in times), missed, age, scores)


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
