"""The thesis's LiDAR and a camera of the simulated city fit each other, and a turned one doesn't."""

from dataclasses import replace
from pathlib import Path

import pytest
from scipy.spatial.transform import Rotation
from tests.kept_cities import kept

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.rig import CameraSpec, RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec
from fbench.datasets.importing.run import write_recording
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.rig import Mount, Rig
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.open import open_log
from fbench.replay.logs.partial_rig import partial_rig
from fbench.reports.preview.alignment import align
from fbench.reports.preview.collect import PreviewRequest, collect
from fbench.reports.preview.sample import Sample

pytestmark = pytest.mark.slow  # test_alignment.py checks the same on drawn scenes


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> list[Sample]:
    """Three frames."""
    path: Path = tmp_path_factory.mktemp("preview") / "city.mcap"
    camera = CameraSpec(translation_m=(2.0, 0.0, 1.0), rate_hz=5.0, size_wh=(400, 300))
    rig = RigSpec(cameras={"camera": camera}, lidars=thesis_rig().lidars)
    write_recording(CityRecording(CitySpec(seconds=0.6, rig=rig), "city", cities=kept()), Target(path), lambda *_: None)
    reader = open_log(path, FaultLog())
    return list(collect(reader, partial_rig(reader), PreviewRequest(num=3), FaultLog()).samples)


def turned(sample: Sample, yaw_deg: float) -> Sample:
    mounts, rotation = sample.rig.mounts, Rotation.from_euler("z", yaw_deg, degrees=True).as_quat()
    lidar = Mount("lidar", mounts["lidar"].translation_m, rotation)
    return replace(sample, rig=Rig({**mounts, "lidar": lidar}, sample.rig.cameras))


def test_exact_calibration_fits(samples: list[Sample]) -> None:
    found = align(samples, "camera")
    assert found.num_edges > 500
    assert not found.is_bad
    assert "fit the image as calibrated" in found.verdict


def test_a_turned_lidar_is_found(samples: list[Sample]) -> None:
    found = align([turned(sample, 3.0) for sample in samples], "camera")
    assert found.is_off
    assert found.turn_deg[1] == pytest.approx(3.0, abs=0.5)
