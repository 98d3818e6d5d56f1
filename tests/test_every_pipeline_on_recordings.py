"""Every pipeline on frames of others: Astyx, RADIATE, KITTI, and a log that another tool wrote. Skips without them."""

import shutil
from pathlib import Path

import pytest
from tests.program import fbench
from tests.recordings import PIPELINES, require_runs_or_says_why

pytestmark = pytest.mark.slow
RECORDINGS = {
    "astyx": (("log", "import", "astyx", "astyx", "--frames", "57:60"), {"camera", "lidar", "radar"}, 3),
    "radiate": (("log", "import", "radiate", "radiate_tiny_foggy"), {"camera", "lidar", "radar", "stereo"}, 6),
    "kitti": (("log", "import", "kitti", "kitti_object"), {"camera", "lidar"}, 3),
    "foreign": ((), {"camera", "lidar"}, 4),
}
"""How each is imported, the kinds of its sensors, and how many frames are replayed: tracks are kept and lost in six."""


CASES = [
    (name, pipeline)
    for name in RECORDINGS
    for pipeline in PIPELINES
    if name == "radiate" or not pipeline.startswith("thesis/")
]
"""The thesis's variants, which are settings of two pipelines, run on the recording that has all kinds of sensors."""


@pytest.fixture(scope="module")
def recording(request: pytest.FixtureRequest, shared: Path, tmp_path_factory: pytest.TempPathFactory):
    command, sensors, num_frames = RECORDINGS[request.param]
    log = tmp_path_factory.mktemp(request.param) / "log.mcap"
    if command:
        assert fbench(*command[:3], shared / "data" / command[3], *command[4:], "-o", log) == 0
    else:
        shutil.copy(shared / "data/mcap/kitti_raw_12frames_ros2.mcap", log)
    return log, sensors, num_frames


@pytest.mark.parametrize(("recording", "pipeline"), CASES, indirect=["recording"])
def test_each_runs_or_says_what_is_missing(recording, pipeline: str, shared: Path, capsys) -> None:
    log, sensors, num_frames = recording
    require_runs_or_says_why(log, pipeline, sensors, num_frames, shared, capsys)


def test_detections_of_others_are_tracked(shared: Path, tmp_path: Path) -> None:
    data, log = shared / "data/kitti_tracking", tmp_path / "cars.mcap"
    assert (
        fbench(
            "log", "import", "kitti", data, "--scenes", "0012", "--detections", data / "pointrcnn_car_val", "-o", log
        )
        == 0
    )
    assert fbench("replay", log, "-p", "track", "-o", tmp_path / "run") == 0
