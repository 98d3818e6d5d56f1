import numpy as np
import pytest
from tests.pipelines.frames import assert_equal, cloud, fields, frame, rig, scan
from tests.pipelines.scenes import car_back, road

from fbench.pipelines.sensors.lidar.classification import CarShapeParams
from fbench.pipelines.sensors.lidar.clusters import LidarParams
from fbench.pipelines.variants.lidar import Lidar3D, Lidar3DParams
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo

LOG = LogInfo("drive", "id")


@pytest.fixture
def pipeline() -> Lidar3D:
    pipeline = Lidar3D()
    pipeline.start(rig("lidar"), LOG)
    return pipeline


def test_a_car_is_detected_and_tracked(pipeline: Lidar3D):
    output = pipeline.step(frame(0, cloud()))
    assert output.detections.center_m == pytest.approx(np.array([[22.1, 0, -0.8]]), abs=0.05)
    assert output.detections.sources.tolist() == [2]
    assert output.detections.label is not None
    assert output.detections.label.tolist() == ["car"]
    assert np.isnan(output.detections.velocity_mps).all()
    assert len(output.tracks) == 1
    assert list(output.stage_ns) == ["calibrate", "preprocess", "detect.lidar", "track"]


def test_frames_without_lidar_or_without_points_have_the_same_fields(pipeline: Lidar3D):
    full = pipeline.step(frame(0, cloud()))
    missing = pipeline.step(frame(1))
    empty = pipeline.step(frame(2, PointCloud("lidar", 0, 0, np.zeros((0, 3), np.float32))))
    for output in (missing, empty):
        assert len(output.detections) == 0
        assert fields(output.detections) == fields(full.detections)
        assert fields(output.tracks) == fields(full.tracks)
    assert missing.tracks.predicted.all()


@pytest.mark.parametrize("num", [1, 50])
def test_points_in_one_place(pipeline: Lidar3D, num: int):
    output = pipeline.step(frame(0, PointCloud("lidar", 0, 0, np.full((num, 3), 5, np.float32))))
    assert len(output.detections) == 0


def test_order_of_points_changes_nothing(pipeline: Lidar3D):
    first = pipeline.step(frame(0, cloud()))
    pipeline.reset("again")
    second = pipeline.step(frame(0, cloud(np.random.default_rng(1))))
    assert_equal(first.detections, second.detections)


@pytest.mark.parametrize(
    ("shape", "num", "advice"),
    [
        (CarShapeParams(bottom_m=(0.0, 0.01)), 20, "20 of 20 car-sized clusters of at least 30 points were rejected"),
        (CarShapeParams(bottom_m=(0.0, 0.01)), 19, None),  # too few to say anything
        (CarShapeParams(), 20, None),
    ],
)
def test_a_judge_that_rejects_nearly_all_cars_is_flagged(shape: CarShapeParams, num: int, advice: str | None):
    pipeline = Lidar3D(Lidar3DParams(lidar=LidarParams(judge="rules", shape=shape)))
    pipeline.start(rig("lidar"), LOG)
    side = car_back(-4.0, 22.0, width_m=4.0)[:, [1, 0, 2]]  # 4 m long, on the right of the vehicle
    xyz = np.concatenate([road(), car_back(20.0, -4.9), side]).astype(np.float32)
    for index in range(num):
        pipeline.step(frame(index, PointCloud("lidar", 0, 0, xyz)))
        pipeline.reset("segments don't matter")
        if index == 10:
            pipeline.start(rig("lidar"), LOG)  # nor changes of the rig
    found = [(fault.code, fault.where) for fault in pipeline.warnings()]
    whole = f"lidar: {advice}; if they are vehicles, try --set lidar.judge=model"
    assert found == ([] if advice is None else [("PRD005", whole)])


def test_parameters_reach_their_stage():
    pipeline = Lidar3D(Lidar3DParams(lidar=LidarParams(min_range_m=30.0)))
    pipeline.start(rig("lidar"), LOG)
    assert len(pipeline.step(frame(0, cloud())).detections) == 0


def test_the_own_vehicle_is_no_obstacle():
    """Its front, seen from a LiDAR on the roof: farther than the least range."""
    xyz = np.concatenate([road(), car_back(3.5, 0.0)]).astype(np.float32)
    message = frame(0, PointCloud("lidar", 0, 0, xyz))
    found = []
    for params in (LidarParams(), LidarParams(ego_side_m=0.0)):
        pipeline = Lidar3D(Lidar3DParams(lidar=params))
        pipeline.start(rig("lidar"), LOG)
        found.append(len(pipeline.step(message).detections))
    assert found == [0, 1]


def test_a_rig_without_lidar_is_refused():
    with pytest.raises(LogError, match=r"log 'drive': lidar3d needs a LiDAR; the log has: radar radar$"):
        Lidar3D().start(rig("radar"), LOG)


def test_other_sensors_are_left_alone(pipeline: Lidar3D):
    alone = pipeline.step(frame(0, cloud()))
    pipeline.reset("again")
    assert_equal(alone.detections, pipeline.step(frame(0, cloud(), scan())).detections)
