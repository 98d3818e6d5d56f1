from pathlib import Path

import numpy as np
import pytest

from fbench.datasets.astyx import Astyx
from fbench.datasets.importing.run import import_one
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.protocols import Reader
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, Message, PointCloud, RadarScan, Truth
from fbench.replay.logs.open import open_log

HOUR_NS = 3_600_000_000_000


def converted(folder: Path) -> Reader:
    out = folder.parent / "tiny.mcap"
    import_one(Astyx(), folder, out)
    return open_log(out, FaultLog())


def messages(reader: Reader, kind: type[Message]) -> list[Message]:
    return [message for message in reader.messages() if isinstance(message, kind)]


def test_the_first_lidar_point_is_the_stamp_of_all_messages_and_whole_hours_are_added(astyx_folder: Path) -> None:
    reader = converted(astyx_folder)
    stamps = {7: HOUR_NS - 50_000_000, 8: HOUR_NS + 50_000_000, 10: HOUR_NS + 150_000_000}
    found = [(m.frame_number, m.sensor, m.stamp_ns, m.log_ns) for m in reader.messages()]
    sensors = {7: ["camera_front", "lidar_vlp16", "radar_6455"], 10: ["lidar_vlp16"]}
    sensors[8] = sensors[7]
    assert found == [(n, name, stamp, stamp) for n, stamp in stamps.items() for name in sensors[n]]
    assert [(t.frame_number, t.stamp_ns) for t in reader.truths()] == [(7, stamps[7]), (8, stamps[8])]


def test_lidar_points_keep_order_reflectivity_laser_and_time(astyx_folder: Path) -> None:
    cloud = messages(converted(astyx_folder), PointCloud)[0]
    assert isinstance(cloud, PointCloud)
    assert cloud.xyz.tolist() == [[1, 0, 0], [0, 2, 0], [0, 2, 0]]
    assert cloud.intensity is not None
    assert cloud.ring is not None
    assert cloud.offset_ns is not None
    assert cloud.intensity.tolist() == [5, 255, 7]
    assert cloud.ring.tolist() == [0, 15, 3]
    assert cloud.offset_ns.tolist() == [0, 49_999_000, 70_000_000]


def test_radar_velocity_is_positive_when_receding(astyx_folder: Path) -> None:
    scan = messages(converted(astyx_folder), RadarScan)[0]
    assert isinstance(scan, RadarScan)
    assert scan.radial_velocity_mps is not None
    assert scan.rcs_dbsm is not None
    assert scan.xyz.tolist() == [[10, 1, 0.5], [20, -3, 0], [5, 0, 0]]
    assert scan.radial_velocity_mps.tolist() == [-2.5, 1, 0]
    assert not np.signbit(scan.radial_velocity_mps[2])
    assert scan.rcs_dbsm.tolist() == [46.5, 50, 40]


def test_images_are_copied_byte_by_byte(astyx_folder: Path) -> None:
    image = messages(converted(astyx_folder), Image)[1]
    assert isinstance(image, Image)
    assert image.data == (astyx_folder / "camera_front/000008.jpg").read_bytes()
    assert (image.encoding, image.size_wh) == ("jpeg", (6, 4))


