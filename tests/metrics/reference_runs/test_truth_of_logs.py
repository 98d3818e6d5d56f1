"""Results in files against the truth of logs."""

from pathlib import Path

import numpy as np
import pytest
from tests.metrics.reference_runs.kitti_drive import write_results, write_truth
from tests.metrics.reference_runs.test_runs_of_nuscenes import drive, made_run
from tests.replay.formats.exports import exported, stamp, sweeps, write_log

from fbench.metrics.files.sequences import open_files, open_source
from fbench.replay.contracts.errors import ConfigError, LogError, MetricError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth


def imported(program, tmp_path: Path, out: Path) -> Path:
    write_truth(tmp_path / "set", 7)
    out.parent.mkdir(exist_ok=True)
    assert program("log", "import", "kitti", tmp_path / "set", "-o", out) == 0
    return out


@pytest.mark.parametrize("name", ["0000.mcap", "0000.parquet"])
def test_a_log_of_kitti_is_as_its_labels(name, program, tmp_path, scored):
    log = imported(program, tmp_path, tmp_path / "logs" / name)
    labels = tmp_path / "set/label_02/0000.txt"
    write_results(labels, tmp_path / "results", 8, None)
    results = ("--detections", tmp_path / "results", "--profile", "trackeval-kitti")
    expected = scored("--truth", labels.parent, *results)
    assert scored("--truth", log, *results) == expected
    assert scored("--truth", log.parent, *results) == expected


@pytest.mark.parametrize(("profile", "form"), [("nuscenes-detection", "nuscenes"), ("nuscenes-tracking",) * 2])
def test_a_log_of_nuscenes_tells_samples_and_poses(profile, form, tmp_path, scored):
    run = made_run(tmp_path, *drive())
    exported(form, tmp_path / "results.json", run.folder)
    own = scored(run.folder, "--profile", profile)
    of_log = scored(
        "--truth", tmp_path / "scene-1.mcap", "--detections", tmp_path / "results.json", "--profile", profile
    )
    assert list(own) == list(of_log)
    for key, (value, _) in of_log.items():
        assert own[key][0] == (None if value is None else pytest.approx(value, abs=2e-5)), key


@pytest.mark.parametrize(("profile", "name"), [("av2", "regular_vehicle"), ("waymo", "vehicle")])
def test_truth_without_points_does_not_count(profile, name, tmp_path, scored):
    """Three boxes a frame: without points, with points of the LiDAR, and of the radar alone. All are found."""
    made = Boxes3D(
        np.array([[10.0, 0, 0], [20, 0, 0], [30, 0, 0]]), np.tile([4.0, 2.0, 1.5], (3, 1)), np.zeros(3),
        label=np.full(3, "car"), source_label=np.full(3, "REGULAR_VEHICLE" if profile == "av2" else "vehicle"),
        num_lidar_pts=np.array([0, 9, -1]), num_radar_pts=np.array([-1, -1, 1]),
    )  # fmt: skip
    truths = [Truth(stamp(i), stamp(i), made, None) for i in range(3)]
    log = write_log(tmp_path / "points.mcap", [*sweeps(3), *truths])
    rows = ["stamp_ns,x,y,z,length,width,height,yaw,label,score"]
    rows += [f"{stamp(i)},{x},0,0,4,2,1.5,0,{name},{x / 100}" for i in range(3) for x in (10, 20, 30)]
    (tmp_path / "found.csv").write_text("\n".join(rows))
    found = scored("--truth", log, "--detections", tmp_path / "found.csv", "--profile", profile)
    assert {n["tp"] for key, (_, n) in found.items() if key[:2] == ("ap", name) and key[3] == "all"} == {6}
    assert {n["fp"] for key, (_, n) in found.items() if key[:2] == ("ap", name) and key[3] == "all"} == {3}


def test_what_isnt_truth(program, tmp_path):
    log = imported(program, tmp_path, tmp_path / "0000.mcap")
    with pytest.raises(ConfigError, match="a log; score the results in it by fbench replay"):
        open_files(tmp_path / "set/label_02", log)
    (tmp_path / "dataroot/v1.0-mini").mkdir(parents=True)
    with pytest.raises(ConfigError, match="first fbench log import nuscenes"):
        open_source(tmp_path / "dataroot", None, is_truth=True)
    with pytest.raises(ConfigError, match="first fbench log import nuscenes"):
        open_source(tmp_path / "set", "nuscenes-tables", is_truth=True)
    with pytest.raises(LogError, match="no log of fbench"):
        open_source(tmp_path / "set/label_02", "log", is_truth=True)


def test_logs_without_truth(program, tmp_path):
    made_run(tmp_path, [], drive()[1])
    with pytest.raises(MetricError, match="no truth, so there is nothing to score") as told:
        open_source(tmp_path / "scene-1.mcap", None, is_truth=True)
    assert told.value.code == "GT001"
    log = imported(program, tmp_path, tmp_path / "0000.mcap")
    assert open_source(log.parent, None, is_truth=True).names == ("0000",)


def test_results_that_belong_to_another_log(tmp_path):
    made = made_run(tmp_path, *drive())
    exported("nuscenes", tmp_path / "results.json", made.folder)
    text = (tmp_path / "results.json").read_text().replace("token05", "another")
    (tmp_path / "results.json").write_text(text)
    with pytest.raises(LogError, match=r"sample 'another' isn't in .*scene-1\.mcap"):
        open_files(tmp_path / "scene-1.mcap", tmp_path / "results.json")
