"""The sequence that came with the SDK; figures were found by looking at it, apart from the importer."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fbench.datasets.importing.run import ImportedLog, import_one
from fbench.datasets.radiate import Radiate, RadiateParams
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.protocols import Reader
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import PointCloud, Pose, RadarScan
from fbench.replay.logs.open import open_log

STEP_M = 0.173611
NUM_RADAR, NUM_LIDAR, NUM_IMAGES, NUM_BOXES = 18, 42, 50, 42


@pytest.fixture(scope="module")
def folder(shared: Path) -> Path:
    return shared / "data/radiate_tiny_foggy"


@pytest.fixture(scope="module")
def written(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> ImportedLog:
    return import_one(Radiate(), folder, tmp_path_factory.mktemp("radiate") / "fog.mcap")


@pytest.fixture(scope="module")
def log(written: ImportedLog) -> Reader:
    return open_log(written.path, FaultLog())


def test_all_that_has_a_time_is_there(log: Reader) -> None:
    expected = {"navtech": NUM_RADAR, "velo_lidar": NUM_LIDAR, "zed_left": NUM_IMAGES, "zed_right": NUM_IMAGES}
    assert dict(log.num_messages) == expected
    truths = [truth.boxes3d for truth in log.truths()]
    assert [boxes is not None for boxes in truths] == [True] * NUM_RADAR
    assert sum(len(boxes or ()) for boxes in truths) == NUM_BOXES
    assert {i for boxes in truths if boxes is not None for i in boxes.arrays()["track_id"].tolist()} == {1, 2, 3, 4}


def test_defects_are_told(written: ImportedLog) -> None:
    text = "\n".join(written.lines)
    for line in (
        "left out, without a time in velo_lidar.txt: 18 files (frames 1 to 17, 60)",
        "left out, without a file: 50 times of zed_left.txt (frames 51 to 100)",
        "zed_left: starts 0.68 s after the radar does",
        "gps_imu: 125 of 250 fixes repeat a time, left out",
        "gps_imu: 125 fixes left out, taken over 2 s away from what is imported (they start 64.01 s after the radar",
        "labels: slots for 714 radar frames, there are 18; slot k belongs to frame k + 1",
        "radar: of 42 labeled vehicles 42 (100.0%) have a radar point, 42 (100.0%) three or more",
    ):
        assert line in text


def test_radar_points_lie_on_what_the_cartesian_images_show(folder: Path, log: Reader) -> None:
    scan = next(m for m in log.messages() if isinstance(m, RadarScan))
    image = cv2.imread(str(folder / "Navtech_Cartesian/000001.png"), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    means = {}
    for turn_deg in (0, 2, 90, 180):
        xy = scan.xyz[:, :2].astype(np.float64) @ Rotation.from_euler("z", -turn_deg, degrees=True).as_matrix()[:2, :2]
        for mirrored in (1, -1):
            columns = np.round(575.5 - mirrored * xy[:, 1] / STEP_M).astype(int)
            rows = np.round(575.5 - xy[:, 0] / STEP_M).astype(int)
            means[turn_deg, mirrored] = float(image[rows.clip(0, 1151), columns.clip(0, 1151)].mean())
    best = means.pop((0, 1))
    assert best > 1.2 * max(means.values())
    assert scan.rcs_dbsm is not None
    assert best > 0.85 * float(scan.rcs_dbsm.mean())


def _sdk_projection(folder: Path, xyz: Float64) -> Float64:
    """Pixels (N, 2) without the lens, as the SDK's `project_lidar` computes them from the text of the calibration."""
    from ruamel.yaml import YAML

    calibration = YAML(typ="safe", pure=True).load(folder / "default-calib.yaml")
    lidar, camera = calibration["lidar_calib"], calibration["left_cam_calib"]
    x, y, z = np.radians(np.array(lidar["R"]) - np.array(camera["R"]))
    rx = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    ry = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    rz = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    turn = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]) @ rx @ ry @ rz
    points = xyz @ turn + np.array(lidar["T"]) - np.array(camera["T"])
    u = camera["fx"] * points[:, 0] / points[:, 2] + camera["cx"]
    v = camera["fy"] * points[:, 1] / points[:, 2] + camera["cy"]
    return np.stack([u, v], axis=1)


