"""What comes out of a raw drive."""

from datetime import UTC, datetime

import numpy as np
import pytest

from fbench.datasets.kitti import Kitti, raw
from fbench.datasets.kitti.sensors import KittiParams
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.importing import FrameRange, ImportRequest
from fbench.replay.contracts.testing import check_importer
from fbench.replay.data.messages import Image, PointCloud, Pose
from fbench.replay.geometry.camera import project

BODY_T_CAMERA = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float)
NAME = "2011_09_26_drive_0001_sync"


def lines_of(path):
    pairs = (line.split(":", 1) for line in path.read_text().splitlines())
    return {key: np.array(text.split(), float) for key, text in pairs if key != "calib_time"}


def rigid(R, t):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.reshape(R, (3, 3)), t
    return matrix


def rectified(cameras):
    return rigid(cameras["R_rect_00"], 0)


def test_drives_are_found_from_any_folder(drive):
    assert (
        [*raw.find_drives(drive.root)] == [*raw.find_drives(drive.date)] == [*raw.find_drives(drive.folder)] == [NAME]
    )
    (drive.root / "2011_09_28" / "2011_09_28_drive_0016_extract").mkdir(parents=True)
    (drive.date / "2011_09_26_drive_0001_notes").mkdir()
    assert [*raw.find_drives(drive.root)] == [NAME, "2011_09_28_drive_0016_extract"]


def test_no_drive_is_found_elsewhere(tmp_path):
    assert [*raw.find_drives(tmp_path)] == []
    assert [*raw.find_drives(tmp_path / "none")] == []


@pytest.mark.parametrize("attribute", ["root", "date", "folder"])
def test_the_log_is_the_same_from_any_folder(drive, attribute):
    first = drive.imported().path.read_bytes()
    assert drive.imported(getattr(drive, attribute)).path.read_bytes() == first


def test_messages_have_the_stamps_of_their_sensors(drive):
    found = drive.imported()
    assert [(type(m), m.sensor, m.frame_number) for m in found.messages[:5]] == [
        (PointCloud, "velodyne", 0), (Image, "image_02", 0), (Image, "image_00", 0), (Pose, "oxts", 0),
        (PointCloud, "velodyne", 1),
    ]  # fmt: skip
    second = int(datetime(2011, 9, 26, 13, 2, 25, tzinfo=UTC).timestamp())
    assert [m.stamp_ns for m in found.of("velodyne")] == [second * 10**9 + 951199337 + i * 10**8 for i in range(3)]
    assert all(m.stamp_ns == m.log_ns for m in found.messages)
    assert [m.log_ns for m in found.messages] == sorted(m.log_ns for m in found.messages)


def test_files_come_out_as_they_went_in(drive):
    found = drive.imported()
    assert [m.data for m in found.of("image_02")] == [drive.file("image_02", i).read_bytes() for i in range(3)]
    assert {(m.encoding, m.size_wh) for m in found.of("image_00")} == {("png", (6, 4))}
    cloud = found.of("velodyne")[1]
    assert cloud.xyz.tolist() == [[11, 1, -1.5], [20.125, -3, 0]]
    assert cloud.intensity.tolist() == [0.25, 0.5]
    assert cloud.offset_ns is None


def test_rig_projects_as_the_calibration_files_say(drive):
    """P_rect R_rect [R | T] of the raw data's readme, computed plainly."""
    rig = drive.imported().log.rig
    cameras, velo = lines_of(drive.date / "calib_cam_to_cam.txt"), lines_of(drive.date / "calib_velo_to_cam.txt")
    xyz = np.array([[10.0, 1, -1.5], [20, -3, 0], [6, 0.5, 1]])
    homogeneous = np.column_stack([xyz, np.ones(3)])
    for name, key in (("image_00", "P_rect_00"), ("image_02", "P_rect_02")):
        P = cameras[key].reshape(3, 4)
        uvw = P @ rectified(cameras) @ rigid(velo["R"], velo["T"]) @ homogeneous.T
        camera_T_velo = np.linalg.inv(rig.body_T_sensor(name)) @ rig.body_T_sensor("velodyne")
        pixels, _ = project(rig.cameras[name], (camera_T_velo @ homogeneous.T)[:3].T)
        np.testing.assert_allclose(pixels, (uvw[:2] / uvw[2]).T, atol=1e-5)


