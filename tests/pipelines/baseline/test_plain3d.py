"""plain3d: what comes of its strategies and sensors, frame by frame. The body's origin of `frames` is 1.6 m up."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.frames import MOUNTS, assert_equal, cloud, fields, frame, image, rig, scan

from fbench.pipelines.baseline.plain3d import Plain3D, Plain3DParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.settings import apply_settings
from fbench.replay.data.boxes import Source
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.data.rig import LogInfo, Rig

INFO = LogInfo("log", "id")
LOW = [f"{kind}.crop.low_m=-1.4" for kind in ("lidar", "radar")]
SETTINGS = [*LOW, "lidar.size.least_extent_m=0.5", "radar.size.least_height_m=0", "size.least_height_m=0"]


def pipeline(*settings, sensors=("lidar", "radar"), uses=None):
    given = [f"uses={uses or ','.join(sensors)}", *SETTINGS, *settings]
    made = Plain3D(apply_settings(Plain3DParams(), given))
    made.start(rig(*sensors), INFO)
    return made


def near(boxes, x, y=0.0):
    return boxes[np.hypot(boxes.center_m[:, 0] - x, boxes.center_m[:, 1] - y) < 1.5]


def test_a_box_of_lidar_is_the_extent_of_what_it_sees():
    """The back of a car at 20 m, 1.8 m wide and from 0.4 to 1.2 m over the ground; nothing is completed, so that its
    longer side is across.
    """
    output = pipeline("oriented=false", sensors=("lidar",)).step(frame(0, cloud()))
    (box,) = output.detections.center_m
    np.testing.assert_allclose(box, [20, 0, -0.8], atol=1e-6)
    np.testing.assert_allclose(output.detections.size_lwh_m, [[0, 1.8, 0.8]], atol=1e-6)
    assert output.detections.yaw_rad.tolist() == [0.0]
    turned = pipeline(sensors=("lidar",)).step(frame(0, cloud())).detections
    np.testing.assert_allclose(turned.center_m, [[20, 0, -0.8]], atol=1e-6)
    np.testing.assert_allclose(turned.size_lwh_m, [[1.8, 0, 0.8]], atol=1e-6)
    assert turned.yaw_rad.tolist() == [pytest.approx(np.pi / 2)]
    assert output.detections.sources.tolist() == [Source.L]
    assert output.detections.label is None


@pytest.mark.parametrize("setting", ["cam.nonsense=1", "cam.min_score=0.3", "radar.crop.low_m=x"])
def test_settings_of_sensors_that_are_not_used_are_refused(setting):
    name = setting.split(".")[0]
    made = Plain3D(replace(apply_settings(Plain3DParams(), ["uses=lidar"]), by_sensor=(setting,)))
    with pytest.raises(ConfigError, match=rf"--set {setting}: '{name}' is a \w+, and the pipeline has no use for it"):
        made.start(rig("lidar", "cam", "radar"), INFO)


def test_late_merges_what_overlaps_and_keeps_the_rest():
    late = pipeline("fusion.min_iou=0.000001", "lidar.size.least_extent_m=0.5").step(frame(0, cloud(), scan()))
    sources = near(late.detections, 20.5).sources.tolist()
    assert sources in ([Source.L, Source.R], [Source.R, Source.L], [Source.L | Source.R])
    assert set(late.detections.sources.tolist()) <= {Source.L, Source.R, Source.L | Source.R}


def test_early_clusters_the_points_of_all():
    made = pipeline("strategy=early", "cluster.eps_m=0.7", "cluster.min_points=8")
    found = near(made.step(frame(0, cloud(), scan())).detections, 21.0)
    assert found.sources.tolist() == [Source.L | Source.R]
    np.testing.assert_allclose(found.size_lwh_m[0, :2], [2.0, 1.8], atol=0.01)


@pytest.mark.parametrize("strategy", ["early", "late"])
def test_cameras_name_what_others_place(one_car, strategy):
    settings = [f"camera.weights={one_car}", f"strategy={strategy}", "fusion.label_share=0.3"]
    made = pipeline(*settings, sensors=("cam", "lidar"), uses="camera,lidar")
    found = made.step(frame(0, cloud(), image())).detections
    assert found.label.tolist() == ["car"]
    assert found.sources.tolist() == [Source.C | Source.L]
    assert len(made.step(frame(1, image())).detections) == 0, "what a camera alone sees has no place"


def test_a_camera_without_weights_is_missing():
    made = pipeline(sensors=("cam", "lidar"), uses="camera,lidar")
    output = made.step(frame(0, cloud(), image()))
    assert output.detections.label.tolist() == ["car"], "vehicles are one class for sensors without classes"
    assert output.missing == {"cam": "no weights"}


@pytest.mark.parametrize("strategy", ["early", "late"])
def test_missing_sensors_and_empty_ones(strategy):
    made = pipeline(f"strategy={strategy}")
    nothing = PointCloud("lidar", 0, 0, np.zeros((0, 3), np.float32))
    silent = RadarScan("radar", 0, 0, np.zeros((0, 3), np.float32), None, None)
    kinds = []
    for index, messages in enumerate([(cloud(), scan()), (cloud(),), (scan(),), (), (nothing, silent)]):
        output = made.step(frame(index, *messages))
        kinds.append(fields(output.detections))
        assert (len(output.detections) > 0) == (index < 3)
    assert all(kind == kinds[0] for kind in kinds)


@pytest.mark.parametrize("strategy", ["early", "late"])
def test_the_order_of_points_changes_nothing(strategy):
    rng = np.random.default_rng(3)
    plain, mixed = (pipeline(f"strategy={strategy}") for _ in range(2))
    for index in range(3):
        a = plain.step(frame(index, cloud(), scan()))
        b = mixed.step(frame(index, cloud(rng), scan(rng)))
        assert_equal(a.detections, b.detections)
        assert_equal(a.tracks, b.tracks)


def test_between_detections_tracks_stand_for_them():
    made = pipeline("detect_every=2", "tracking.min_hits=1")
    first, second = (made.step(frame(index, cloud(), scan())) for index in range(2))
    assert len(first.tracks)
    assert set(second.stage_ns) == {"track"}
    assert second.detections.predicted.all()
    assert_equal(second.detections, second.tracks)


def test_rigs_without_what_is_used():
    with pytest.raises(LogError, match="plain3d needs a LiDAR or a radar; the log has: camera cam"):
        pipeline(sensors=("cam",), uses="camera,lidar,radar")
    with pytest.raises(LogError, match="plain3d needs a LiDAR; the log has: radar radar"):
        pipeline(sensors=("radar",), uses="lidar")
    with pytest.raises(LogError, match="stereo"):
        pipeline(sensors=("lidar",), uses="lidar,stereo")


def test_settings_of_single_sensors(one_car):
    made = pipeline(f"cam.weights={one_car}", sensors=("cam", "lidar"), uses="camera,lidar")
    assert made.step(frame(0, cloud(), image())).missing == {}
    with pytest.raises(ConfigError, match=r"it is common to all LiDARs, set lidar\.crop\.low_m"):
        Plain3D(apply_settings(Plain3DParams(), ["top.crop.low_m=0"])).start(Rig({"top": MOUNTS["lidar"]}, {}), INFO)


@pytest.mark.parametrize(
    ("uses", "message"),
    [
        (("camera",), "a camera alone places nothing in space"),
        ((), "expected one or more of camera, lidar, radar, stereo, each once"),
        (("lidar", "lidar"), "each once, got lidar,lidar"),
    ],
)
def test_uses_that_make_no_sense(uses, message):
    with pytest.raises(ConfigError, match=message):
        Plain3DParams(uses=uses)
    with pytest.raises(ConfigError, match="expected"):
        apply_settings(Plain3DParams(), ["uses=lidra"])


@pytest.mark.parametrize("strategy", ["early", "late"])
def test_clouds_of_one_point_and_of_equal_ones(strategy):
    made = pipeline(f"strategy={strategy}")
    for index, xyz in enumerate((np.ones((1, 3)) * 5, np.ones((1000, 3)) * 5, np.full((3, 3), np.inf))):
        message = PointCloud("lidar", 0, 0, xyz.astype(np.float32))
        assert len(made.step(Frame(index, index, 0, {"lidar": message})).detections) == 0
