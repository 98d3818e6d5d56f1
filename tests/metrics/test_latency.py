"""Latency summaries against hand-checked ranks."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.metrics.latency import compare_repeats, count_frames, nearest_rank, stage_latency, summarize, warm_up_frames

MS = 1_000_000


def whole(found: dict[str, Any]) -> dict[str, Any]:
    row: dict[str, Any] = found["stages"][-1]
    assert row["stage"] == "total"
    return row


def by_frame(*ms: float, first: int = 0) -> dict[int, int]:
    return {first + i: round(value * MS) for i, value in enumerate(ms)}


def test_percentiles_are_measured_values() -> None:
    found = stage_latency("fuse", [i * MS for i in range(100, 0, -1)])
    assert found == {
        "stage": "fuse", "count": 100, "mean_ms": 50.5,
        "p50_ms": 50.0, "p90_ms": 90.0, "p95_ms": 95.0, "p99_ms": 99.0, "p999_ms": None, "max_ms": 100.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "least", "value"),
    [("p50_ms", 2, 1), ("p90_ms", 10, 9), ("p95_ms", 20, 19), ("p99_ms", 100, 99), ("p999_ms", 1000, 999)],
)
def test_a_percentile_needs_a_value_above_it(name: str, least: int, value: int) -> None:
    assert stage_latency("track", [i * MS for i in range(1, least)])[name] is None
    assert stage_latency("track", [i * MS for i in range(1, least + 1)])[name] == value


def test_cpu_time_and_times_outside_of_the_frame() -> None:
    """Of CPU times the mean, without frames of warm-up; what isn't known has a reason."""
    times = {"track": by_frame(9, 9, 2, 2), "total": by_frame(90, 90, 20, 30)}
    cpu = {"total": by_frame(500, 500, 30, 50)}
    found = summarize(times, cpu=cpu, outside={"wait": by_frame(0, 0, 30, 10)})
    assert [row["cpu_mean_ms"] for row in found["stages"]] == [None, 40.0]
    assert ["another process" in row.get("cpu_reason", "") for row in found["stages"]] == [True, False]
    assert [(row["stage"], row["count"], row["max_ms"]) for row in found["outside"]] == [("wait", 2, 30.0)]
    assert found["frames"] == 2


def test_the_first_two_frames_of_a_stage_count_nowhere() -> None:
    """The radar is there from frame 3 on: what it warms up in frames 3 and 4 is in no number of the whole frame."""
    times = {
        "detect.lidar": by_frame(900, 90, 10, 10, 10, 12, 10),
        "detect.radar": by_frame(700, 70, 8, 9, first=3),
        "total": by_frame(1000, 100, 20, 720, 90, 30, 31),
    }
    found = summarize(times)
    assert [row["stage"] for row in found["stages"]] == ["detect.lidar", "detect.radar", "total"]
    assert [row["first_ms"] for row in found["stages"]] == [900.0, 700.0, 1000.0]
    assert [(row["count"], row["max_ms"]) for row in found["stages"]] == [(3, 12.0), (2, 9.0), (3, 31.0)]
    assert (found["frames"], found["over_budget"], found["warm_up_frames"], found["compiled_frames"]) == (3, 0, 4, 0)


def test_frames_in_which_code_was_compiled_count_nowhere() -> None:
    times = {"track": by_frame(9, 1, 1, 500, 2, 3), "total": by_frame(90, 10, 10, 600, 20, 30)}
    found = summarize(times, frozenset([0, 3, 77]))
    assert (found["frames"], found["over_budget"], whole(found)["max_ms"]) == (3, 0, 30.0)
    assert (found["warm_up_frames"], found["compiled_frames"]) == (3, 2)
    assert found["excluded"].startswith("3 frames of warm-up (the first 2 of each stage, ")
    assert warm_up_frames(times, [3]) == {0, 1, 3}
    assert count_frames(times, [0, 1, 3]) == {"track": [MS, 2 * MS, 3 * MS], "total": [10 * MS, 20 * MS, 30 * MS]}


def test_times_from_a_log_have_no_warm_up() -> None:
    """The system was at work before the log began; a stage's name says nothing about whose times they are."""
    times = {"recorded": by_frame(80, 81, 120), "total": by_frame(80, 81, 120)}
    found = summarize(times, [1], "log")
    assert (found["clock"], found["frames"], found["over_budget"], found["excluded"]) == ("log", 3, 1, "")
    assert [(row["count"], row["first_ms"], row["p50_ms"]) for row in found["stages"]] == [(3, None, 81.0)] * 2
    assert whole(summarize({"total": by_frame(80)}, clock="log"))["max_ms"] == 80.0
    found = summarize(times)
    assert (found["clock"], found["frames"], whole(found)["first_ms"]) == ("host", 1, 80.0)


def test_frames_over_the_budget() -> None:
    times = by_frame(300, 200, 100, 100.000001, 50, 200)
    found = summarize({"total": times})
    assert [found[k] for k in ("budget_ms", "frames", "over_budget", "over_budget_share")] == [100.0, 4, 2, 0.5]
    assert summarize({"total": times}, budget_ms=250)["over_budget"] == 0


@pytest.mark.parametrize(
    ("times", "reason"),
    [({}, "no frame ran it"), ({"total": by_frame(5, 6)}, "no frame is left that warmed nothing up"),
     ({"total": {}}, "no frame ran it")],
)  # fmt: skip
def test_nothing_but_warm_up_is_null_with_a_reason(times: dict[str, dict[int, int]], reason: str) -> None:
    found = summarize(times)
    assert whole(found)["count"] == 0
    assert whole(found)["p99_ms"] is None
    assert whole(found)["reason"] == reason
    assert found["over_budget_share"] is None
    json.dumps(found, allow_nan=False)


@given(st.lists(st.integers(0, 10**12), min_size=1), st.integers(1, 100))
def test_nearest_rank_equals_numpy(times: list[int], percent: int) -> None:
    ranked = sorted(times)
    assert nearest_rank(ranked, percent) == np.percentile(ranked, percent, method="inverted_cdf")


@pytest.mark.parametrize(
    ("ratio", "num", "hosts", "said"),
    [
        (1.0, 5, 1, []),
        (1.5, 5, 1, ["latency of total: 1.5"]),
        (1.5, 4, 1, ["latency of total: 4 repeats, at least 5 are needed"]),
        (1.0, 5, 2, ["latency of total: base and head ran on different hosts"]),
    ],
)
def test_latency_is_judged_by_the_ratio_of_repeats(ratio: float, num: int, hosts: int, said: list[str]) -> None:
    times = [[100 + n, 102 + n, 101 + n] for n in range(num)]
    repeats = [((own, "a"), ([round(ratio * t) for t in own], "a" if hosts == 1 else n)) for n, own in enumerate(times)]
    found = compare_repeats(repeats, "total", 1.2, 5)
    assert len(found) == len(said)
    assert all(text.startswith(start) for text, start in zip(found, said, strict=True))
