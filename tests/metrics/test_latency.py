"""Latency summaries against hand-checked ranks."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.metrics.latency import nearest_rank, stage_latency, summarize

MS = 1_000_000


def whole(found: dict[str, Any]) -> dict[str, Any]:
    row: dict[str, Any] = found["stages"][-1]
    assert row["stage"] == "total"
    return row


def test_percentiles_are_measured_values() -> None:
    found = stage_latency("fuse", [500 * MS, *(i * MS for i in range(100, 0, -1))])
    assert found == {
        "stage": "fuse", "count": 100, "first_ms": 500.0, "mean_ms": 50.5,
        "p50_ms": 50.0, "p95_ms": 95.0, "p99_ms": 99.0, "max_ms": 100.0,
    }  # fmt: skip


def test_the_first_run_of_a_stage_is_apart() -> None:
    found = summarize({"detect": [900 * MS, 10 * MS], "total": [1000 * MS, 20 * MS, 30 * MS]})
    assert [row["stage"] for row in found["stages"]] == ["detect", "total"]
    assert found["stages"][0]["first_ms"] == 900.0
    assert found["stages"][0]["max_ms"] == 10.0
    assert whole(found)["max_ms"] == 30.0


def test_times_from_a_log_have_no_first_run() -> None:
    """The system was at work before the log began; a stage's name says nothing about whose times they are."""
    timings = {"recorded": [80 * MS, 81 * MS, 120 * MS], "total": [80 * MS, 81 * MS, 120 * MS]}
    found = summarize(timings, "log")
    assert (found["clock"], found["frames"], found["over_budget"], found["excluded"]) == ("log", 3, 1, "")
    assert [(row["count"], row["first_ms"], row["p50_ms"]) for row in found["stages"]] == [(3, None, 81.0)] * 2
    assert whole(summarize({"total": [80 * MS]}, "log"))["p99_ms"] == 80.0
    found = summarize(timings)
    assert (found["clock"], found["frames"], whole(found)["first_ms"]) == ("host", 2, 80.0)


def test_frames_over_the_budget() -> None:
    times = [300 * MS, 100 * MS, 100 * MS + 1, 50 * MS, 200 * MS]
    found = summarize({"total": times})
    assert [found[k] for k in ("budget_ms", "frames", "over_budget", "over_budget_share")] == [100.0, 4, 2, 0.5]
    assert summarize({"total": times}, budget_ms=250)["over_budget"] == 0


@pytest.mark.parametrize("timings", [{}, {"total": [5 * MS]}, {"total": []}])
def test_nothing_but_the_first_frame_is_null(timings: dict[str, list[int]]) -> None:
    found = summarize(timings)
    assert whole(found)["count"] == 0
    assert whole(found)["p99_ms"] is None
    assert found["over_budget_share"] is None
    json.dumps(found, allow_nan=False)


@given(st.lists(st.integers(0, 10**12), min_size=1), st.integers(1, 100))
def test_nearest_rank_equals_numpy(times: list[int], percent: int) -> None:
    ranked = sorted(times)
    assert nearest_rank(ranked, percent) == np.percentile(ranked, percent, method="inverted_cdf")
