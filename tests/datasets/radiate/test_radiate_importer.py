from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fbench.datasets.importing.run import import_one
from fbench.datasets.radiate import Radiate
from fbench.datasets.radiate.radar import DEFAULTS, RadiateParams
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportRequest
from fbench.replay.contracts.protocols import Reader
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.logs.open import open_log

SECOND = 1_574_859_771_000_000_000
STEP_M = 0.173611


def imported(folder: Path, params: RadiateParams = DEFAULTS, asked: ImportRequest | None = None) -> Reader:
    out = folder.parent / "out.mcap"
    import_one(Radiate(params), folder, out, asked)
    return open_log(out, FaultLog())


def summary(folder: Path, params: RadiateParams = DEFAULTS) -> str:
    return "\n".join(import_one(Radiate(params), folder, folder.parent / "out.mcap").lines)


def messages(log: Reader) -> dict[str, list[Message]]:
    found: dict[str, list[Message]] = {}
    for message in log.messages():
        assert isinstance(message, Message)
        found.setdefault(message.sensor, []).append(message)
    return found


def test_every_sensor_has_its_own_stamps(sequence: Path) -> None:
    stamps = {name: [m.stamp_ns - SECOND for m in found] for name, found in messages(imported(sequence)).items()}
    assert stamps == {
        "navtech": [500_000_000, 750_000_000, 1_000_000_007],  # nanoseconds are written without leading zeros
        "velo_lidar": [480_000_000, 580_000_000],
        "zed_left": [490_000_000, 560_000_000],
        "zed_right": [490_000_000, 560_000_000],
        "gps_imu": [3, 500_000_003],
    }


def test_messages_have_no_frame_numbers_so_that_all_join_by_stamp(sequence: Path) -> None:
    log = imported(sequence)
    assert all(m.frame_number is None for found in messages(log).values() for m in found)
    assert all(truth.frame_number is None for truth in log.truths())


def test_lidar_points_are_those_of_the_file(sequence: Path) -> None:
    sweep = messages(imported(sequence))["velo_lidar"][0]
    assert isinstance(sweep, PointCloud)
    assert sweep.intensity is not None
    assert sweep.ring is not None
    assert np.array_equal(sweep.xyz, np.array([[1.5, 10, -1.25], [-2, 20.125, 0.1]], np.float32))
    assert sweep.intensity.tolist() == [7, 255]
    assert sweep.ring.tolist() == [31, 0]


def test_images_are_as_recorded(sequence: Path) -> None:
    image = messages(imported(sequence))["zed_right"][1]
    assert isinstance(image, Image)
    assert (image.data, image.encoding) == ((sequence / "zed_right/000002.png").read_bytes(), "png")


def test_radar_targets_have_range_azimuth_and_no_doppler(sequence: Path) -> None:
    scan = messages(imported(sequence))["navtech"][0]
    assert isinstance(scan, RadarScan)
    assert scan.radial_velocity_mps is None
    assert scan.azimuth_rad is not None
    assert scan.range_m is not None
    assert scan.rcs_dbsm is not None
    azimuth = np.radians(0.45)  # the last of 400 columns ends ahead; left is positive
    assert np.allclose(scan.range_m, [94 * STEP_M])
    assert np.allclose(scan.azimuth_rad, [azimuth])
    assert np.allclose(scan.xyz, [[94 * STEP_M * np.cos(azimuth), 94 * STEP_M * np.sin(azimuth), 0]])
    assert scan.rcs_dbsm.tolist() == [120]


def test_labels_belong_to_the_radar_frame_after_their_index(sequence: Path) -> None:
    truths = list(imported(sequence).truths())
    assert [t.stamp_ns - SECOND for t in truths] == [500_000_000, 750_000_000, 1_000_000_007]
    assert [len(t.boxes3d or ()) for t in truths] == [1, 2, 0]
    assert all(t.boxes3d is not None for t in truths)


