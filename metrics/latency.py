"""Latency of a run: percentiles of each stage and of the whole frame against a budget."""

from collections.abc import Mapping, Sequence
from typing import Any

_NS_PER_MS = 1e6
_WHOLE = "total"
_RECORDED = "recorded"
"""The stage that stands for another system's: its times come from the log."""


def summarise(timings: Mapping[str, Sequence[int]], budget_ms: float = 100.0) -> dict[str, Any]:
    """Summarise `Run.timings` for `latency.json`; the whole frame, `total`, is the last stage.

    Percentiles are by nearest rank: the smallest value that at least p % of the values don't exceed, so each is a
    time that was measured. The first run of each stage is shown apart as `first_ms` and is in no other number.

    Args:
        timings: Wall times [ns] by stage, in the order of frames; `total` is the whole frame. Where results were only
            recorded (a stage `recorded`), they are times from a frame's instant to the recording of its result.
        budget_ms: Time that a frame may take.
    """
    frames = timings.get(_WHOLE, [])[1:]
    clock = "log" if _RECORDED in timings else "host"
    over = sum(ns > budget_ms * _NS_PER_MS for ns in frames)
    stages = [stage for stage in timings if stage != _WHOLE]
    return {
        "clock": clock,
        "budget_ms": budget_ms,
        "frames": len(frames),
        "over_budget": over,
        "over_budget_share": over / len(frames) if frames else None,
        "percentile_method": "nearest rank",
        "excluded": "the first run of each stage (first_ms), which also compiles, loads and allocates",
        "stages": [stage_latency(stage, timings.get(stage, [])) for stage in (*stages, _WHOLE)],
    }


def stage_latency(stage: str, times_ns: Sequence[int]) -> dict[str, Any]:
    """Summarise the times [ns] of one stage, in the order in which it ran; `None` where only the first is there."""
    ranked = sorted(times_ns[1:])
    values = {
        f"p{percent}_ms": nearest_rank(ranked, percent) / _NS_PER_MS if ranked else None for percent in (50, 95, 99)
    }
    return {
        "stage": stage,
        "count": len(ranked),
        "first_ms": times_ns[0] / _NS_PER_MS if times_ns else None,
        "mean_ms": sum(ranked) / len(ranked) / _NS_PER_MS if ranked else None,
        **values,
        "max_ms": ranked[-1] / _NS_PER_MS if ranked else None,
    }


def nearest_rank(ranked: Sequence[int], percent: int) -> int:
    """Return the smallest of the ascending, non-empty `ranked` that at least `percent` % of them don't exceed."""
    rank = -(-percent * len(ranked) // 100)
    return ranked[max(rank, 1) - 1]
