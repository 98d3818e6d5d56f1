"""`--latency` and `--overload`, as a user calls them."""

import json
from pathlib import Path

import pytest
from tests.cli.conftest import messages as make_messages
from tests.cli.conftest import rig, truths, write_log
from tests.cli.test_score_truth import rows as truth_rows

from fbench.api.replays import replay
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

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


def test_streaming_scores_are_compared_by_stretches(fbench, tmp_path):
    log = write_log(tmp_path / "long.mcap", [*make_messages(80, camera=False), *truths(80)], rig(camera=False))
    for name, ms in (("a", 0), ("b", 150)):
        latency = ("--latency", f"fixed:{ms}ms")
        assert fbench("replay", log, "-p", "lidar3d", *latency, "-o", name, "--no-media").code == 0
    found = fbench("compare", "a", "b", "--json").json()["rows"]
    row = next(r for r in found if (r["metric"], r["slice"]) == ("f1", "streaming") and r["matching"].startswith("bev"))
    scores = [rows(name, "streaming")["f1", row["matching"]] for name in ("a", "b")]
    assert [row["base"], row["head"]] == scores
    assert row["low"] <= row["delta"] <= row["high"] < 0


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


PIPELINE = """
from pathlib import Path
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Mine:
    def start(self, rig, log_info): self.note("start")
    def reset(self, reason): pass
    def step(self, frame): return Output(Boxes3D.empty(), Boxes3D.empty(), {})
    def close(self): self.note("close")
    def note(self, what):
        with open("notes.txt", "a") as file: file.write(what + "\\n")
"""


def test_the_first_pipeline_ends_before_the_replay_in_lockstep_which_counts_as_progress(fbench, log):
    Path("mine.py").write_text(PIPELINE)
    request = ReplayRequest(LogRequest(log), "mine.py:Mine", latency="fixed:150ms", out=Path("a"), no_media=True)
    done = []
    num = replay(request, done.append).run.manifest.num_frames
    assert Path("notes.txt").read_text().split() == ["start", "close"] * 2
    assert done == [*range(1, 2 * num + 1)]


def test_several_runs_have_streaming_scores_together(fbench, log):
    for name, extra in (("a", ["--frames", "0:3"]), ("b", ["--frames", "2:6"]), ("c", ["--overload", "fifo:2"])):
        words = ["-p", "lidar3d", "--latency", "fixed:60ms", *extra, "-o", name, "--no-media"]
        assert fbench("replay", log, *words).code == 0
    assert fbench("score", "a", "b", "-o", "together.json").code == 0
    found = {
        name: {(r["metric"], r["slice"], r["matching"]): r for r in json.loads(Path(file).read_text())}
        for name, file in (("a", "a/scores.json"), ("b", "b/scores.json"), ("both", "together.json"))
    }
    for key, row in found["both"].items():
        if key[1] in ("lockstep", "streaming", "streaming, forecast") and key[0] in ("f1", "mota", "staleness"):
            for count, num in row["counts"].items():
                assert num == found["a"][key]["counts"][count] + found["b"][key]["counts"][count]
    assert ("f1", "streaming", "bev 2 m, within 50 m, in view") in found["both"]
    mixed = fbench("score", "a", "c")
    assert "runs differ in latency" in " ".join((mixed.out + mixed.err).split())
