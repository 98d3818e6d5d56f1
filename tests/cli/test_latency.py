"""`--latency` and `--overload`, as a user calls them."""

import json
from pathlib import Path

import pytest
from tests.cli.conftest import messages as make_messages
from tests.cli.conftest import write_log
from tests.cli.test_score_truth import rows as truth_rows

SLOW = ("--latency", "fixed:150ms", "--overload", "skip")


def rows(folder, part):
    found = json.loads(Path(folder, "scores.json").read_text())
    return {(row["metric"], row["matching"]): row["value"] for row in found if row["slice"] == part}


def test_the_price_of_latency(fbench, log):
    shown = fbench("replay", log, "-p", "lidar3d", *SLOW, "-o", "a", "--no-media", "--report")
    assert shown.code == 0
    assert "lockstep  streaming  streaming, forecast  price" in shown.out
    assert "ms old on average" in shown.out
    assert "dropped: 3 frames (latency fixed:150ms, overload skip, at 1x)" in shown.out
    assert fbench("replay", log, "-p", "lidar3d", "-o", "plain", "--no-media").code == 0
    manifests = [json.loads(Path(name, "manifest.json").read_text()) for name in ("a", "a/lockstep", "plain")]
    assert manifests[1] == manifests[2]
    assert manifests[0]["latency"] == {
        "service_ns": 150_000_000, "overload": "skip", "rate": 1.0, "num_dropped": 3
    }  # fmt: skip
    plain = rows("plain", "all")
    assert rows("a", "lockstep").items() <= plain.items()
    before = Path("a/scores.json").read_bytes()
    assert fbench("score", "a").code == 0
    assert Path("a/scores.json").read_bytes() == before
    assert fbench("report", "a", "plain", "-o", "both.html").code == 0
    compared = fbench("compare", "plain", "a")
    assert "latency: none -> fixed:150ms, overload skip, at 1x" in compared.out


def test_no_latency_is_lockstep(fbench, log):
    shown = fbench("replay", log, "-p", "lidar3d", "--latency", "fixed:0ms", "-o", "a", "--no-media", "--json").json()
    assert shown["manifest"]["latency"]["num_dropped"] == 0
    lockstep = rows("a", "lockstep")
    assert {metric for metric, _ in lockstep} == {"f1", "precision", "recall", "ap", "mota", "idf1", "hota"}
    streaming, forecast, own = (rows("a", part) for part in ("streaming", "streaming, forecast", "all"))
    assert forecast == lockstep
    assert streaming == {**lockstep, ("staleness", ""): 0.0}
    assert lockstep.items() <= own.items()


def test_other_truth_counts_in_lockstep_too(fbench, tmp_path):
    write_log(tmp_path / "bare.mcap", make_messages())
    shown = fbench("replay", "bare.mcap", "-p", "lidar3d", "--latency", "fixed:0ms", "--all-around", "-o", "a")
    assert shown.code == 0
    assert set(rows("a", "lockstep").values()) == {None}
    Path("truth.csv").write_text(truth_rows())
    assert fbench("score", "a", "--truth", "truth.csv", "--all-around").code == 0
    lockstep = rows("a", "lockstep")
    assert {metric: value for (metric, matching), value in lockstep.items() if matching.startswith("bev")}["f1"] == 1
    assert rows("a", "streaming, forecast") == lockstep


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--latency", "80ms"], "--latency 80ms: expected 'measured', a time such as 'fixed:80ms'"),
        (["--overload", "skip"], "--overload skip: is about --latency, which is missing"),
        ([*SLOW[:2], "--overload", "fifo:0"], "--overload fifo:0: expected 'newest', 'skip', or 'fifo:N'"),
        (["--latency", "measured", "--rate", "0"], "--rate 0: expected 'max' or a positive number"),
    ],
)
def test_options_that_make_no_sense(fbench, log, options, line):
    refused = fbench("replay", log, "-p", "lidar3d", *options)
    assert refused.code == 2
    assert line in " ".join(refused.err.split())
    assert not Path("runs").exists()
