"""What programs and notebooks call."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from tests.city_log import write_city_log
from tests.program import fbench

from fbench.api import (
    LogRequest,
    ReplayRequest,
    Resampling,
    ScoreOptions,
    ScoreRequest,
    compare,
    open_log,
    open_run,
    replay,
    report,
    score,
)
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.logs.setup import BoxSource

NOTEBOOK = Path(__file__).parents[2] / "examples" / "quickstart.ipynb"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "city.mcap"
    write_city_log(path, seconds=1.0)
    return path


@pytest.fixture(scope="module")
def run(log, tmp_path_factory):
    return replay(ReplayRequest(LogRequest(log), "lidar3d", out=tmp_path_factory.mktemp("runs") / "a<b>"))


def test_tables_of_a_run(run):
    assert open_run(run.folder).run.manifest == run.run.manifest
    scores = run.scores()
    assert list(scores.columns) == ["metric", "class", "slice", "matching", "value", "reason", "unit", "counts"]
    assert len(scores) == len(json.loads((run.folder / "scores.json").read_text()))
    assert set(run.tracks()["frame"]) <= set(run.frames()["index"])
    assert len(run.detections()) == len(run.run.detections.frames)
    assert len(run.truth())
    assert list(run.latency().index)[-1] == "total"
    assert "&lt;b&gt;" in run._repr_html_()
    assert "<b>city" in run._repr_html_()


def test_messages_and_frames_of_a_log(log, run):
    opened = open_log(log)
    assert {type(message).__name__ for message in opened.messages()} >= {"PointCloud", "RadarScan", "Pose"}
    frames = list(opened.frames())
    assert [frame.stamp_ns for frame in frames] == [frame.stamp_ns for frame in run.run.frames]
    assert [frame.index for frame in opened.frames(frames="2:4")] == [2, 3]
    assert "lidar" in opened._repr_html_()
    assert dict(opened.faults.counts) == {}


def test_an_option_is_the_same_from_python_and_from_the_command_line(log, run, tmp_path):
    request = ReplayRequest(
        LogRequest(log), "lidar3d", timeout_ms=45.0, tolerance_ms=20.0, max_gap_s=1.5, offset=("radar=1",),
        frames="2:6", out=tmp_path / "python",
    )  # fmt: skip
    found = replay(ReplayRequest.from_json(request.to_json())).run.manifest.frames
    assert (found.timeout_ns, found.tolerance_ns, found.max_gap_ns) == (45_000_000, 20_000_000, 1_500_000_000)
    assert (found.offsets_ns, found.excerpt) == ({"radar": 1_000_000}, "frames 2:6")
    options = ("--timeout-ms", 45, "--tolerance-ms", 20, "--max-gap-s", 1.5, "--offset", "radar=1", "--frames", "2:6")
    assert fbench("replay", log, "-p", "lidar3d", *options, "-o", tmp_path / "shell") == 0
    for name in ("manifest.json", "frames.parquet", "detections.parquet", "tracks.parquet", "scores.json"):
        assert (tmp_path / "python" / name).read_bytes() == (tmp_path / "shell" / name).read_bytes(), name


def test_scores_comparison_and_report(log, run, tmp_path):
    other = replay(
        ReplayRequest(LogRequest(log), "lidar3d", ["lidar.cluster.eps_m=0.2"], out=tmp_path / "other", no_media=True)
    )
    found = compare(run.folder, other.folder)
    assert found.is_worse == any(row.verdict == "REGRESSED" for row in found.comparison.gating)
    assert found._repr_html_().count("<tr") > len(found.rows())
    near = score(ScoreRequest([other.folder], ScoreOptions(range_m=20)))
    assert "within 20 m" in near.rows[0].matching
    assert report([run.folder], tmp_path / "one.html").read_text(encoding="utf-8").startswith("<!")


def test_what_does_not_fit_is_told(log, tmp_path):
    with pytest.raises(ConfigError, match="no such run folder"):
        open_run(tmp_path / "nothing")
    with pytest.raises(LogError):
        open_log(tmp_path / "nothing.mcap")
    with pytest.raises(ConfigError, match="--timeout-ms"):
        replay(ReplayRequest(LogRequest(log), "lidar3d", timeout_ms=-1.0, out=tmp_path / "x"))
    with pytest.raises(ConfigError, match="--config"):
        ScoreRequest([tmp_path], config="fbench.toml")
    with pytest.raises(ConfigError, match="--intervals"):
        Resampling(3)
    assert not (tmp_path / "x").exists()


def test_importing_the_api_loads_nothing_heavy():
    code = "import sys, fbench.api; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numba", "torch", "cv2", "sklearn", "pandas", "onnxruntime"} & set(loaded)


@pytest.mark.slow
def test_the_notebook_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for cell in json.loads(NOTEBOOK.read_text())["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec("".join(cell["source"]), names)  # noqa: S102
    assert (tmp_path / "runs" / "late3d" / "scores.json").exists()


def test_truth_that_cannot_be_read_costs_no_replay(log, tmp_path):
    (tmp_path / "labels.csv").write_text("frame,x,y,z,length,width,height,yaw\n0,1,2,three,4,2,1.5,0\n")
    request = LogRequest(log, truth=BoxSource(tmp_path / "labels.csv"))
    frames: list[int] = []
    with pytest.raises(LogError, match=r"labels\.csv row 1: z is 'three'"):
        replay(ReplayRequest(request, "lidar3d", out=tmp_path / "run"), frames.append)
    assert frames == []
    assert not (tmp_path / "run").exists()
