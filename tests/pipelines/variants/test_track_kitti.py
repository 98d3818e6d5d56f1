"""The tracker on real detections: cars of KITTI as PointRCNN found them."""

import json

import pytest
from tests.program import fbench


@pytest.mark.slow
def test_two_validation_sequences(shared, tmp_path):
    """All eleven give sAMOTA 94.51, MOTA 87.98 and no switch of identity; these two are the quick ones of them."""
    root = shared / "data/kitti_tracking"
    if not (root / "pointrcnn_car_val").is_dir():
        pytest.skip(f"{root}: no KITTI tracking data")
    runs = []
    for sequence in ("0006", "0018"):
        log, run = tmp_path / f"{sequence}.mcap", tmp_path / f"run-{sequence}"
        chosen = ("--scenes", sequence, "--detections", root / "pointrcnn_car_val")
        assert fbench("log", "import", "kitti", root, "-o", log, *chosen) == 0
        assert fbench("replay", log, "-p", "track", "-o", run) == 0
        runs.append(run)
    scores = tmp_path / "scores.json"
    assert fbench("score", *runs, "--profile", "kitti-3dmot", "--class", "car", "-o", scores) == 0
    rows = json.loads(scores.read_text())
    values = {row["metric"]: row["value"] for row in rows if row["slice"] == "all"}
    assert values["ids"] == 0
    assert values["mota"] > 0.90
    assert values["samota"] > 0.95


def test_detections_of_a_file_are_tracked(shared, tmp_path, capsys):
    root = shared / "data/kitti_tracking"
    if not (root / "pointrcnn_car_val").is_dir():
        pytest.skip(f"{root}: no KITTI tracking data")
    log, run, file = tmp_path / "0012.mcap", tmp_path / "run", root / "pointrcnn_car_val/0012.txt"
    assert fbench("log", "import", "kitti", root, "-o", log, "--scenes", "0012") == 0
    assert fbench("replay", log, "-p", "track", "--detections", file, "-o", run) == 0
    assert json.loads((run / "manifest.json").read_text())["pipeline"] == "track"
    capsys.readouterr()
    assert fbench("replay", log, "-p", "lidar3d", "--detections", file, "-o", tmp_path / "other") == 2
    assert "--detections are results already, so --pipeline lidar3d can't be used with them" in capsys.readouterr().err
