"""Sweeps over rates: the largest rate that is sustained, and what the command prints and writes."""

import json
import sys
from pathlib import Path

import pytest
from tests.cli.conftest import car_log, fbench, log  # noqa: F401

from fbench.api.sweeps import SweepRequest, find_sustainable_rate
from fbench.replay.contracts.errors import ConfigError, RunError
from fbench.replay.engine.service_queue import OverloadPolicy
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

MS = 1_000_000
TEN_HZ = [100 * MS * i for i in range(1000)]


def rate(service_ms, policy="newest", budget_ms=100, depth=0):
    service = [round(service_ms * MS)] * len(TEN_HZ)
    return find_sustainable_rate(TEN_HZ, service, OverloadPolicy(policy, depth), round(budget_ms * MS))


def test_a_pipeline_keeps_up_as_long_as_a_frame_takes_no_longer_than_the_next_one_needs_to_come():
    assert rate(40, "skip") == 2.5
    assert rate(200, "skip", budget_ms=1000) == 0.5
    # The newest: of 1000 frames 9 may be dropped, so 1000 - 9 must fit.
    assert 2.5 <= rate(40) <= 2.5 / (1 - 0.01)


def test_without_latency_any_rate_is_sustained_and_beyond_the_budget_none():
    assert rate(0) == 1024
    assert rate(101) is None
    assert rate(100) >= 1


def test_frames_that_wait_in_line_miss_their_deadline():
    # In a long line nothing is dropped, but what waits is late: soon above 2.5 all are.
    assert 2.5 <= rate(40, "fifo", depth=1000) < 2.53


@pytest.mark.parametrize(
    ("latency", "rates", "line"),
    [
        (None, ["1"], "give --latency"),
        ("measured", [], "--rates: names no rate"),
        ("measured", ["max"], "--rates max: expected positive numbers"),
        ("measured", ["-1"], "--rates -1: expected positive numbers"),
    ],
)
def test_options_that_make_no_sense(latency, rates, line):
    replay = ReplayRequest(LogRequest(Path("a.mcap")), "lidar3d", latency=latency)
    with pytest.raises(ConfigError, match=line):
        SweepRequest(replay, rates)


def test_the_command(fbench, log):  # noqa: F811
    how = ("-p", "lidar3d", "--latency", "fixed:60ms")
    words = ("sweep", log, *how, "--rates", "1,0.5,4", "-o", "a", "--budget-ms", "90")
    assert "--budget-ms 0: expected more than 0" in fbench(*words, "--budget-ms", "0").err
    shown = fbench(*words)
    assert shown.code == 0
    assert shown.out.split()[:5] == ["rate", "dropped", "%", "missed", "%"]
    assert "sustained up to 1." in shown.out
    content = json.loads(Path("a/sweep.json").read_text())
    usual, slow, fast = content["rates"]
    budgets = [json.loads(path.read_text())["budget_ms"] for path in Path("a").rglob("latency.json")]
    assert budgets == [content["budget_ms"]] * 6 == [90] * 6  # also of the replays in lockstep
    assert (usual["rate"], usual["frames"], usual["dropped"], usual["missed"]) == (1, 6, 0, 0)
    assert (slow["rate"], slow["dropped"]) == (0.5, 0)
    assert fast["dropped"] > 0
    assert usual["scores"]["lockstep"] == fast["scores"]["lockstep"]
    assert {path.name for path in Path("a").iterdir()} == {
        "rate-1", "rate-0.5", "rate-4", "sweep.json", "report.html"
    }  # fmt: skip
    # At half the rate the pipeline gets the same frames, so that it isn't run again; the run is what it would be.
    for rate in ("0.5", "4"):
        assert fbench("replay", log, *how, "--rate", rate, "--no-media", "--on-fault", "tolerant", "-o",
                      f"b{rate}").code == 0  # fmt: skip
        for name in ("scores.json", "manifest.json", "frames.parquet", "tracks.parquet"):
            assert Path(f"b{rate}", name).read_bytes() == Path(f"a/rate-{rate}", name).read_bytes()
    assert fbench(*words).code == 2
    again = fbench(*words[:7], "1", *words[8:], "--overwrite", "--json").json()
    assert again == {"folder": "a", **content, "rates": [usual]}
    assert {path.name for path in Path("a").iterdir()} == {"rate-1", "sweep.json", "report.html"}
    assert not list(Path().glob(".*"))


def test_a_sweep_that_fails_leaves_nothing_and_replaces_nothing(fbench, log, monkeypatch):  # noqa: F811
    words = ("sweep", log, "-p", "lidar3d", "--latency", "fixed:60ms", "--rates", "1", "-o", "a")
    Path("a").mkdir()
    Path("a/mine.txt").write_text("kept")
    assert "exists and isn't a sweep" in fbench(*words, "--overwrite").err
    Path("a/sweep.json").write_text("{}")

    def fail(*args):
        raise RunError("no space left")

    monkeypatch.setattr(sys.modules[SweepRequest.__module__], "write_page", fail)
    assert fbench(*words, "--overwrite").code == 3
    assert Path("a/mine.txt").read_text() == "kept"
    assert not Path(".a.partial").exists()


def test_a_sweep_by_times_measured_here(fbench, log):  # noqa: F811
    found = fbench("sweep", log, "-p", "lidar3d", "--latency", "measured", "--rates", "1", "-o", "a", "--json").json()
    assert found["sustainable_rate"] is None or found["sustainable_rate"] > 0
    assert found["rates"][0]["frames"] == 6
