import numpy as np
import pytest
from tests.pipelines.frames import assert_equal, fields, frame, rig, scan

from fbench.pipelines.sensors.radar.doppler import PERIOD_KEY, DopplerParams
from fbench.pipelines.sensors.radar.stage import RadarParams
from fbench.pipelines.variants.radar import Radar3D, Radar3DParams
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import RadarScan
from fbench.replay.data.rig import LogInfo

LOG = LogInfo("drive", "id")


@pytest.fixture
def pipeline() -> Radar3D:
    pipeline = Radar3D()
    pipeline.start(rig("radar"), LOG)
    return pipeline


def test_a_moving_car_is_detected_with_its_velocity_over_ground(pipeline: Radar3D):
    output = pipeline.step(frame(0, scan()))
    assert output.detections.center_m[0, :2] == pytest.approx([21.7, 0.0], abs=0.4)
    assert output.detections.velocity_mps[0] == pytest.approx([3.0, 0, 0], abs=0.1)
    assert output.detections.sources.tolist() == [4]
    assert output.detections.label is None
    assert len(output.tracks) == 1
    assert list(output.stage_ns) == ["calibrate", "preprocess", "detect.radar", "track"]


def test_frames_without_radar_or_without_echoes_have_the_same_fields(pipeline: Radar3D):
    full = pipeline.step(frame(0, scan()))
    missing = pipeline.step(frame(1))
    empty = pipeline.step(frame(2, RadarScan("radar", 0, 0, np.zeros((0, 3), np.float32))))
    for output in (missing, empty):
        assert len(output.detections) == 0
        assert fields(output.detections) == fields(full.detections)
        assert fields(output.tracks) == fields(full.tracks)


@pytest.mark.parametrize("num", [1, 50])
def test_echoes_in_one_place(pipeline: Radar3D, num: int):
    message = RadarScan("radar", 0, 0, np.full((num, 3), 5, np.float32), np.full(num, 2, np.float32))
    assert len(pipeline.step(frame(0, message)).detections) == 0


def test_order_of_echoes_changes_nothing(pipeline: Radar3D):
    first = pipeline.step(frame(0, scan()))
    pipeline.reset("again")
    second = pipeline.step(frame(0, scan(np.random.default_rng(1))))
    assert_equal(first.detections, second.detections)


def test_a_rig_without_radar_is_refused():
    with pytest.raises(LogError, match=r"log 'drive': radar3d needs a radar; the log has: lidar lidar$"):
        Radar3D().start(rig("lidar"), LOG)


def test_period_of_the_log_is_used_unless_given():
    def speed(metadata, *, given=None):
        pipeline = Radar3D(Radar3DParams(radar=RadarParams(doppler=DopplerParams(period_mps=given))))
        pipeline.start(rig("radar"), LogInfo("drive", "id", metadata))
        detections = pipeline.step(frame(0, scan())).detections
        assert isinstance(detections, Boxes3D)
        assert detections.velocity_mps is not None
        return detections.velocity_mps[0, 0]

    assert speed({}) == pytest.approx(3.0, abs=0.1)
    assert speed({PERIOD_KEY: "4.0"}) == pytest.approx(-1.0, abs=0.1)
    assert speed({"radar.radar.velocity_period_mps": "4.0"}) == pytest.approx(-1.0, abs=0.1)
    assert speed({PERIOD_KEY: "4.0"}, given=0.0) == pytest.approx(3.0, abs=0.1)
