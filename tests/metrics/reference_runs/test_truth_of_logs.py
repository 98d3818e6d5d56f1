"""Results in files against the truth of logs."""

from pathlib import Path

import pytest
from tests.metrics.reference_runs.kitti_drive import write_results, write_truth
from tests.metrics.reference_runs.test_runs_of_nuscenes import drive, made_run
from tests.replay.formats.exports import exported

from fbench.metrics.files.sequences import open_files, open_source
from fbench.replay.contracts.errors import ConfigError, LogError, MetricError


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
