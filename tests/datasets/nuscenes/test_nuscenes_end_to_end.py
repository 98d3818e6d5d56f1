"""The whole way: import by the command, replay through pipelines, scores."""

from pathlib import Path

import pytest
from tests.program import fbench
from tests.recordings import PIPELINES, require_runs_or_says_why

from fbench.replay.runs.folder import Run

pytestmark = pytest.mark.slow
CAMERAS = ["CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT", "CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"]
LEAST_F1 = {"camera2d": 0.6, "early3d": 0.25, "late3d": 0.7, "lidar3d": 0.2}
"""Vehicles of one keyframe: 0.667, 0.38, 0.727 and 0.235 when this was written."""


@pytest.fixture(scope="module")
def log(real_tables, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("end") / "keyframe.mcap"
    assert fbench("log", "import", "nuscenes", real_tables.root, "-o", out) == 0
    return out


def replayed(log: Path, shared: Path, pipeline: str) -> Run:
    weights = f"{shared}/weights/deimv2_femto/deimv2_hgnetv2_femto_coco.onnx"
    camera = ["--set", f"camera.weights={weights}", "--set", "camera.min_score=0.4"]
    out = log.parent / pipeline
    assert fbench("replay", log, "-p", pipeline, *(camera if pipeline != "lidar3d" else []), "-o", out) == 0
    return Run(out)


@pytest.mark.parametrize("pipeline", LEAST_F1)
def test_pipelines_find_vehicles(log, shared, pipeline: str) -> None:
    run = replayed(log, shared, pipeline)
    first = run.scores[0]
    assert (first.metric, first.class_) == ("f1", "vehicle")
    assert first.value >= LEAST_F1[pipeline]
    (frame,) = run.frames
    assert not frame.missing
    assert frame.frame_number == 0
    if pipeline == "camera2d":
        seen = set(run.detections.boxes.camera.tolist())
        assert seen == {"CAM_BACK", "CAM_BACK_RIGHT", "CAM_FRONT", "CAM_FRONT_RIGHT"}


def test_all_six_cameras_take_part(log, shared, capsys) -> None:
    assert fbench("log", "info", log) == 0
    told = capsys.readouterr().out
    assert all(name in told for name in CAMERAS)


@pytest.mark.parametrize("pipeline", PIPELINES)
def test_each_pipeline_runs_or_says_what_is_missing(log, shared, capsys, tmp_path, pipeline: str) -> None:
    own = tmp_path / "log.mcap"
    own.symlink_to(log)
    require_runs_or_says_why(own, pipeline, {"camera", "lidar"}, 1, shared, capsys)
