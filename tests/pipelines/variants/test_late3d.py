from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from tests.pipelines.frames import CAMERA, JPEG, MOUNTS, assert_equal, cloud, fields, frame, image, rig, scan

from fbench.pipelines.sensors.camera.detector import CameraParams
from fbench.pipelines.variants.late import Late3D, Late3DParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.frames import Fault
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo, Rig

LOG = LogInfo("drive", "id")


@pytest.fixture
def pipeline(one_car: Path) -> Late3D:
    pipeline = Late3D(Late3DParams(camera=CameraParams(weights=one_car)))
    pipeline.start(rig("cam", "lidar", "radar"), LOG)
    return pipeline


def test_three_sensors_see_one_car(pipeline: Late3D):
    output = pipeline.step(frame(0, image(), cloud(), scan()))
    cars = output.detections[output.detections.label == "car"]  # the camera also sees a pedestrian
    assert cars.center_m == pytest.approx(np.array([[22.1, 0, -0.8]]), abs=0.15)
    assert cars.sources.tolist() == [7]
    assert cars.velocity_mps[0, 0] == pytest.approx(3.0, abs=0.1)
    assert output.tracks.label.tolist() == output.detections.label.tolist()
    stages = ["decode", "preprocess", "detect.camera", "calibrate", "detect.lidar", "detect.radar", "fuse", "track"]
    assert list(output.stage_ns) == stages
    assert output.faults == ()


@pytest.mark.parametrize(
    "present", [c for num in range(4) for c in combinations(("cam", "lidar", "radar"), num)], ids="-".join
)
def test_any_subset_of_messages(pipeline: Late3D, present: tuple[str, ...]):
    full = pipeline.step(frame(0, image(), cloud(), scan()))
    pipeline.reset("again")
    messages = {"cam": image(), "lidar": cloud(), "radar": scan()}
    output = pipeline.step(frame(0, *(messages[name] for name in present)))
    assert fields(output.detections) == fields(full.detections)
    assert fields(output.tracks) == fields(full.tracks)
    assert output.faults == ()
    if set(present) & {"cam", "radar"}:
        bits = {"cam": 1, "lidar": 2, "radar": 4}
        cars = output.detections[output.detections.label == "car"]
        assert cars.sources.tolist() == [sum(bits[name] for name in present)]
        assert cars.center_m[0, :2] == pytest.approx([22, 0], abs=0.6)


def test_without_weights_lidar_and_radar_go_on():
    pipeline = Late3D()
    pipeline.start(rig("cam", "lidar", "radar"), LOG)
    output = pipeline.step(frame(0, image(), cloud(), scan()))
    assert output.detections.sources.tolist() == [6]
    assert output.detections.label.tolist() == ["car"]
    assert output.missing == {"cam": "no weights"}


def test_a_corrupt_image_counts_as_missing(pipeline: Late3D):
    output = pipeline.step(frame(0, image(JPEG[:100]), cloud(), scan()))
    assert output.detections.sources.tolist() == [6]
    assert output.faults == (Fault("DEC002", "cam at stamp 0"),)


def test_the_ground_is_remembered_until_reset(pipeline: Late3D):
    pipeline.step(frame(0, image(), cloud(), scan()))
    remembered = pipeline.step(frame(1, image(), scan())).detections.center_m[0, 2]
    nothing = PointCloud("lidar", 0, 0, np.zeros((0, 3), np.float32))
    empty = pipeline.step(frame(2, image(), scan(), nothing)).detections.center_m[0, 2]
    pipeline.reset("again")
    forgotten = pipeline.step(frame(3, image(), scan())).detections.center_m[0, 2]
    assert remembered == pytest.approx(-0.8, abs=0.05)
    assert empty == remembered
    assert forgotten != remembered


def test_order_of_points_changes_nothing(pipeline: Late3D):
    first = pipeline.step(frame(0, image(), cloud(), scan()))
    pipeline.reset("again")
    random = np.random.default_rng(1)
    assert_equal(first.detections, pipeline.step(frame(0, image(), cloud(random), scan(random))).detections)


@pytest.mark.parametrize("names", [("lidar",), ("radar",), ("cam", "radar"), ("lidar", "radar")])
def test_rigs_with_some_sensors(one_car: Path, names: tuple[str, ...]):
    pipeline = Late3D(Late3DParams(camera=CameraParams(weights=one_car)))
    pipeline.start(rig(*names), LOG)
    messages = {"cam": image(), "lidar": cloud(), "radar": scan()}
    pipeline.step(frame(0, *(messages[name] for name in names)))


def test_a_rig_of_cameras_only_is_refused():
    with pytest.raises(LogError, match=r"log 'drive': late3d needs a LiDAR or a radar; the log has: camera cam$"):
        Late3D().start(rig("cam"), LOG)


def distorted() -> Rig:
    return Rig(MOUNTS, {"cam": replace(CAMERA, distortion_model="omni", distortion=np.full(5, 0.1))})


def uncalibrated() -> Rig:
    return Rig(MOUNTS, {})


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (
            distorted,
            r"^camera 'cam': distortion model 'omni' isn't supported, only plumb_bob, .*fisheye; rectify the images$",
        ),
        (uncalibrated, r"camera 'cam' has no intrinsics"),
    ],
)
def test_cameras_that_cannot_be_projected_into_are_refused_at_the_start_where_they_are_used(
    one_car: Path, make: Callable[[], Rig], match: str
):
    with pytest.raises(LogError, match=match):
        Late3D(Late3DParams(camera=CameraParams(weights=one_car))).start(make(), LOG)
    pipeline = Late3D()
    pipeline.start(make(), LOG)
    assert len(pipeline.step(frame(0, image(), cloud(), scan())).detections) == 1


def test_weights_that_are_not_there():
    with pytest.raises(ConfigError, match=r"nowhere\.onnx"):
        Late3D(Late3DParams(camera=CameraParams(weights=Path("nowhere.onnx"))))