def test_body_is_the_rectified_camera_0(drive):
    mount = drive.imported().log.rig.body_T_sensor("image_00")
    np.testing.assert_allclose(mount, BODY_T_CAMERA, atol=1e-12)


def test_poses_are_those_of_the_body(drive):
    """The chain of pykitti: the IMU's pose, then calib_imu_to_velo, calib_velo_to_cam and R_rect_00."""
    found = drive.imported()
    rows = [[float(text) for text in drive.file("oxts", i).read_text().split()] for i in range(3)]
    imu, velo = lines_of(drive.date / "calib_imu_to_velo.txt"), lines_of(drive.date / "calib_velo_to_cam.txt")
    cameras = lines_of(drive.date / "calib_cam_to_cam.txt")
    camera0_T_imu = rectified(cameras) @ rigid(velo["R"], velo["T"]) @ rigid(imu["R"], imu["T"])
    scale = np.cos(np.deg2rad(rows[0][0]))
    for row, pose in zip(rows, found.of("oxts"), strict=True):
        roll, pitch, yaw = row[3:6]
        cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
        R = (
            np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
            @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
            @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        )
        east = scale * 6378137 * np.deg2rad(row[1] - rows[0][1])
        expected = rigid(R, [east, 0, 0]) @ np.linalg.inv(BODY_T_CAMERA @ camera0_T_imu)
        np.testing.assert_allclose(pose.world_T_body, expected, atol=2e-6)  # R of the files has 7 digits
    assert found.of("oxts")[1].frame_number == 1


def test_metadata_say_where_and_when(drive):
    metadata = drive.imported().log.info.metadata
    expected = {
        "dataset": "KITTI raw", "date": "2011_09_26", "drive": "0001", "reference": "velodyne", "frames": "3",
        "images": "rectified", "world.origin_lat_deg": "49.015000000000", "world.origin_lon_deg": "8.434000000000",
        "world.origin_alt_m": "116.40000000", "calibrated": "09-Jan-2012 13:57:47",
    }  # fmt: skip
    assert {key: metadata[key] for key in expected} == expected
    assert "UTC" in metadata["stamps"]


def test_a_range_of_frames_has_the_same_world(drive):
    whole, part = drive.imported().messages, drive.imported(frames=FrameRange(1, 2))
    assert {m.frame_number for m in part.messages} == {1}
    assert len(part.messages) == 4
    pose = next(m for m in whole if isinstance(m, Pose) and m.frame_number == 1)
    np.testing.assert_array_equal(part.of("oxts")[0].translation_m, pose.translation_m)


def test_lost_sweeps_are_told(drive):
    """2011_09_26_drive_0009 has empty lines instead of the stamps of four sweeps."""
    drive.file("velodyne_points", 1).unlink()
    path = drive.stamps("velodyne_points")
    first, _, third = path.read_text().splitlines()
    path.write_text(f"{first}\n\n{third}\n\n\n")
    found = drive.imported()
    assert [m.frame_number for m in found.of("velodyne")] == [0, 2]
    assert found.of("velodyne")[1].stamp_ns % 10**9 == 151199337
    assert "velodyne: no file of frames 1" in found.lines
    assert len(found.of("image_00")) == 3


def test_a_drive_without_lidar_has_frames_of_the_left_color_camera(drive):
    for path in sorted((drive.folder / "velodyne_points").rglob("*.bin")):
        path.unlink()
    found = drive.imported()
    assert found.log.info.metadata["reference"] == "image_02"
    assert sorted(found.log.rig.mounts) == ["image_00", "image_02"]
    assert any("no files of image_01, image_03, velodyne" in line for line in found.lines)
    assert len(found.of("oxts")) == 3


def test_no_poses_without_the_calibration_of_the_imu(drive):
    (drive.date / "calib_imu_to_velo.txt").unlink()
    found = drive.imported()
    assert found.of("oxts") == []
    assert "no poses: calib_imu_to_velo.txt missing" in found.lines
    assert "world.origin_lat_deg" not in found.log.info.metadata


