from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from tests.pipelines.frames import JPEG, assert_equal, cloud, fields, frame, image, rig, scan

from fbench.pipelines.sensors.camera.detector import CameraParams
from fbench.pipelines.variants.early import Early3D, Early3DParams
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.frames import Fault
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo

LOG = LogInfo("drive", "id")


@pytest.fixture
def pipeline(one_car: Path) -> Early3D:
    pipeline = Early3D(Early3DParams(camera=CameraParams(weights=one_car)))
    pipeline.start(rig("cam", "lidar", "radar"), LOG)
    return pipeline


def test_three_sensors_see_one_car(pipeline: Early3D):
    output = pipeline.step(frame(0, image(), cloud(), scan()))
    assert output.detections.label.tolist() == ["car"]
    assert output.detections.center_m == pytest.approx(np.array([[22.1, 0, -0.8]]), abs=0.1)
    assert output.detections.sources.tolist() == [7]
    assert output.detections.velocity_mps[0, 0] == pytest.approx(3.0, abs=0.1)
    assert output.tracks.label.tolist() == ["car"]
    stages = ["decode", "preprocess", "detect.camera", "calibrate", "fuse", "track"]
    assert list(output.stage_ns) == stages
    assert output.faults == ()


@pytest.mark.parametrize(
    "present", [c for num in range(4) for c in combinations(("cam", "lidar", "radar"), num)], ids="-".join
)
def test_any_subset_of_messages(pipeline: Early3D, present: tuple[str, ...]):
    full = pipeline.step(frame(0, image(), cloud(), scan()))
    pipeline.reset("again")
    messages = {"cam": image(), "lidar": cloud(), "radar": scan()}
    output = pipeline.step(frame(0, *(messages[name] for name in present)))
    assert fields(output.detections) == fields(full.detections)
    assert fields(output.tracks) == fields(full.tracks)
    assert output.faults == ()
    if not set(present) & {"lidar", "radar"}:
        assert len(output.detections) == 0  # early fusion is about points
    elif set(present) != {"lidar"}:
        bits = {"cam": 1, "lidar": 2, "radar": 4}
        assert output.detections.sources.tolist() == [sum(bits[name] for name in present)]
        assert output.detections.center_m[0, :2] == pytest.approx([22, 0], abs=0.8)


def test_a_sensor_that_is_missing_for_a_second(pipeline: Early3D):
    numbers = []
    for index in range(30):
        messages = [image(), *([] if 10 <= index < 20 else [cloud()]), scan()]
        output = pipeline.step(frame(index, *messages))
        assert len(output.detections) == 1
        numbers += output.tracks.track_id.tolist()
    assert len(set(numbers)) == 1


def test_radar_alone_finds_what_moves():
    pipeline = Early3D()
    pipeline.start(rig("radar"), LOG)
    found = pipeline.step(frame(0, scan())).detections
    assert found.sources.tolist() == [4]
    assert found.label.tolist() == ["car"]
    assert found.center_m[0, :2] == pytest.approx([21.7, 0], abs=0.8)
    assert found.velocity_mps[0, :2] == pytest.approx([3.0, 0.0], abs=0.2)
    still = scan()
    standing = replace(still, radial_velocity_mps=np.zeros(len(still.xyz), np.float32))
    assert len(pipeline.step(frame(1, standing)).detections) == 0


def test_without_weights_the_camera_counts_as_missing():
    pipeline = Early3D()
    pipeline.start(rig("cam", "lidar", "radar"), LOG)
    output = pipeline.step(frame(0, image(), cloud(), scan()))
    assert output.detections.sources.tolist() == [6]
    assert output.missing == {"cam": "no weights"}


def test_a_corrupt_image_counts_as_missing(pipeline: Early3D):
    output = pipeline.step(frame(0, image(JPEG[:100]), cloud(), scan()))
    assert output.detections.sources.tolist() == [6]
    assert output.faults == (Fault("DEC002", "cam at stamp 0"),)


def test_order_of_points_changes_nothing(pipeline: Early3D):
    first = pipeline.step(frame(0, image(), cloud(), scan()))
    pipeline.reset("again")
    random = np.random.default_rng(1)
    assert_equal(first.detections, pipeline.step(frame(0, image(), cloud(random), scan(random))).detections)


def turned(points, angle_rad):
    """The same points of a sensor, turned about its upright axis."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    xyz = points.xyz @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    return replace(points, xyz=xyz.astype(np.float32))


@pytest.mark.parametrize("angle_rad", [0.7, np.pi / 2, -2.0])
def test_a_turn_of_the_world_turns_the_result(angle_rad: float):
    pipeline = Early3D()
    pipeline.start(rig("lidar", "radar"), LOG)
    before = pipeline.step(frame(0, cloud(), scan())).detections
    pipeline.reset("again")
    after = pipeline.step(frame(0, turned(cloud(), angle_rad), turned(scan(), angle_rad))).detections
    assert len(after) == len(before) == 1
    (x, y), z = before.center_m[0, :2], before.center_m[0, 2]
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    assert after.center_m[0] == pytest.approx([x * cos - y * sin, x * sin + y * cos, z], abs=0.3)
    assert after.score == pytest.approx(
        before.score, abs=0.25
    )  # headings of rectangles are tried in steps of 2 degrees


@pytest.mark.parametrize("num", [0, 1, 2000])
def test_empty_clouds_one_point_and_equal_points(pipeline: Early3D, num: int):
    xyz = np.tile(np.array([[20, 0, -0.8]], np.float32), (num, 1))
    points = PointCloud("lidar", 0, 0, xyz)
    echoes = replace(scan(), xyz=xyz, radial_velocity_mps=np.full(num, -3, np.float32), rcs_dbsm=None)
    pipeline.step(frame(0, image(), points, echoes))


def test_a_frame_that_is_not_due_is_predicted():
    pipeline = Early3D(Early3DParams(detect_every=2))
    pipeline.start(rig("lidar", "radar"), LOG)
    outputs = [pipeline.step(frame(index, cloud(), scan())) for index in range(4)]
    assert [
        bool(o.detections.predicted.any()) if o.detections.predicted is not None else False for o in outputs[2:]
    ] == [
        False,
        True,
    ]
    assert list(outputs[3].stage_ns) == ["track"]


@pytest.mark.parametrize("names", [("lidar",), ("radar",), ("cam", "radar"), ("lidar", "radar")])
def test_rigs_with_some_sensors(one_car: Path, names: tuple[str, ...]):
    pipeline = Early3D(Early3DParams(camera=CameraParams(weights=one_car)))
    pipeline.start(rig(*names), LOG)
    messages = {"cam": image(), "lidar": cloud(), "radar": scan()}
    pipeline.step(frame(0, *(messages[name] for name in names)))


def test_a_rig_without_depth_is_refused():
    match = r"^log 'drive': early3d needs a LiDAR, a radar or a stereo pair of cameras; the log has: camera cam$"
    with pytest.raises(LogError, match=match) as error:
        Early3D().start(rig("cam"), LOG)
    assert error.value.code == "CFG001"


def test_stereo_that_is_asked_for_must_be_there():
    with pytest.raises(LogError, match="needs two cameras"):
        Early3D(Early3DParams(stereo_pair="on")).start(rig("cam", "lidar"), LOG)