def test_mounts_and_camera(astyx_folder: Path) -> None:
    rig = converted(astyx_folder).rig
    assert {name: mount.kind for name, mount in rig.mounts.items()} == {
        "camera_front": "camera", "lidar_vlp16": "lidar", "radar_6455": "radar",
    }  # fmt: skip
    point = rig.body_T_sensor("lidar_vlp16") @ [1, 0, 0, 1]  # turned left by 90 deg, moved by (1, 2, 3)
    np.testing.assert_allclose(point, [1, 3, 3, 1], atol=1e-12)
    np.testing.assert_allclose(rig.mounts["lidar_vlp16"].rotation_xyzw, [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-12)
    np.testing.assert_allclose(rig.mounts["camera_front"].rotation_xyzw, [-0.5, 0.5, -0.5, 0.5], atol=1e-12)
    np.testing.assert_allclose(rig.mounts["camera_front"].translation_m, [0.1, 0.2, 0.3])
    assert rig.cameras["camera_front"].K.tolist() == [[100, 0, 3], [0, 110, 2], [0, 0, 1]]
    assert rig.cameras["camera_front"].size_wh == (6, 4)


def test_boxes(astyx_folder: Path) -> None:
    boxes = truth_boxes(next(iter(converted(astyx_folder).truths())))
    assert boxes.roll_rad is not None
    assert boxes.pitch_rad is not None
    assert boxes.label is not None
    assert boxes.source_label is not None
    assert boxes.occlusion is not None
    np.testing.assert_allclose(boxes.yaw_rad, [np.pi / 2, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(boxes.pitch_rad, [0, 0.2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(boxes.roll_rad, [0, 0, 0.1, 0], atol=1e-12)
    assert boxes.center_m.tolist() == [[10, 2, 0.5]] * 4
    assert boxes.size_lwh_m.tolist() == [[4, 1.8, 1.5]] * 4
    assert boxes.label.tolist() == ["car", "pedestrian", "trailer", "other"]
    assert boxes.source_label.tolist() == ["Car", "Person", "Towed Object", "Tram"]
    assert boxes.occlusion.tolist() == [2, 0, 0, 0]
    assert boxes.track_id is None
    assert boxes.score is None


def test_a_truth_file_without_objects_is_an_empty_truth(astyx_folder: Path) -> None:
    _, second = converted(astyx_folder).truths()
    assert len(truth_boxes(second)) == 0


def truth_boxes(truth: Truth) -> Boxes3D:
    assert truth.boxes3d is not None
    return truth.boxes3d


def test_metadata_say_what_the_numbers_mean(astyx_folder: Path) -> None:
    info = converted(astyx_folder).info
    assert info.name == "tiny"
    assert info.log_id.startswith("astyx-")
    metadata = dict(info.metadata)
    assert "first LiDAR point" in metadata.pop("stamps")
    assert metadata == {
        "dataset": "Astyx HiRes2019", "licence": "CC BY-NC-SA 4.0", "frames": "3", "reference": "lidar_vlp16",
        "radar.velocity_period_mps": "10.3936", "radar.rcs_dbsm": "uncalibrated magnitude [dB]",
    }  # fmt: skip


def test_summary_says_what_was_found(astyx_folder: Path) -> None:
    (astyx_folder / "camera_front/000012.jpg").write_bytes(b"")
    assert list(import_one(Astyx(), astyx_folder, astyx_folder.parent / "x.mcap").lines) == [
        "frames: 3 in 1 stretch (parted by gaps of over 2 s), spaced by 0.10 to 0.10 s",
        "stretch: frames 7 to 10 (3), 0.2 s",
        "missing files: camera_front 1, radar_6455 1, groundtruth_obj3d 1",
        "left out, without LiDAR points and so without time: frames 12",
        "boxes: 4 (Car 1, Person 1, Towed Object 1, Tram 1), without track ids",
        "unlabeled frames: 1",
        "classes that the set's specification lacks, taken as 'other': Tram",
        "time ran backwards before frames 8: whole hours were added",
        "stamps: all messages of a frame have the LiDAR's, the set records no time for camera, radar and boxes",
        "radar: velocities are ambiguous, they alias with a period of 10.3936 m/s",
        "radar: rcs holds an uncalibrated magnitude [dB]",
    ]


def test_a_gap_of_over_two_seconds_parts_stretches(astyx_folder: Path) -> None:
    path = astyx_folder / "lidar_vlp16/000010.txt"
    path.write_text(path.read_text().replace(" 150000", " 2050001"))
    lines = import_one(Astyx(), astyx_folder, astyx_folder.parent / "x.mcap").lines
    assert lines[:3] == [
        "frames: 3 in 2 stretches (parted by gaps of over 2 s), spaced by 0.10 to 0.10 s",
        "stretch: frames 7 to 8 (2), 0.1 s",
        "stretch: frames 10 to 10 (1), 0.0 s",
    ]


def test_a_frame_without_lidar_is_left_out(astyx_folder: Path) -> None:
    (astyx_folder / "lidar_vlp16/000007.txt").unlink()
    (astyx_folder / "lidar_vlp16/000008.txt").write_text("X Y Z Reflectivity LaserID Timestamp \n")
    reader = converted(astyx_folder)
    assert [(m.frame_number, m.sensor) for m in reader.messages()] == [(10, "lidar_vlp16")]
    assert list(reader.truths()) == []


def test_sensors_without_any_file_are_not_in_the_rig(astyx_folder: Path) -> None:
    for folder in ("camera_front", "radar_6455"):
        for path in (astyx_folder / folder).iterdir():
            path.unlink()
        (astyx_folder / folder).rmdir()
    rig = converted(astyx_folder).rig
    assert list(rig.mounts) == ["lidar_vlp16"]
    assert not rig.cameras


@pytest.mark.parametrize("path", ["camera_front/000008.jpg", "groundtruth_obj3d/000007.json"])
def test_the_log_id_depends_on_files_not_on_names(astyx_folder: Path, path: str) -> None:
    before = converted(astyx_folder).info.log_id
    moved = astyx_folder.rename(astyx_folder.parent / "elsewhere")
    assert converted(moved).info.log_id == before
    (moved / path).unlink()
    assert converted(moved).info.log_id != before


def test_the_same_folder_gives_the_same_bytes(astyx_folder: Path) -> None:
    outs = [astyx_folder.parent / name / "log.mcap" for name in ("a", "b")]
    for out in outs:
        out.parent.mkdir()
        import_one(Astyx(), astyx_folder, out)
    assert outs[0].read_bytes() == outs[1].read_bytes()
