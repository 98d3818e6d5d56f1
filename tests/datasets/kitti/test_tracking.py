"""The tracking benchmark: a tiny folder by hand, and all labels of the training set against a plain reading."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fbench.datasets.importing.run import ImportedLog, import_one
from fbench.datasets.kitti import Kitti
from fbench.replay.check.log_check import CheckOptions, check_log
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import FrameRange, ImportRequest
from fbench.replay.contracts.protocols import Reader
from fbench.replay.data.messages import Image, PointCloud, Pose
from fbench.replay.logs.open import open_log

S = 1_000_000_000


def imported(source: Path, out: Path, name: str, frames: FrameRange | None = None) -> tuple[Reader, ImportedLog]:
    log = import_one(Kitti(), source, out, ImportRequest((name,), frames or FrameRange()))
    return open_log(out, FaultLog()), log


@pytest.fixture
def first(tracking_folder: Path, tmp_path: Path) -> Reader:
    return imported(tracking_folder, tmp_path / "0000.mcap", "0000")[0]


def test_sequences_are_named_by_labels_and_sensors(tracking_folder: Path) -> None:
    (tracking_folder / "image_03/0004").mkdir(parents=True)
    assert Kitti().names(tracking_folder) == ["0000", "0001", "0004"]


def test_training_and_testing_are_told_apart_where_both_are_there(tracking_folder: Path, tmp_path: Path) -> None:
    parent = tmp_path / "parent"
    parent.mkdir()
    tracking_folder.rename(parent / "training")
    assert Kitti().names(parent) == ["0000", "0001"]
    (parent / "testing/image_02/0000").mkdir(parents=True)
    assert Kitti().names(parent) == ["training/0000", "training/0001", "testing/0000"]
    reader, _ = imported(parent, tmp_path / "out.mcap", "training/0001")
    assert len(list(reader.truths())) == 3


def test_stamps_are_made_up_at_10_hz(first: Reader) -> None:
    found = [(m.sensor, m.frame_number, m.stamp_ns, m.log_ns) for m in first.messages()]
    assert [row for row in found if row[0] == "image_02"] == [
        ("image_02", i, (i + 1) * S // 10, (i + 1) * S // 10) for i in range(4)
    ]
    assert [row[1] for row in found if row[0] == "velodyne"] == [0, 2, 3]
    assert "made up" in first.info.metadata["stamps"]


def test_images_and_points_are_those_of_the_files(first: Reader, tracking_folder: Path) -> None:
    messages = list(first.messages())
    images = [m for m in messages if isinstance(m, Image)]
    assert images[1].data == (tracking_folder / "image_02/0000/000001.png").read_bytes()
    cloud = next(m for m in messages if isinstance(m, PointCloud))
    assert cloud.xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert cloud.intensity.tolist() == [0.25, 0.5]
    assert (cloud.ring, cloud.offset_ns) == (None, None)


def test_rig(first: Reader) -> None:
    """The body is camera 0 with x ahead, y left, z up; P2's 42 px are 42/700 m that camera 2 sits to the left."""
    assert {name: mount.kind for name, mount in first.rig.mounts.items()} == {"image_02": "camera", "velodyne": "lidar"}
    np.testing.assert_allclose(first.rig.body_T_sensor("image_02") @ [0, 0, 1, 1], [1, 0.06, 0, 1], atol=1e-12)
    # A point 1 m ahead of the LiDAR, which looks ahead too: 0.3 m behind, 0.1 m right of and 0.2 m above the camera.
    np.testing.assert_allclose(first.rig.body_T_sensor("velodyne") @ [1, 0, 0, 1], [0.7, -0.1, 0.2, 1], atol=1e-12)
    assert first.rig.cameras["image_02"].size_wh == (100, 40)
    assert first.rig.cameras["image_02"].K.tolist() == [[700, 0, 50], [0, 700, 20], [0, 0, 1]]