def test_lidar_points_project_into_the_left_camera_as_with_the_sdk(folder: Path, log: Reader) -> None:
    sweep = next(m for m in log.messages() if isinstance(m, PointCloud))
    ahead = sweep.xyz[sweep.xyz[:, 1] > 2].astype(np.float64)
    camera_T_lidar = np.linalg.inv(log.rig.body_T_sensor("zed_left")) @ log.rig.body_T_sensor("velo_lidar")
    points = ahead @ camera_T_lidar[:3, :3].T + camera_T_lidar[:3, 3]
    pixels = (points / points[:, 2:]) @ log.rig.cameras["zed_left"].K.T
    assert len(points) > 1000
    assert np.abs(pixels[:, :2] - _sdk_projection(folder, ahead)).max() < 1e-3


def _points_in_boxes(log: Reader, offset_ns: int) -> int:
    """LiDAR points above the road in boxes, taking for each radar stamp the sweep nearest to it plus an offset."""
    sweeps = {m.stamp_ns: m.xyz for m in log.messages() if isinstance(m, PointCloud)}
    body_T_lidar, num = log.rig.body_T_sensor("velo_lidar"), 0
    for truth in log.truths():
        wanted = truth.stamp_ns + offset_ns
        stamp = min(sweeps, key=lambda s: abs(s - wanted))
        if truth.boxes3d is None or abs(stamp - wanted) > 100_000_000:
            continue
        xyz = sweeps[stamp].astype(np.float64)
        xyz = xyz[np.hypot(xyz[:, 0], xyz[:, 1]) > 2.5] @ body_T_lidar[:3, :3].T + body_T_lidar[:3, 3]
        for center, size, yaw in zip(
            truth.boxes3d.center_m, truth.boxes3d.size_lwh_m, truth.boxes3d.yaw_rad, strict=True
        ):
            local = (xyz - center) @ Rotation.from_euler("z", yaw).as_matrix()
            num += int((np.abs(local) <= size / 2).all(axis=1).sum())
    return num


def test_lidar_points_are_in_boxes_where_stamps_are_moved_by_300_ms(log: Reader) -> None:
    assert _points_in_boxes(log, -300_000_000) > 500 > 20 * _points_in_boxes(log, 0)


def test_boxes_stand_on_the_road_that_the_lidar_sees(log: Reader) -> None:
    """The radar's height over the road is assumed, not recorded."""
    sweep = next(m for m in log.messages() if isinstance(m, PointCloud))
    body_T_lidar = log.rig.body_T_sensor("velo_lidar")
    xyz = sweep.xyz.astype(np.float64) @ body_T_lidar[:3, :3].T + body_T_lidar[:3, 3]
    distance = np.hypot(xyz[:, 0], xyz[:, 1])
    road = xyz[(distance > 4) & (distance < 12) & (np.abs(xyz[:, 1]) < 2.5) & (xyz[:, 2] < -1.5), 2]
    assert np.median(road) == pytest.approx(-1.8, abs=0.1)


def test_poses_move_where_they_point_to(folder: Path, tmp_path: Path) -> None:
    params = RadiateParams(gps_offset_s=-64.0)
    out = import_one(Radiate(params), folder, tmp_path / "moved.mcap").path
    poses = [m for m in open_log(out, FaultLog()).messages() if isinstance(m, Pose)]
    assert len(poses) > 90
    first, later = poses[30], poses[60]
    step = later.translation_m - first.translation_m
    yaw = Rotation.from_quat(poses[45].rotation_xyzw).as_euler("ZYX")[0]
    assert np.degrees(yaw - np.arctan2(step[1], step[0])) == pytest.approx(0, abs=4)
    assert np.linalg.norm(step) / ((later.stamp_ns - first.stamp_ns) / 1e9) == pytest.approx(10.3, abs=1)