def test_boxes_from_above_become_boxes_of_the_body(sequence: Path) -> None:
    boxes = list(imported(sequence).truths())[1].boxes3d
    assert boxes is not None
    columns = boxes.arrays()
    # Middles at (572, 482) and (605, 579) px; the radar is at (576, 576), ahead is up.
    assert np.allclose(boxes.center_m, [[94 * STEP_M, 4 * STEP_M, -1.05], [-3 * STEP_M, -29 * STEP_M, -0.9]])
    assert np.allclose(boxes.size_lwh_m, [[24 * STEP_M, 12 * STEP_M, 1.5], [6 * STEP_M, 10 * STEP_M, 1.8]])
    assert np.allclose(boxes.yaw_rad, [np.pi / 2, -np.pi / 6])
    assert columns["label"].tolist() == ["car", "pedestrian"]
    assert columns["source_label"].tolist() == ["car", "group_of_pedestrians"]
    assert columns["track_id"].tolist() == [7, 9]
    assert columns["ignore"].tolist() == [False, True]
    assert columns["num_radar_pts"].tolist() == [1, 0]


def test_corners_are_those_of_a_box_turned_counter_clockwise_in_the_image(sequence: Path) -> None:
    boxes = list(imported(sequence).truths())[1].boxes3d
    assert boxes is not None
    left, top, width, height = 600.0, 576.0, 10.0, 6.0
    middle = np.array([left + width / 2, top + height / 2])
    square = np.array([[left, top], [left + width, top], [left + width, top + height], [left, top + height]])
    angle = np.radians(-30.0)  # of the label; y is down in images, so that a turn by -angle looks counter-clockwise
    cos, sin = np.cos(-angle), np.sin(-angle)
    pixels = (square - middle) @ np.array([[cos, -sin], [sin, cos]]).T + middle
    expected = np.stack([576 - pixels[:, 1], 576 - pixels[:, 0]], axis=1) * STEP_M
    length, wide = boxes.size_lwh_m[1, :2]
    ahead = np.array([np.cos(boxes.yaw_rad[1]), np.sin(boxes.yaw_rad[1])])
    aside = np.array([-ahead[1], ahead[0]])
    found = [boxes.center_m[1, :2] + a * length * ahead + b * wide * aside for a in (-0.5, 0.5) for b in (-0.5, 0.5)]
    assert all(np.linalg.norm(expected - corner, axis=1).min() < 1e-9 for corner in found)


def _oracle(angles_deg: list[float], offset: list[float], xyz: np.ndarray) -> np.ndarray:
    """Points (N, 3) of a sensor right, forward, up in a camera, as the SDK's description of the calibration has it."""
    x, y, z = np.radians(angles_deg)
    rx = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    ry = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    rz = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    axes = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    return xyz @ (axes @ rx @ ry @ rz) + np.array(offset)


POINTS = np.array([[1.0, 10.0, -1.0], [-3.0, 20.0, 0.5], [0.3, 5.0, 2.0]])


def test_lidar_and_left_camera_are_as_the_calibration_says(sequence: Path) -> None:
    rig = imported(sequence).rig
    camera_T_lidar = np.linalg.inv(rig.body_T_sensor("zed_left")) @ rig.body_T_sensor("velo_lidar")
    expected = _oracle([0.1 - 1.5, -0.2 + 0.5, 0.3 - 0.25], [0.3, -0.05, -0.05], POINTS)
    assert np.allclose(POINTS @ camera_T_lidar[:3, :3].T + camera_T_lidar[:3, 3], expected)


def test_right_camera_is_where_the_stereo_calibration_puts_it(sequence: Path) -> None:
    rig = imported(sequence).rig
    right_T_left = np.linalg.inv(rig.body_T_sensor("zed_right")) @ rig.body_T_sensor("zed_left")
    assert np.allclose(right_T_left[:3], [[0, -1, 0, -0.12], [1, 0, 0, 0.001], [0, 0, 1, 0.002]])


def test_right_camera_can_be_where_its_own_numbers_put_it(sequence: Path) -> None:
    rig = imported(sequence, RadiateParams(right_camera="own")).rig
    camera_T_lidar = np.linalg.inv(rig.body_T_sensor("zed_right")) @ rig.body_T_sensor("velo_lidar")
    expected = _oracle([0.1 - 0.5, -0.2 - 0.5, 0.3], [0.18, -0.05, -0.05], POINTS)
    assert np.allclose(POINTS @ camera_T_lidar[:3, :3].T + camera_T_lidar[:3, 3], expected)