def test_stamps_that_run_backwards_are_sorted_and_told(drive):
    path = drive.stamps("oxts")
    first, second, third = path.read_text().splitlines()
    path.write_text(f"{first}\n{third}\n{second}\n")
    found = drive.imported()
    assert [m.frame_number for m in found.of("oxts")] == [0, 2, 1]
    assert any(line.startswith("oxts: stamps run backwards") for line in found.lines)


def test_other_files_are_told(drive):
    (drive.folder / "image_00" / "data" / "notes.txt").write_text("x")
    assert "image_00: 1 other files left out, such as notes.txt" in drive.imported().lines


def test_equal_folders_give_equal_ids_and_other_calibration_another_one(drive):
    first = drive.imported().log.info.log_id
    assert drive.imported().log.info.log_id == first
    path = drive.date / "calib_velo_to_cam.txt"
    path.write_text(path.read_text().replace("-4.069766e-03", "-4.069767e-03"))
    assert drive.imported().log.info.log_id != first


def test_results_of_others_are_refused(drive, tmp_path):
    with pytest.raises(ConfigError, match="raw drives"):
        raw.recording(NAME, drive.root, ImportRequest((NAME,)), KittiParams(detections=tmp_path))


def test_an_extract_keeps_its_lenses(extract):
    found = extract.imported()
    camera = found.log.rig.cameras["image_02"]
    assert (camera.size_wh, camera.distortion_model) == ((8, 6), "plumb_bob")
    assert camera.distortion.tolist() == [-0.35, 0.15, 0.0005, 0.0001, -0.05]
    assert camera.K.tolist() == [[9.6, 0, 4.1], [0, 9.5, 2.9], [0, 0, 1]]
    assert found.log.info.metadata["images"] == "as recorded, distorted"
    assert {m.frame_number for m in found.messages} == {None}


def test_an_extract_has_cameras_where_they_are(extract):
    """x_02 = R_02 x_00 + T_02 for points of camera 0 as recorded, as the readme of the raw data says."""
    found = extract.imported()
    cameras, velo = lines_of(extract.date / "calib_cam_to_cam.txt"), lines_of(extract.date / "calib_velo_to_cam.txt")
    expected = rigid(cameras["R_02"], cameras["T_02"]) @ rigid(velo["R"], velo["T"])
    rig = found.log.rig
    camera_T_velo = np.linalg.inv(rig.body_T_sensor("image_02")) @ rig.body_T_sensor("velodyne")
    np.testing.assert_allclose(camera_T_velo, expected, atol=1e-6)
    body_T_camera = BODY_T_CAMERA @ rectified(cameras)
    np.testing.assert_allclose(rig.body_T_sensor("image_00"), body_T_camera, atol=1e-6)


def test_points_of_an_extract_are_text(extract):
    cloud = extract.imported().of("velodyne")[1]
    assert cloud.xyz.tolist() == [[11, 1, -1.5], [20.125, -3, 0]]
    assert cloud.intensity.tolist() == [0.25, 0.5]
    extract.file("velodyne_points", 1).write_text("")
    assert len(extract.imported().of("velodyne")[1].xyz) == 0


def test_a_range_of_an_extract_is_one_of_time(extract):
    """Sensors count for themselves: here the IMU is three times as fast."""
    rows = [f"2011-09-26 13:02:{25 + 0.95 + i / 30:012.9f}" for i in range(9)]
    extract.stamps("oxts").write_text("\n".join(rows))
    for i in range(3, 9):
        path = extract.folder / "oxts" / "data" / f"{i:010d}.txt"
        path.write_bytes(extract.file("oxts", 0).read_bytes())
    found = extract.imported(frames=FrameRange(1, 2))
    assert len(found.of("velodyne")) == 1
    assert len(found.of("image_00")) == 1
    start_ns = found.of("velodyne")[0].stamp_ns
    assert len(found.of("oxts")) == 3
    assert all(start_ns <= m.stamp_ns < start_ns + 10**8 for m in found.messages)


def test_boxes_of_an_extract_have_no_frames(extract, make_tracklet):
    extract.write_tracklets(make_tracklet([extract.pose.format(10, 1, -1.5, 0, 2, 0, 0)]))
    found = extract.imported()
    assert found.truths == []
    assert any("counts the frames of the synchronized drive" in line for line in found.lines)


def test_the_importer_keeps_what_its_protocol_promises(drive):
    check_importer(Kitti, drive.root)
