"""`fbench profile`, and replays with `--latency profile:FILE`, as a user calls them."""

import json
from pathlib import Path

import pytest

RECORD = ("-p", "lidar3d", "--repeat", "2")


def test_a_profile_is_recorded_and_drawn_from(fbench, log):
    shown = fbench("profile", log, *RECORD, "-o", "profiles/mine.json")
    assert shown.code == 0
    assert "frames: 8 from 2 replays, without those of warm-up" in shown.out
    assert "frames a second" in shown.out
    found = json.loads(Path("profiles/mine.json").read_text())
    names = ["calibrate", "preprocess", "detect.lidar", "track", "(rest)"]
    assert (found["pipeline"], [stage["stage"] for stage in found["stages"]]) == ("lidar3d", names)
    assert found["host"]["reference_ms"] > 0
    how = ("--latency", "profile:profiles/mine.json", "--seed", "3", "--rate", "40", "--no-media")
    drawn = fbench("replay", log, "-p", "lidar3d", *how, "-o", "a", "--json")
    assert drawn.code == 0, drawn.err
    run = drawn.json()
    assert run["manifest"]["latency"]["profile"]["name"] == "mine.json"
    assert run["manifest"]["latency"]["profile"]["seed"] == 3
    assert fbench("replay", log, "-p", "lidar3d", *how, "-o", "b").code == 0
    for name in ("manifest.json", "frames.parquet", "scores.json"):
        assert Path("a", name).read_bytes() == Path("b", name).read_bytes()
    # However busy this machine is, no frame takes a minute.
    words = ("sweep", log, "-p", "lidar3d", *how[:2], "--rates", "1", "--budget-ms", "60000", "-o", "s")
    swept = fbench(*words, "--json").json()
    assert 0 < swept["sustainable_rate"] <= 1024
    for refuses in (("replay", log, "-p", "radar3d", *how, "-o", "c"), ("verify", log, "-p", "radar3d", *how[:2])):
        refused = fbench(*refuses)
        assert refused.code == 2
        assert "was recorded of pipeline 'lidar3d', not of 'radar3d'" in " ".join(refused.err.split())
    kept = Path("profiles/mine.json").read_bytes()
    assert fbench("profile", log, *RECORD, "-o", "profiles/mine.json").code == 2
    assert Path("profiles/mine.json").read_bytes() == kept
    assert fbench("profile", log, *RECORD, "-o", "profiles/mine.json", "--overwrite", "--json").json()["fps"] > 0
    Path("bad.json").write_text(json.dumps(found | {"version": 7}))
    for file, line in (("bad.json", "version 7, this fbench reads 1"), ("none.json", "no such file")):
        refused = fbench("replay", log, "-p", "lidar3d", "--latency", f"profile:{file}")
        assert refused.code == 2
        assert line in " ".join(refused.err.split())
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    ("options", "code", "line"),
    [
        (("-p", "lidar3d", "--frames", ":3", "--repeat", "1"), 3, "only 1 frames are left that warmed nothing up"),
        (("-p", "lidar3d", "-o", "log.txt/p.json"), 2, "log.txt/p.json: can't be written"),
        (("-p", "lidar3d", "--repeat", "1001"), 2, "--repeat 1001: expected 1 to 1000"),
        ((), 2, "which pipeline? give --pipeline NAME"),
    ],
)
def test_profiles_that_can_not_be_recorded(fbench, log, options, code, line):
    Path("log.txt").write_text("")
    refused = fbench("profile", log, *options)
    assert refused.code == code
    assert line in " ".join(refused.err.split())
    assert not Path("profile.json").exists()


def test_the_budget_is_kept_when_a_run_is_scored_again(fbench, log):
    run = fbench("replay", log, "-p", "lidar3d", "-o", "a", "--budget-ms", "0.001", "--json").json()
    latency = run["latency"]
    assert (latency["budget_ms"], latency["over_budget"]) == (0.001, latency["frames"])
    assert [row["stage"] for row in latency["outside"]] == ["wait", "output"]
    assert latency["stages"][-1]["cpu_mean_ms"] > 0
    before = Path("a/latency.json").read_bytes()
    assert fbench("score", "a").code == 0
    assert Path("a/latency.json").read_bytes() == before
    host = json.loads(Path("a/host.json").read_text())
    assert host["peak_memory_mib"] > 20
    assert host["reference_ms"] > 0
    assert {"load", "governor", "threads", "cpu_energy_j", "gpu_energy_j"} <= set(host)
    refused = fbench("replay", log, "-p", "lidar3d", "--budget-ms", "0")
    assert refused.code == 2
    assert "--budget-ms 0: expected more than 0" in refused.err


def test_a_profile_of_other_parameters_is_refused(fbench, log):
    assert fbench("profile", log, "-p", "lidar3d", "-o", "p.json", "--repeat", 2).code == 0
    replay = ("replay", log, "-p", "lidar3d", "--latency", "profile:p.json")
    assert fbench(*replay, "-o", "same").code == 0
    refused = fbench(*replay, "--set", "lidar.cluster.eps_m=0.9", "-o", "other")
    assert refused.code == 2
    assert "was recorded with another value of parameter lidar.cluster.eps_m; record" in " ".join(refused.err.split())


def test_compare_says_that_latencies_are_of_different_machines(fbench, log):
    for name in ("a", "b"):
        assert fbench("replay", log, "-p", "lidar3d", "-o", name, "--no-media").code == 0
    assert "latencies" not in fbench("compare", "a", "b").out
    host = json.loads(Path("b/host.json").read_text())
    Path("b/host.json").write_text(json.dumps(host | {"cpu": "Other", "reference_ms": 9 * host["reference_ms"]}))
    shown = fbench("compare", "a", "b")
    assert shown.code == 0
    assert f"latencies can't be compared: cpu {host['cpu']} and Other; the reference kernel took" in shown.out