def test_lidar_looks_right_forward_up_and_the_radar_is_the_body(sequence: Path) -> None:
    rig = imported(sequence).rig
    assert np.array_equal(rig.body_T_sensor("navtech"), np.eye(4))
    body_T_lidar = rig.body_T_sensor("velo_lidar")
    assert np.allclose(body_T_lidar[:3, 3], [0.2, -0.6, 0.1])
    assert np.allclose(body_T_lidar[:3, :3], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=0.01)


def test_lenses(sequence: Path) -> None:
    camera = imported(sequence).rig.cameras["zed_left"]
    assert camera.K.tolist() == [[10, 0, 4], [0, 11, 3], [0, 0, 1]]
    assert (camera.size_wh, camera.distortion_model) == ((8, 6), "plumb_bob")
    assert camera.distortion.tolist() == [-0.1, 0.02, 0.001, 0.002, 0]


def test_poses_are_east_north_up_and_point_along_the_course(sequence: Path) -> None:
    first, second = messages(imported(sequence))["gps_imu"]
    assert isinstance(first, Pose)
    assert isinstance(second, Pose)
    assert first.translation_m.tolist() == [0, 0, 0]
    # A meridian's radius of curvature at 55.9 degrees is 6 379 300 m.
    assert np.allclose(second.translation_m, [0, np.radians(1e-5) * 6_379_300, 0], atol=1e-3)
    yaw = Rotation.from_quat(second.rotation_xyzw).as_euler("ZYX")[0]
    assert yaw == pytest.approx(np.arctan2(3, 4))


def test_poses_can_have_the_quaternion_as_it_is(sequence: Path) -> None:
    first, _ = messages(imported(sequence, RadiateParams(heading="imu")))["gps_imu"]
    assert isinstance(first, Pose)
    assert first.rotation_xyzw.tolist() == [0, 0, 0.6, 0.8]


def test_without_a_course_there_is_no_pose(sequence: Path) -> None:
    assert "gps_imu" not in messages(imported(sequence, RadiateParams(min_speed_mps=6)))
    assert "gps_imu: 2 fixes without a heading" in summary(sequence, RadiateParams(min_speed_mps=6))


def test_poses_of_another_time_can_be_moved(sequence: Path) -> None:
    found = messages(imported(sequence, RadiateParams(gps_offset_s=-59.5)))["gps_imu"]
    assert [pose.stamp_ns - SECOND for pose in found] == [500_000_000]


def test_summary_tells_what_is_odd(sequence: Path) -> None:
    text = summary(sequence)
    for line in (
        "messages: navtech 3, velo_lidar 2, zed_left 2, zed_right 2, gps_imu 2",
        "left out, without a file: 1 times of velo_lidar.txt (frame 9)",
        "left out, without a time in velo_lidar.txt: 1 files (frame 1)",
        "gps_imu: 1 of 4 fixes repeat a time, left out",
        "gps_imu: 1 fixes left out, taken over 2 s away from what is imported (they start 0.50 s before",
        "boxes: 3 (car 2, group_of_pedestrians 1), 2 tracks",
        "labels: slots for 5 radar frames, there are 3; slot k belongs to frame k + 1",
        "radar: of 2 labeled vehicles 2 (100.0%) have a radar point, 0 (0.0%) three or more",
    ):
        assert line in text


def test_cameras_that_start_late_are_told(sequence: Path) -> None:
    (sequence / "zed_left.txt").write_text("Frame: 000002 Time: 1574859772.200000000\n")
    assert "zed_left: starts 0.70 s after the radar does" in summary(sequence)
    assert "left out, without a time in zed_left.txt: 1 files (frame 1)" in summary(sequence)


def test_frames_beyond_the_labels_are_not_labeled(sequence: Path) -> None:
    path = sequence / "annotations/annotations.json"
    path.write_text('[{"id": 1, "class_name": "tram", "bboxes": [[], {"position": [1, 2, 3, 4], "rotation": 0}]}]')
    truths = list(imported(sequence).truths())
    assert [len(t.boxes3d or ()) for t in truths] == [0, 1]
    text = summary(sequence)
    assert "unlabeled radar frames: 1, beyond the slots of the labels" in text
    assert "classes that the set lacks, taken as 'other': tram" in text


