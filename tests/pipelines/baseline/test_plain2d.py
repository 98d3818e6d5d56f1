"""plain2d: what comes of its strategies and sensors, frame by frame. The body's origin of `frames` is 1.6 m up."""

import numpy as np
import pytest
from tests.pipelines.frames import cloud, frame, image, rig, scan
from tests.pipelines.scenes import car_back

from fbench.pipelines.baseline.plain2d import Plain2D, Plain2DParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.settings import apply_settings
from fbench.replay.data.boxes import Boxes2D, Source
from fbench.replay.data.messages import RadarScan
from fbench.replay.data.rig import LogInfo

INFO = LogInfo("log", "id")
SETTINGS = [f"{kind}.crop.low_m=-1.4" for kind in ("lidar", "radar")] + ["radar.size.least_height_m=0"]


def pipeline(*settings, sensors=("cam", "lidar", "radar"), uses="lidar,radar"):
    made = Plain2D(apply_settings(Plain2DParams(), [f"uses={uses}", *SETTINGS, *settings]))
    made.start(rig(*sensors), INFO)
    return made


def assert_equal(a, b):
    assert isinstance(a, Boxes2D)
    assert {n: v.dtype.kind for n, v in a.arrays().items()} == {n: v.dtype.kind for n, v in b.arrays().items()}
    for name, value in a.arrays().items():
        np.testing.assert_array_equal(value, b.arrays()[name])


@pytest.mark.parametrize("strategy", ["early", "late"])
def test_lidar_outlines_what_it_sees(strategy):
    """The back of a car at 20 m, 1.8 m wide and 0.4 to 1.2 m over the ground; u = 29.5 - 500 y / x."""
    made = pipeline(f"strategy={strategy}", uses="lidar", sensors=("cam", "lidar"))
    found = made.step(frame(0, cloud())).detections
    np.testing.assert_allclose(found.xyxy_px, [[7, 29.5, 52, 49.5]], atol=1e-4)
    np.testing.assert_allclose(found.distance_m, [np.sqrt(20**2 + 0.8**2)], atol=1e-4)
    assert np.isnan(found.range_rate_mps).all()
    assert found.sources.tolist() == [Source.L]
    assert found.label is None
    assert found.camera.tolist() == ["cam"]


def test_radar_measures_speed():
    found = pipeline("strategy=early", uses="radar", sensors=("cam", "radar")).step(frame(0, scan())).detections
    ahead = found[np.abs(found.distance_m - 21) < 1]
    assert len(ahead) == 1
    np.testing.assert_allclose(ahead.range_rate_mps, [3.0 - 8.0], atol=0.5)  # a standing echo is among them


@pytest.mark.parametrize("strategy", ["early", "late"])
def test_a_fused_box_has_what_each_sensor_is_good_at(one_car, strategy):
    made = pipeline(f"camera.weights={one_car}", f"strategy={strategy}", uses="camera,lidar,radar")
    echoes = car_back(20.5, 0.0).astype(np.float32)
    radar = RadarScan("radar", 0, 0, echoes, np.full(len(echoes), -5.0, np.float32), None)
    found = made.step(frame(0, image(), cloud(), radar)).detections
    (row,) = np.flatnonzero(found.sources == (Source.C | Source.L | Source.R))
    np.testing.assert_allclose(found.xyxy_px[row], [9.5, 19.5, 49.5, 59.5])
    assert found.label[row] == "car"
    np.testing.assert_allclose(found.distance_m[row], 20.0, atol=0.1)
    assert found.range_rate_mps[row] == -5.0
    assert found.score[row] == 1.0
    person = found[found.label == "pedestrian"]
    assert person.sources.tolist() == [Source.C]
    assert np.isnan(person.distance_m).all()


def test_cameras_alone(one_car):
    made = pipeline(f"camera.weights={one_car}", uses="camera", sensors=("cam",))
    found = made.step(frame(0, image())).detections
    assert found.label.tolist() == ["car", "pedestrian"]
    assert len(made.step(frame(1)).detections) == 0
    with pytest.raises(ConfigError, match="no detector for this log's cameras"):
        pipeline(uses="camera", sensors=("cam",))


def test_a_camera_without_weights_is_missing_but_shows_points():
    output = pipeline(uses="camera,lidar", sensors=("cam", "lidar")).step(frame(0, image(), cloud()))
    assert output.missing == {"cam": "no weights"}
    assert output.detections.label.tolist() == ["car"]


@pytest.mark.parametrize("strategy", ["early", "late"])
def test_missing_sensors_and_the_order_of_points(strategy):
    rng = np.random.default_rng(4)
    plain, mixed = (pipeline(f"strategy={strategy}") for _ in range(2))
    for index, messages in enumerate([(cloud, scan), (cloud,), (scan,), ()]):
        a, b = (made.step(frame(index, *(m(order) for m in messages))) for made, order in ((plain, None), (mixed, rng)))
        assert (len(a.detections) > 0) == (index < 3)
        assert_equal(a.detections, b.detections)
        assert_equal(a.tracks, b.tracks)


def test_between_detections_tracks_stand_for_them():
    made = pipeline("detect_every=2", "tracking.min_hits=1")
    first, second = (made.step(frame(index, cloud(), scan())) for index in range(2))
    assert len(first.tracks)
    assert set(second.stage_ns) == {"track"}
    assert second.detections.predicted.all()


def test_rigs_without_what_is_used():
    with pytest.raises(LogError, match="plain2d needs a camera; the log has: lidar lidar"):
        pipeline(sensors=("lidar",), uses="lidar")
    with pytest.raises(LogError, match="plain2d needs a LiDAR; the log has: camera cam"):
        pipeline(sensors=("cam",), uses="lidar")
    with pytest.raises(LogError, match="stereo"):
        pipeline(sensors=("cam", "lidar"), uses="lidar,stereo")
