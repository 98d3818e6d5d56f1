"""Latency of a run: percentiles of each stage and of the whole frame against a budget."""

from collections.abc import Mapping, Sequence
from typing import Any

from fbench.replay.data.frames import ClockName

_NS_PER_MS = 1e6
_WHOLE = "total"
_EXCLUDED = "the first run of each stage (first_ms), which also compiles, loads and allocates"


def summarize(
    timings: Mapping[str, Sequence[int]], clock: ClockName = "host", budget_ms: float = 100.0
) -> dict[str, Any]:
    """Summarise `Run.timings` for `latency.json`; the whole frame, `total`, is the last stage.

    Percentiles are by nearest rank: the smallest value that at least p % of the values don't exceed, so each is a
    time that was measured. Of wall times the first run of each stage is shown apart as `first_ms` and is in no other
    number; of times from a log all count, as a system that was at work had its first run before the log began.

    `timings` are times [ns] by stage, in the order of frames; `clock` says whose: wall times of this host, or times
    from a frame's instant to the recording of its result. `budget_ms` is the time that a frame may take.
    """
    num_first, stages = 1 if clock == "host" else 0, (*(stage for stage in timings if stage != _WHOLE), _WHOLE)
    frames = timings.get(_WHOLE, [])[num_first:]
    over = sum(ns > budget_ms * _NS_PER_MS for ns in frames)
    return {
        "clock": clock,
        "budget_ms": budget_ms,
        "frames": len(frames),
        "over_budget": over,
        "over_budget_share": over / len(frames) if frames else None,
        "percentile_method": "nearest rank",
        "excluded": _EXCLUDED if num_first else "",
        "stages": [stage_latency(stage, timings.get(stage, []), num_first) for stage in stages],
    }


def stage_latency(stage: str, times_ns: Sequence[int], num_first: int = 1) -> dict[str, Any]:
    """Summarise times [ns] of a stage, in its order, without the first `num_first`, 0 or 1; `None`: no others."""
    ranked = sorted(times_ns[num_first:])
    values = {
        f"p{percent}_ms": nearest_rank(ranked, percent) / _NS_PER_MS if ranked else None for percent in (50, 95, 99)
    }
    return {
        "stage": stage,
        "count": len(ranked),
        "first_ms": times_ns[0] / _NS_PER_MS if num_first and times_ns else None,
        "mean_ms": sum(ranked) / len(ranked) / _NS_PER_MS if ranked else None,
        **values,
        "max_ms": ranked[-1] / _NS_PER_MS if ranked else None,
    }


def nearest_rank(ranked: Sequence[int], percent: int) -> int:
    """Return the smallest of the ascending, non-empty `ranked` that at least `percent` % of them don't exceed."""
    rank = -(-percent * len(ranked) // 100)
    return ranked[max(rank, 1) - 1]
