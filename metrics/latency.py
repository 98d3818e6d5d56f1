"""Latency of a run: percentiles of each stage and of the whole frame against a budget."""

import math
from collections.abc import Collection, Mapping, Sequence
from fractions import Fraction
from statistics import median, stdev
from typing import Any

from fbench.replay.data.frames import ClockName
from fbench.replay.data.scores import format_count

NUM_WARM = 2
"""So many first frames of each stage don't count: caches, memory and sessions of other libraries are made there."""
PERCENTILES: Mapping[str, int | Fraction] = {
    "p50_ms": 50, "p90_ms": 90, "p95_ms": 95, "p99_ms": 99, "p999_ms": Fraction(999, 10)
}  # fmt: skip
"""In percent, by name in `latency.json`."""
BUDGET_MS = 100.0
_NS_PER_MS = 1e6
_WHOLE = "total"
_ELSEWHERE = "the pipeline ran in another process that doesn't tell, or passed on what was computed elsewhere"
Times = Mapping[str, Mapping[int, int]]
"""Times [ns] by stage, then by frame; `total` is the whole frame."""


def summarize(
    times: Times,
    compiled: Collection[int] = (),
    clock: ClockName = "host",
    budget_ms: float = BUDGET_MS,
    cpu: Times | None = None,
    outside: Times | None = None,
) -> dict[str, Any]:
    """Summarize `Run.frame_times` for `latency.json`; the whole frame, `total`, is the last stage.

    Percentiles are by nearest rank: the smallest value that at least p % of the values don't exceed, so each is a
    time that was measured. A percentile is given from 100 / (100 - p) values on, so that it isn't merely the largest
    one, else it is `None`. Of wall times a frame counts for nothing where it warmed something up (`warm_up_frames`);
    the first time of each stage is shown apart as `first_ms`. Of times from a log all count, as a system that was at
    work was warm before the log began. What no frame is left for is `None`, with a reason.

    `compiled` are the frames in which code was compiled or loaded; `clock` says whose times they are: wall times of
    this host, or times from a frame's instant to the recording of its result. `budget_ms` is the time that a frame may
    take.
    `cpu` are CPU times by stage and frame, of which the mean is shown; `outside` are times that are no part of the
    whole frame, which are summarized in the same form apart.
    """
    is_host = clock == "host"
    cold = warm_up_frames(times, compiled) if is_host else frozenset[int]()
    counted, stages = count_frames(times, cold), (*(stage for stage in times if stage != _WHOLE), _WHOLE)
    frames = counted.get(_WHOLE, [])
    over = sum(ns > budget_ms * _NS_PER_MS for ns in frames)
    num_compiled = len(cold & set(compiled))
    rows = [stage_latency(stage, counted.get(stage, [])) for stage in stages]
    for row in rows:
        known = [ns for frame, ns in (cpu or {}).get(row["stage"], {}).items() if frame not in cold]
        row["cpu_mean_ms"] = sum(known) / len(known) / _NS_PER_MS if known else None
        if row["count"] and not known:
            row["cpu_reason"] = _ELSEWHERE
        first = next(iter(times.get(row["stage"], {}).values()), None)
        row["first_ms"] = first / _NS_PER_MS if is_host and first is not None else None
        if not row["count"]:
            row["reason"] = "no frame ran it" if first is None else "no frame is left that warmed nothing up"
    return {
        "clock": clock,
        "budget_ms": budget_ms,
        "frames": len(frames),
        "over_budget": over,
        "over_budget_share": over / len(frames) if frames else None,
        "percentile_method": "nearest rank",
        "warm_up_frames": len(cold),
        "compiled_frames": num_compiled,
        "excluded": _describe(len(cold), num_compiled) if is_host else "",
        "stages": rows,
        "outside": [stage_latency(stage, own) for stage, own in count_frames(outside or {}, cold).items()],
    }


def warm_up_frames(times: Times, compiled: Collection[int]) -> frozenset[int]:
    """Return the frames that tell nothing of the speed of a run: in which code was compiled or loaded, and the first
    two of each stage.
    """
    first = {frame for stage in times.values() for frame in list(stage)[:NUM_WARM]}
    return frozenset(first | {frame for frame in compiled if any(frame in stage for stage in times.values())})


def count_frames(times: Times, cold: Collection[int]) -> dict[str, list[int]]:
    """Return the times [ns] of each stage without those of some frames."""
    return {stage: [ns for frame, ns in own.items() if frame not in cold] for stage, own in times.items()}


def stage_latency(stage: str, times_ns: Sequence[int]) -> dict[str, Any]:
    """Summarize times [ns] of a stage; `None`: there are none, or too few."""
    ranked = sorted(times_ns)
    values = {
        name: nearest_rank(ranked, percent) / _NS_PER_MS if len(ranked) * (100 - percent) >= 100 else None
        for name, percent in PERCENTILES.items()
    }
    return {
        "stage": stage,
        "count": len(ranked),
        "mean_ms": sum(ranked) / len(ranked) / _NS_PER_MS if ranked else None,
        **values,
        "max_ms": ranked[-1] / _NS_PER_MS if ranked else None,
    }


def nearest_rank(ranked: Sequence[int], percent: int | Fraction) -> int:
    """Return the smallest of the ascending, non-empty `ranked` that at least `percent` % of them don't exceed."""
    rank = -(-percent * len(ranked) // 100)
    return ranked[max(rank, 1) - 1]


def _describe(num_cold: int, num_compiled: int) -> str:
    what = f"the first {NUM_WARM} of each stage, and those in which code was compiled or loaded"
    return f"{format_count(num_cold, 'frame')} of warm-up ({what}: {num_compiled})"


Timed = tuple[Sequence[int], object]
"""Times [ns] of one stage in one run, and the host that they were measured on."""


def compare_repeats(
    repeats: Sequence[tuple[Timed, Timed]], stage: str, max_ratio: float, min_repeats: int, alpha: float = 0.05
) -> list[str]:
    """Return why a stage's ratio of times, head to base, doesn't pass; empty where it does.

    Each repeat is one pair of runs, measured side by side on one host. Of each the ratio of the medians counts. It
    fails where the mean of their logarithms is above the limit's beyond chance (t test, one-sided). So does what can't
    be judged: too few repeats, or other hosts.
    """
    from scipy import stats  # which takes a while to import

    if len({host for sides in repeats for _, host in sides}) > 1:
        return [f"latency of {stage}: base and head ran on different hosts; repeat both side by side on one"]
    logs = [math.log(median(head) / median(base)) for (base, _), (head, _) in repeats if base and head]
    if len(logs) < min_repeats:
        return [f"latency of {stage}: {format_count(len(logs), 'repeat')}, at least {min_repeats} are needed"]
    mean, spread = sum(logs) / len(logs), stdev(logs) / math.sqrt(len(logs))
    low = mean - float(stats.t.ppf(1 - alpha, len(logs) - 1)) * spread
    if low <= math.log(max_ratio):
        return []
    ratio = f"{math.exp(mean):.3g} times as long, at least {math.exp(low):.3g}"
    return [f"latency of {stage}: {ratio} ({len(logs)} repeats); {max_ratio:g} may be"]
