import numpy as np
import pytest

from fbench.pipelines.sensors.points.merged import (
    Outline,
    lidar_points,
    radar_scans,
    report_boxes,
    require,
    viewpoint,
    world_T_body,
)
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import PointCloud, Pose, RadarScan
from fbench.replay.data.rig import LogInfo, Mount, Rig

TURNED = np.array([0, 0, 1.0, 0])  # half a turn about z
STRAIGHT = np.array([0, 0, 0, 1.0])
RIG = Rig(
    {
        "front": Mount("lidar", np.array([1.0, 0, 2]), STRAIGHT),
        "back": Mount("lidar", np.array([-3.0, 0, 2]), TURNED),
        "radar": Mount("radar", np.array([0, 1.0, 0]), STRAIGHT),
    },
    {},
)
RANGES = {"front": (2.0, np.inf), "back": (2.0, np.inf)}


def frame(*messages):
    return Frame(0, 0, 0, {m.sensor: m for m in messages})


def cloud(sensor, *xyz):
    return PointCloud(sensor, 0, 0, np.array(xyz, np.float32).reshape(-1, 3))


def test_points_of_all_lidars_in_body_coordinates_sorted():
    merged = lidar_points(RIG, frame(cloud("front", (5, 0, 0), (1, 1, 0)), cloud("back", (4, 1, 0))), RANGES)
    assert merged is not None
    assert merged == pytest.approx(np.array([[-7.0, -1, 2], [6, 0, 2]]))
    assert viewpoint(RIG, "lidar").tolist() == [-1.0, 0.0, 2.0]


def test_sensors_that_did_not_deliver():
    assert lidar_points(RIG, frame(), RANGES) is None
    assert radar_scans(RIG, frame(), {}) is None
    empty = lidar_points(RIG, frame(cloud("front")), RANGES)
    assert empty is not None
    assert empty.shape == (0, 3)


def test_echoes_look_from_the_radar_and_are_sorted():
    xyz = np.array([[3, 4, 0], [0, 0, 0], [2, 0, 0]], np.float32)
    scan = RadarScan("radar", 0, 0, xyz, np.array([1, 2, 3], np.float32), np.array([10, 20, 30], np.float32))
    scans = radar_scans(RIG, frame(scan), {"radar": 10.4})
    assert scans is not None
    assert scans[0].xyz.tolist() == [[0, 1, 0], [2, 1, 0], [3, 5, 0]]
    assert scans[0].direction == pytest.approx(np.array([[0, 0, 0], [1, 0, 0], [0.6, 0.8, 0]]))
    assert scans[0].radial_velocity_mps.tolist() == [2, 3, 1]
    assert scans[0].magnitude_db.tolist() == [20, 30, 10]
    assert scans[0].period_mps == 10.4


def test_radar_that_gives_places_only():
    scans = radar_scans(RIG, frame(RadarScan("radar", 0, 0, np.ones((1, 3), np.float32))), {})
    assert scans is not None
    assert np.isnan(scans[0].radial_velocity_mps).all()
    assert np.isnan(scans[0].magnitude_db).all()
    assert scans[0].period_mps == 0.0


def test_velocities_that_are_no_numbers_are_unknown():
    velocity = np.array([np.inf, -np.inf, np.nan, 2.0], np.float32)
    scans = radar_scans(RIG, frame(RadarScan("radar", 0, 0, np.eye(4, 3, dtype=np.float32), velocity)), {})
    assert scans is not None
    assert min(scans[0].radial_velocity_mps.tolist(), key=np.isnan) == 2.0
    assert np.isnan(scans[0].radial_velocity_mps).sum() == 3


def test_points_on_the_own_vehicle():
    xyz = np.array([[3.9, 0, 0], [4.1, 0, 0], [-2.4, 1.0, 2], [-2.6, 1.0, 2], [1, -1.2, 0], [1, -1.0, 0]])
    assert Outline(4.0, 2.5, 1.1).without(xyz).tolist() == [False, True, False, True, True, False]
    assert Outline(4.0, 2.5, 0.0).without(xyz).all()


def test_pose_of_the_body():
    assert world_T_body(RIG, frame()) is None
    pose = world_T_body(RIG, frame(Pose("gps", 0, 0, np.array([1.0, 2, 3]), STRAIGHT)))
    assert pose is not None
    assert pose[:3, 3].tolist() == [1, 2, 3]


def test_one_source_of_poses_counts():
    odom = Pose("odom", 0, 0, np.array([9.0, 9, 9]), STRAIGHT)
    assert world_T_body(RIG, Frame(0, 0, 0, {"odom": odom}, {"gps": "never came"})) is None
    assert world_T_body(RIG, Frame(0, 0, 0, {"odom": odom}, {"back": "never came"})) is not None


def test_require_names_what_is_there():
    require("lidar3d", ("lidar",), RIG, LogInfo("drive", "id"))
    with pytest.raises(
        LogError, match=r"^log 'drive': x needs a camera; the log has: lidar back, lidar front, radar rad"
    ):
        require("x", ("camera",), RIG, LogInfo("drive", "id"))
    with pytest.raises(LogError, match=r"y needs a LiDAR or a radar; the log has: no sensors$"):
        require("y", ("lidar", "radar"), Rig({}, {}), LogInfo("drive", "id"))


def test_reported_boxes_have_the_same_fields_whether_there_are_any_or_not():
    boxes = Boxes3D(np.arange(9.0).reshape(3, 3), np.ones((3, 3)), np.zeros(3), score=np.array([0.5, 0.0, 0.9]))
    kept = report_boxes(boxes, 0.0, Source.L)
    none = report_boxes(Boxes3D.empty(), 0.0, Source.L)
    assert kept.arrays().keys() == none.arrays().keys()
    assert kept.score is not None
    assert kept.score.tolist() == [0.9, 0.5]
    assert kept.sources is not None
    assert kept.sources.tolist() == [2, 2]
    assert kept.velocity_mps is not None
    assert np.isnan(kept.velocity_mps).all()
