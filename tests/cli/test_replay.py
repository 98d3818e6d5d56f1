"""`fbench replay` and its friends, as a user calls them."""

import hashlib
from pathlib import Path

import pytest
from tests.cli.conftest import messages, truths, write_log

STILL = """
import numpy as np
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Still:
    def start(self, rig, log_info): self.x = SHIFT
    def reset(self, reason): pass
    def step(self, frame):
        xyz = frame.messages["lidar"].xyz[:90].astype(float)
        middle = (xyz.min(axis=0) + xyz.max(axis=0)) / 2 + [self.x, 0, 0]
        size, one = np.array([[4.0, 1.8, 1.5]]), np.ones(1)
        boxes = Boxes3D(middle[None], size, 0 * one, score=one, track_id=np.array([1]))
        return Output(boxes, boxes, {"detect.lidar": 5})
"""


@pytest.fixture
def still(tmp_path):
    """A pipeline that is right; with `shift` it is wrong by so many meters."""

    def make(shift=0.0, name="still"):
        path = tmp_path / f"{name}.py"
        path.write_text(STILL.replace("SHIFT", str(shift)))
        return f"{path}:Still"

    return make


def files(folder: Path) -> dict[str, str]:
    measured = ("timings.parquet", "latency.json", "host.json")
    return {
        p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir()) if p.name not in measured
    }


def test_outside_pipeline_is_replayed_and_scored(fbench, log, still):
    result = fbench("replay", log, "-p", still(), "--json")
    assert result.code == 0
    content = result.json()
    assert content["run"] == "runs/car-still-Still"
    first = content["scores"][0]
    assert (first["metric"], first["class"], first["value"]) == ("f1", "vehicle", 1.0)
    assert first["counts"]["tp"] == 6
    assert {s["metric"]: s["value"] for s in content["scores"]}["mota"] is not None


def test_table_names_the_run_and_the_budget(fbench, log, still):
    result = fbench("replay", log, "-p", still(), "-o", "out/run")
    assert result.code == 0
    assert "f1" in result.out
    assert "frames over the budget of 100 ms" in result.out
    assert "run: out/run" in result.out
    assert result.err == ""


@pytest.mark.parametrize("pipeline", ["lidar3d", "radar3d", "early3d", "late3d"])
def test_builtin_pipelines_are_the_same_at_any_rate(fbench, log, pipeline):
    for name, rate in (("a", "max"), ("b", "max"), ("c", "2")):
        assert fbench("replay", log, "-p", pipeline, "-o", name, "--rate", rate).code == 0
    assert files(Path("a")) == files(Path("b")) == files(Path("c"))


def test_scores_follow_the_options_without_replaying(fbench, log, still):
    assert fbench("replay", log, "-p", still(3.0), "-o", "run").code == 0
    strict, lax = fbench("score", "run", "--json").json(), fbench("score", "run", "--distance-m", "4", "--json").json()
    assert strict["scores"][0]["value"] == 0.0
    assert lax["scores"][0]["value"] == 1.0


def test_compare_finds_the_regression(fbench, log, still):
    fbench("replay", log, "-p", still(), "-o", "good")
    fbench("replay", log, "-p", still(3.0, "worse"), "-o", "bad")
    same, worse, better = (
        fbench("compare", "good", "good"),
        fbench("compare", "good", "bad"),
        fbench("compare", "bad", "good"),
    )
    assert (same.code, worse.code, better.code) == (0, 1, 0)
    assert "REGRESSED" in worse.out
    assert "no regression" in better.out
    assert fbench("compare", "good", "bad", "--tolerance", "5").code == 0
    assert fbench("compare", "good", "bad", "--json").json()["regressed"] is True


def test_compare_refuses_other_logs(fbench, log, still, tmp_path):
    other = write_log(tmp_path / "other.mcap", [*messages(4), *truths(4)])
    fbench("replay", log, "-p", still(), "-o", "a")
    fbench("replay", other, "-p", still(), "-o", "b")
    result = fbench("compare", "a", "b")
    assert result.code == 3
    assert "different logs" in result.err


def test_report_is_written(fbench, log, still):
    fbench("replay", log, "-p", still(), "-o", "run")
    result = fbench("report", "run", "-o", "page.html")
    assert result.code == 0
    assert Path("page.html").read_text().startswith("<!doctype html>")


def test_log_without_truth_replays_with_null_scores(fbench, tmp_path, still):
    log = write_log(tmp_path / "blind.mcap", messages())
    result = fbench("replay", log, "-p", still(), "--json")
    assert result.code == 0
    f1 = result.json()["scores"][0]
    assert f1["value"] is None
    assert "truth" in f1["reason"]
    scored = fbench("score", "runs/blind-still-Still")
    assert scored.code == 3
    assert "has no truth" in scored.err


def test_log_info(fbench, log):
    text, content = fbench("log", "info", log), fbench("log", "info", log, "--json")
    assert text.code == content.code == 0
    assert "6 frames by lidar" in text.out
    info = content.json()
    assert {s["sensor"]: s["num_messages"] for s in info["streams"]} == {"camera": 6, "lidar": 6, "radar": 6}
    assert info["truth"] == 6
    assert info["segments"] == 1
    assert info["cameras"]["camera"]["size_wh"] == [80, 60]


@pytest.mark.slow
def test_plugins_are_listed_with_their_parameters(fbench):
    assert "late3d" in fbench("plugins", "pipelines").out
    assert "lidar.cluster.eps_m" in fbench("plugins", "pipelines", "lidar3d").out
    assert fbench("plugins", "pipeline").err == "fbench: unknown group 'pipeline'; did you mean 'pipelines'?\n"
