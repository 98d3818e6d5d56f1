"""A real drive in fog with stereo, LiDAR and radar points."""

import pytest
from tests.reports.preview.radiate_log import write_radiate

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.logs.open import open_log
from fbench.replay.logs.partial_rig import partial_rig
from fbench.reports.preview.collect import PreviewRequest, collect
from fbench.reports.preview.preview import write_preview


@pytest.fixture
def radiate(shared, tmp_path):
    source = shared / "data" / "radiate_tiny_foggy"
    if not source.is_dir():
        pytest.skip(f"no {source}")
    return write_radiate(source, tmp_path / "radiate.mcap")


@pytest.mark.slow
def test_all_sensors_are_drawn_into_each_other(radiate, tmp_path):
    reader, faults = open_log(radiate, FaultLog()), FaultLog()
    asked = PreviewRequest(num=2, sync=SyncParams(timeout_ns=10**9), excerpt=Excerpt(1, None))
    content = write_preview(collect(reader, partial_rig(reader), asked, faults), tmp_path)
    files = [shown.file for shown in content.pictures]
    for part in ("0-left-lidar", "3-right-radar", "0-left-stereo-3-right", "above", "side"):
        assert any(part in file for file in files), part
    (stereo,) = [v for v in content.verdicts if v.what == "stereo"]
    assert "baseline 0.121 m" in stereo.text
    assert "median relative difference from LiDAR" in stereo.text
    (doppler,) = [v.text for v in content.verdicts if v.what == "doppler"]
    assert doppler.startswith("no radial velocities")
