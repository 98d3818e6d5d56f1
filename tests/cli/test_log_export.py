"""`fbench log export`, as a user calls it."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.cli.conftest import messages, truths, write_log

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth


def test_truth_of_a_log(fbench, log):
    result = fbench("log", "export", log, "--format", "kitti-tracking", "-o", "labels")
    assert result.code == 0
    assert result.out.splitlines() == [
        "car: 6 rows in 6 frames, 2D boxes in camera, 3D boxes in camera", "kitti-tracking: labels"
    ]  # fmt: skip
    rows = [row.split() for row in Path("labels/car.txt").read_text().splitlines()]
    assert [row[:5] for row in rows] == [[str(i), "3", "Car", "-1", "-1"] for i in range(6)]
    assert [float(row[15]) for row in rows] == [12.0 + i for i in range(6)]


def test_results_of_a_run(fbench, log):
    assert fbench("replay", log, "-p", "lidar3d", "--set", "lidar.judge=rules", "-o", "run").code == 0
    without = fbench("log", "export", "run", "--format", "kitti", "-o", "results")
    assert without.code == 3
    assert without.err == "fbench: run: boxes without a class; say which they are of with --class, such as Car\n"
    result = fbench("log", "export", "run", "--format", "kitti", "-o", "results", "--class", "Car", "--json")
    assert result.code == 0
    (sequence,) = result.json()["sequences"]
    assert (sequence["name"], sequence["frames"]) == ("car", 6)
    assert sequence["rows"] == sum(len(file.read_text().splitlines()) for file in Path("results").iterdir()) > 0
    assert fbench("log", "export", "run", "--format", "mot", "-o", "mot").code == 0
    assert list(Path("mot").iterdir()) == [Path("mot/car.txt")]
    assert fbench("log", "export", "run", "--format", "mot", "--boxes", "truth", "-o", "gt").code == 0
    assert sorted(path.name for path in Path("gt/car").iterdir()) == ["gt", "seqinfo.ini"]


def test_an_export_is_scored_like_the_logs_own_truth(fbench, log):
    assert fbench("replay", log, "-p", "lidar3d", "-o", "own").code == 0
    assert fbench("log", "export", log, "--format", "kitti-tracking", "-o", "labels").code == 0
    bare = write_log(Path("bare.mcap"), messages())
    assert fbench("replay", bare, "-p", "lidar3d", "-o", "filed", "--truth", "labels/car.txt").code == 0
    scores = [json.loads(Path(run, "scores.json").read_text()) for run in ("own", "filed")]
    values = [
        {(s["metric"], s["class"]): s["value"] for s in rows if s["matching"] == rows[0]["matching"]} for rows in scores
    ]
    assert values[0].keys() == values[1].keys() != set()
    for key, value in values[0].items():
        assert values[1][key] == pytest.approx(value, abs=1e-5)


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (("car.mcap", "--format", "kiti"), 2, "--format kiti: isn't known; did you mean 'kitti'?"),
        (("car.mcap", "--format", "kitti", "--boxes", "truht"), 2, "--boxes truht: isn't known; did you mean 'truth'?"),
        (("car.mcap", "--format", "kitti", "--boxes", "tracks"), 2, "car.mcap: is a log, which has no tracks; take"),
        (("car.mcap", "--format", "kitti", "--boxes", "detections"), 3, "car.mcap: which topic holds the results?"),
        (("car.mcap", "--format", "nuscenes"), 2, "out: this format is one file"),
        (("no.mcap", "--format", "kitti"), 2, "no.mcap: no such run folder or log"),
        (("empty", "--format", "kitti"), 3, "empty: no log (a folder without log.json and without .mcap, .db3"),
        (("text.txt", "--format", "kitti"), 3, "text.txt: "),
    ],
)
def test_what_cannot_be_exported(fbench, log, args, code, message):
    Path("empty").mkdir()
    Path("text.txt").write_text("nothing")
    result = fbench("log", "export", *args, "-o", "out")
    assert (result.code, result.out) == (code, "")
    assert result.err.startswith(f"fbench: {message}")
    assert not Path("out").exists()


def test_a_folder_that_is_neither_says_so(fbench):
    Path("empty").mkdir()
    assert "and no run folder, which has a manifest.json" in fbench(
        "log", "export", "empty", "--format", "mot", "-o", "out"
    ).err  # fmt: skip


def test_a_damaged_run(fbench, log):
    assert fbench("replay", log, "-p", "lidar3d", "-o", "run").code == 0
    Path("run/tracks.parquet").write_bytes(b"PAR1 no longer")
    result = fbench("log", "export", "run", "--format", "mot", "-o", "out")
    assert result.code == 3
    assert result.err.startswith("fbench: run/tracks.parquet: can't be read")
    Path("run/manifest.json").write_text("{")
    assert fbench("log", "export", "run", "--format", "mot", "-o", "out").err.startswith("fbench: run/manifest.json: ")


def test_a_log_of_which_a_part_is_lost(fbench, log):
    data = bytearray(log.read_bytes())
    log.write_bytes(data[: len(data) * 3 // 4])
    result = fbench("log", "export", log, "--format", "kitti", "-o", "out")
    assert result.code in (3, 4)
    assert len(result.err.splitlines()) <= 1


def test_several_logs(fbench, log):
    box = Boxes3D(
        np.array([[9.0, 0, 0]]), np.ones((1, 3)), np.zeros(1), label=np.array(["van"]), track_id=np.array([1])
    )
    other = write_log(Path("van.mcap"), [Truth(10, 10, box, None, 0)])
    result = fbench("log", "export", log, other, "--format", "kitti-tracking", "-o", "out", "--json")
    assert [s["name"] for s in result.json()["sequences"]] == ["car", "van"]
    assert sorted(path.name for path in Path("out").iterdir()) == ["car.txt", "van.txt"]
    assert len(list(truths())) == len(Path("out/car.txt").read_text().splitlines())
