"""The thesis's configurations: each is there, and runs on a drive through the city."""

from pathlib import Path

import pytest
from tests.city_log import SMALL_RIG
from tests.kept_cities import kept

from fbench.api.replays import replay
from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.rig import CameraSpec, RigSpec
from fbench.datasets.city.spec import CitySpec
from fbench.datasets.importing.run import write_recording
from fbench.replay.contracts.plugins import make_pipeline, pipeline_parameters
from fbench.replay.contracts.variants import find_variants
from fbench.replay.logs.convert.target import Target
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

SENSORS = {
    "camera2d": "camera", "lidar2d": "lidar", "radar2d": "radar", "lidar3d": "lidar", "radar3d": "radar",
    "early2d": "camera,lidar,radar", "early3d": "camera,lidar,radar", "early3d-stereo": "camera,lidar,radar,stereo",
    "late2d": "camera,lidar,radar", "late2d-stereo": "camera,lidar,radar,stereo", "late3d": "camera,lidar,radar",
}  # fmt: skip


def test_all_configurations_are_there():
    assert {variant.name for variant, _ in find_variants()} == {f"thesis/{name}" for name in SENSORS}


@pytest.mark.parametrize("name", SENSORS)
def test_what_each_uses(name):
    parameters = pipeline_parameters(f"thesis/{name}", [])
    assert ",".join(parameters["uses"]) == SENSORS[name]
    early = name.startswith("early") or name in ("lidar2d", "radar2d")
    assert parameters["strategy"] == ("early" if early else "late")
    assert (parameters["tracking.association"], parameters["tracking.noise"]) == ("iou", "identity")
    assert make_pipeline(f"thesis/{name}", [])[1] == parameters


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Half a second with all sensors, the cameras small."""
    path: Path = tmp_path_factory.mktemp("city") / "drive.mcap"
    left, right = (CameraSpec(translation_m=(2.0, y, 1.0), size_wh=(320, 240)) for y in (0.2, -0.2))
    cameras = {"stereo_left": left, "stereo_right": right}
    rig = RigSpec(cameras=cameras, lidars=SMALL_RIG.lidars, radars=SMALL_RIG.radars, pose_rate_hz=10.0)
    spec = CitySpec("urban", seconds=0.5, rig=rig)
    write_recording(CityRecording(spec, "drive", cities=kept()), Target(path), lambda *_: None)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", SENSORS)
def test_each_runs_on_the_city(name, drive, tmp_path):
    run = replay(ReplayRequest(LogRequest(drive), f"thesis/{name}", out=tmp_path / "run", no_media=True)).run
    assert run.manifest.complete
    assert run.manifest.variant.name == f"thesis/{name}"
    assert run.manifest.num_frames >= 4
    assert run.scores