def test_every_frame_has_truth(first: Reader) -> None:
    truths = list(first.truths())
    assert [(t.frame_number, t.stamp_ns) for t in truths] == [(i, (i + 1) * S // 10) for i in range(4)]
    assert [(len(t.boxes3d), len(t.boxes2d)) for t in truths] == [(2, 3), (0, 0), (1, 1), (0, 0)]


def test_boxes_keep_what_their_rows_say(first: Reader) -> None:
    truth = next(iter(first.truths()))
    solid, flat = truth.boxes3d, truth.boxes2d
    assert solid.center_m.tolist() == [[20, -3, 0.75 - 1.6], [10, 3, 0.875 - 1.6]]
    assert solid.size_lwh_m.tolist() == [[4, 2, 1.5], [0.75, 0.5, 1.75]]
    assert solid.yaw_rad.tolist() == [-0.5 - np.pi / 2, 1.5 - np.pi / 2]
    assert (solid.roll_rad, solid.pitch_rad, solid.attribute) == (None, None, None)
    assert solid.track_id.tolist() == [7, 8]
    assert solid.label.tolist() == ["car", "pedestrian"]
    assert flat.camera.tolist() == ["image_02"] * 3
    assert flat.xyxy_px.tolist() == [[0, 0, 9, 9], [10.5, 5, 60, 30.25], [1, 2, 3, 4]]
    assert flat.source_label.tolist() == ["DontCare", "Car", "Pedestrian"]
    assert flat.label.tolist() == ["other", "car", "pedestrian"]
    assert flat.ignore.tolist() == [True, False, False]
    assert flat.track_id.tolist() == [-1, 7, 8]
    np.testing.assert_array_equal(flat.truncation, [np.nan, 0, 2])
    np.testing.assert_array_equal(flat.occlusion, [np.nan, 1, 3])
    assert flat.attribute.tolist() == ["", "alpha=-1.793451", "alpha=0.1"]


def test_poses_are_those_of_camera_0(first: Reader) -> None:
    """Driving east by 1e-5 degrees a row, at 49 degrees north."""
    poses = [m for m in first.messages() if isinstance(m, Pose)]
    assert [m.frame_number for m in poses] == [0, 1, 2, 3]
    step_m = np.deg2rad(1e-5) * 6378137 * np.cos(np.deg2rad(49))
    np.testing.assert_allclose(np.diff([m.translation_m for m in poses], axis=0), [[step_m, 0, 0]] * 3, atol=1e-6)
    # From the IMU to the LiDAR (-0.8, 0.3, -0.7) and on to the camera (0.3, 0.1, -0.2) ahead, left, up of it.
    np.testing.assert_allclose(poses[0].translation_m, [1.1, -0.2, 0.5], atol=1e-9)
    assert first.info.metadata["world.origin_lat_deg"] == "49.0"


def test_a_range_of_frames_keeps_its_stamps(tracking_folder: Path, tmp_path: Path, first: Reader) -> None:
    reader, _ = imported(tracking_folder, tmp_path / "part.mcap", "0000", FrameRange(2, 3))
    assert [t.stamp_ns for t in reader.truths()] == [3 * S // 10]
    whole = [m for m in first.messages() if m.frame_number == 2]
    part = list(reader.messages())
    assert [(m.sensor, m.stamp_ns) for m in part] == [(m.sensor, m.stamp_ns) for m in whole]
    pose, other = (next(m for m in group if isinstance(m, Pose)) for group in (part, whole))
    np.testing.assert_array_equal(pose.translation_m, other.translation_m)
    assert reader.info.log_id != first.info.log_id


def test_labels_alone_make_a_log_with_the_camera_they_belong_to(tracking_folder: Path, tmp_path: Path) -> None:
    """The list of sequences says 3 frames; the calibration is of no day of KITTI's."""
    reader, log = imported(tracking_folder, tmp_path / "out.mcap", "0001")
    assert [len(t.boxes3d) for t in reader.truths()] == [0, 1, 0]
    assert reader.rig.sensors("camera", "lidar", "radar") == ("image_02",)
    assert reader.rig.cameras["image_02"].size_wh == (61, 32)
    assert list(reader.messages()) == []
    assert "reference" not in reader.info.metadata
    assert "image_02: 61x32 px, without images: the smallest that holds all labeled boxes" in log.lines


def test_without_a_list_the_last_row_is_the_end(tracking_folder: Path, tmp_path: Path) -> None:
    (tracking_folder / "evaluate_tracking.seqmap.training").unlink()
    reader, _ = imported(tracking_folder, tmp_path / "out.mcap", "0001")
    assert [t.frame_number for t in reader.truths()] == [0, 1]


def test_a_sequence_without_labels_has_no_truth(tracking_folder: Path, tmp_path: Path) -> None:
    (tracking_folder / "label_02/0000.txt").unlink()
    reader, log = imported(tracking_folder, tmp_path / "out.mcap", "0000")
    assert list(reader.truths()) == []
    assert "boxes: no labels" in log.lines


def test_official_and_object_style_calibration_are_the_same(tracking_folder: Path, tmp_path: Path) -> None:
    path = tracking_folder / "calib/0000.txt"
    one, _ = imported(tracking_folder, tmp_path / "one.mcap", "0000")
    text = path.read_text()
    for old, new in (("R_rect", "R0_rect:"), ("Tr_velo_cam", "Tr_velo_to_cam:"), ("Tr_imu_velo", "Tr_imu_to_velo:")):
        text = text.replace(old, new)
    path.write_text(text)
    other, _ = imported(tracking_folder, tmp_path / "other.mcap", "0000")
    assert other.rig.list_changes(one.rig) == ()
    assert [m.stamp_ns for m in other.messages()] == [m.stamp_ns for m in one.messages()]


def test_the_summary_says_what_was_found(tracking_folder: Path, tmp_path: Path) -> None:
    _, log = imported(tracking_folder, tmp_path / "out.mcap", "0000")
    assert list(log.lines) == [
        "frames: 4, 0 to 3",
        "files: image_02 4, velodyne 3",
        "missing files: velodyne 1 (frames 1)",
        "boxes: 3, 2 tracks; 1 DontCare regions",
        "classes: Car 2, Pedestrian 1",
        "frames without boxes: 2",
        "image_02: 100x40 px, of the images",
        "poses: of frames 0 to 3",
        "stamps: made up at 10 Hz, the benchmark has none",
    ]


def test_importing_again_gives_the_same_bytes(tracking_folder: Path, tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        imported(tracking_folder, tmp_path / name, "0000")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_checked_log_has_no_repeated_ids_and_no_unset_stamps(tracking_folder: Path, tmp_path: Path) -> None:
    """Regions to ignore have all the id -1, which is none."""
    rows = (tracking_folder / "label_02/0000.txt").read_text()
    (tracking_folder / "label_02/0000.txt").write_text(rows.splitlines()[0] + "\n" + rows)
    imported(tracking_folder, tmp_path / "out.mcap", "0000")
    faults = FaultLog()
    result = check_log(open_log(tmp_path / "out.mcap", faults), faults, CheckOptions())
    codes = {finding.code for finding in result.findings}
    assert codes.isdisjoint({"GT003", "CHK001", "GT004"})


def rows_of(path: Path) -> list[list[str]]:
    return [line.split() for line in path.read_text().splitlines()]


@pytest.fixture(scope="session")
def training(shared: Path) -> Path:
    folder = shared / "data/kitti_tracking"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    return folder


NUM_FRAMES = {"0012": 78, "0014": 106, "0003": 144}
ALL = [pytest.param(f"{i:04d}", marks=() if f"{i:04d}" in NUM_FRAMES else pytest.mark.slow) for i in range(21)]


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_real_labels_are_all_there(training: Path, tmp_path: Path, name: str) -> None:
    reader, _ = imported(training, tmp_path / "out.mcap", name)
    rows = rows_of(training / f"label_02/{name}.txt")
    truths = list(reader.truths())
    listed = {row[0]: int(row[3]) for row in rows_of(training / "evaluate_tracking.seqmap.training")}
    assert [t.frame_number for t in truths] == list(range(listed[name]))
    for truth in truths:
        of_frame = [row for row in rows if int(row[0]) == truth.frame_number]
        cared = [row for row in of_frame if row[2] != "DontCare"]
        if not of_frame:
            assert (len(truth.boxes3d), len(truth.boxes2d)) == (0, 0)
            continue
        flat, solid = truth.boxes2d, truth.boxes3d
        assert flat.source_label.tolist() == [row[2] for row in of_frame]
        assert flat.track_id.tolist() == [int(row[1]) for row in of_frame]
        assert np.flatnonzero(flat.ignore if flat.ignore is not None else []).tolist() == [
            i for i, row in enumerate(of_frame) if row[2] == "DontCare"
        ]
        assert flat.xyxy_px.tolist() == [[float(v) for v in row[6:10]] for row in of_frame]
        assert flat.attribute is None or [t for t in flat.attribute.tolist() if t] == [f"alpha={r[5]}" for r in cared]
        assert len(solid) == len(cared)
        if cared:
            assert solid.track_id.tolist() == [int(row[1]) for row in cared]
            assert solid.size_lwh_m.tolist() == [[float(row[i]) for i in (12, 11, 10)] for row in cared]
            expected = [[float(r[15]), -float(r[13]), float(r[10]) / 2 - float(r[14])] for r in cared]
            np.testing.assert_allclose(solid.center_m, expected, rtol=0, atol=1e-12)
            assert solid.truncation.tolist() == [float(row[3]) for row in cared]
            assert solid.occlusion.tolist() == [float(row[4]) for row in cared]
            np.testing.assert_allclose(-solid.yaw_rad - np.pi / 2, [float(r[16]) for r in cared], rtol=0, atol=1e-12)


def test_real_sizes_are_those_of_the_days(training: Path, tmp_path: Path) -> None:
    sizes = {"0012": (1242, 375), "0014": (1224, 370), "0018": (1238, 374), "0020": (1241, 376)}
    for name, size_wh in sizes.items():
        reader, _ = imported(training, tmp_path / f"{name}.mcap", name, FrameRange(0, 2))
        assert reader.rig.cameras["image_02"].size_wh == size_wh


def test_real_classes(training: Path, tmp_path: Path) -> None:
    reader, log = imported(training, tmp_path / "out.mcap", "0012")
    classes = Counter(row[2] for row in rows_of(training / "label_02/0012.txt"))
    found: Counter[str] = Counter()
    for truth in reader.truths():
        found.update(() if truth.boxes2d.source_label is None else truth.boxes2d.source_label.tolist())
    assert found == classes
    ranked = sorted(classes, key=lambda name: (-classes[name], name))
    counted = ", ".join(f"{name} {classes[name]}" for name in ranked if name != "DontCare")
    assert f"classes: {counted}" in log.lines