def test_a_sequence_without_labels(sequence: Path) -> None:
    (sequence / "annotations/annotations.json").unlink()
    assert list(imported(sequence).truths()) == []
    assert "boxes: no labels" in summary(sequence)


def test_a_sequence_with_radar_alone(sequence: Path) -> None:
    for name in ("velo_lidar", "zed_left", "zed_right", "GPS_IMU_Twist"):
        (sequence / name).rename(sequence / f"other_{name}")
        (sequence / f"{name}.txt").unlink()
    log = imported(sequence)
    assert set(log.rig.mounts) == set(messages(log)) == {"navtech"}


def test_frames_choose_radar_frames_and_what_is_around_them(sequence: Path) -> None:
    # The median distance of radar stamps is 250 ms: from 625 ms on, half a period before frame 2.
    found = messages(imported(sequence, asked=ImportRequest(("fog_1_0",), FrameRange(2, 3))))
    assert {name: [m.stamp_ns - SECOND for m in of] for name, of in found.items()} == {"navtech": [750_000_000]}
    found = messages(imported(sequence, asked=ImportRequest(("fog_1_0",), FrameRange(1, 2))))
    assert [m.stamp_ns - SECOND for m in found["velo_lidar"]] == [480_000_000, 580_000_000]
    assert [m.stamp_ns - SECOND for m in found["gps_imu"]] == [500_000_003]


def test_a_folder_of_sequences_has_their_names(sequence: Path) -> None:
    other = sequence.parent / "city_0_0/Navtech_Cartesian"
    other.mkdir(parents=True)
    assert list(Radiate().names(sequence.parent)) == ["city_0_0", "fog_1_0"]
    (sequence / "default-calib.yaml").rename(sequence.parent / "default-calib.yaml")
    log = imported(sequence.parent, asked=ImportRequest(("fog_1_0",)))
    assert log.info.metadata["sequence"] == "fog_1"
    assert len(messages(log)["navtech"]) == 3


def test_calibration_can_be_named_and_its_place_does_not_matter(sequence: Path) -> None:
    first = sequence.parent / "a/calib.yaml"
    first.parent.mkdir()
    (sequence / "default-calib.yaml").rename(first)
    log = imported(sequence, RadiateParams(calibration=first))
    second = sequence.parent / "b/calib.yaml"
    second.parent.mkdir()
    first.rename(second)
    assert imported(sequence, RadiateParams(calibration=second)).info.log_id == log.info.log_id
    second.write_text(second.read_text().replace("fx: 10.0", "fx: 12.0"))
    assert imported(sequence, RadiateParams(calibration=second)).info.log_id != log.info.log_id


def test_metadata(sequence: Path) -> None:
    metadata = imported(sequence).info.metadata
    assert metadata["reference"] == "navtech"
    assert (metadata["dataset"], metadata["licence"]) == ("RADIATE", "CC BY-NC-SA 4.0")
    assert (metadata["weather"], metadata["set"], metadata["sequence"]) == ("fog", "test", "fog_1")
    assert metadata["import.cfar.guard"] == "15"
    assert "assumed" in metadata["truth.height"]


def test_the_same_bytes_again(sequence: Path) -> None:
    outs = [sequence.parent / name for name in ("a.mcap", "b.mcap")]
    for out in outs:
        import_one(Radiate(), sequence, out)
    assert outs[0].read_bytes() == outs[1].read_bytes()


def test_bad_files_can_be_skipped(sequence: Path) -> None:
    (sequence / "Navtech_Polar/000001.png").write_bytes(b"no image")
    (sequence / "velo_lidar/000002.csv").write_text("1,2,3\n")
    (sequence / "GPS_IMU_Twist/000001.txt").write_text("55.9\n")
    bad = BadInput(skip=True)
    log = imported(sequence, asked=ImportRequest(("fog_1_0",), bad=bad))
    assert bad.num == 3
    assert {name: len(found) for name, found in messages(log).items()} == {
        "navtech": 2, "velo_lidar": 1, "zed_left": 2, "zed_right": 2, "gps_imu": 1,
    }  # fmt: skip
    first = next(iter(log.truths()))  # what was labeled is known, whether the scan can be read or not
    assert first.boxes3d is not None
    assert len(first.boxes3d) == 1
    assert first.boxes3d.num_radar_pts is None
