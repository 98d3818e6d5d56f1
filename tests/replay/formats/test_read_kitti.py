"""KITTI's object and tracking benchmarks: rows by hand, and real labels against their calibration."""

from collections import Counter

import numpy as np
import pytest
from tests.replay.formats.box_files import FORWARD, form, read

from fbench.replay.contracts.errors import ConfigError, FbenchError, LimitError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import finite
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.formats.open import open_boxes
from fbench.replay.geometry.iou import corners, iou_2d
from fbench.replay.geometry.transforms import inverse, quaternion, transform
from fbench.replay.logs.coordinate_frames import CoordinateFrames, Edge, tree_of
from fbench.replay.logs.setup import BoxSource

CAR = "Car 0.00 1 -1.5 10 20 30 40 1.5 2.0 4.0 3 1.6 20 0.5"
REGION = "DontCare -1 -1 -10 100 20 130 40 -1 -1 -1 -1000 -1000 -1000 -10"
FLAT = "Pedestrian -1 -1 -10 1 2 3 4 -1 -1 -1 -1000 -1000 -1000 -10 0.75"


def test_object_rows_by_hand(tmp_path):
    folder = tmp_path / "label_2"
    folder.mkdir()
    (folder / "000003.txt").write_text(f"{CAR}\n{REGION}\r\n")
    (folder / "000001.txt").write_text("")
    assert form(tmp_path) == form(folder) == form(folder / "000003.txt") == "kitti"
    empty, truth = read(tmp_path)
    assert (empty.frame_index, len(empty.boxes3d), len(empty.boxes2d)) == (1, 0, 0)
    assert (truth.frame_index, truth.frame_number, truth.stamp_ns) == (3, 3, 0)
    # The camera at the origin looks ahead: x right is the body's -y, z ahead its x; 1.6 m down is the car's bottom.
    np.testing.assert_allclose(truth.boxes3d.center_m, [[20, -3, -1.6 + 0.75]], atol=1e-12)
    assert truth.boxes3d.size_lwh_m.tolist() == [[4, 2, 1.5]]
    # At rotation_y 0 it faces x, to the right; turning about y, down, takes it on to the back.
    np.testing.assert_allclose(truth.boxes3d.yaw_rad, [-np.pi / 2 - 0.5], atol=1e-12)
    np.testing.assert_allclose([truth.boxes3d.pitch_rad, truth.boxes3d.roll_rad], 0, atol=1e-12)
    assert truth.boxes3d.occlusion.tolist() == [1]
    assert truth.boxes2d.xyxy_px.tolist() == [[10, 20, 30, 40], [100, 20, 130, 40]]
    assert truth.boxes2d.ignore.tolist() == [False, True]
    assert truth.boxes2d.label.tolist() == ["car", "other"]
    assert truth.boxes2d.source_label.tolist() == ["Car", "DontCare"]
    assert truth.boxes2d.camera.tolist() == ["cam", "cam"]


def test_results_in_2d_alone_have_no_solids(tmp_path):
    (tmp_path / "000000.txt").write_text(f"{FLAT}\n")
    (tmp_path / "000001.txt").write_text("")
    first, second = read(tmp_path)
    assert (first.boxes3d, second.boxes3d) == (None, None)
    assert (first.boxes2d.score.tolist(), len(second.boxes2d)) == ([0.75], 0)


def test_tracking_rows_by_hand(tmp_path):
    path = tmp_path / "0000.txt"
    path.write_text(f"3 7 {CAR}\n0 -1 {REGION}\n0 7 {CAR}\n")
    assert form(path) == "kitti-tracking"
    truths = read(path)
    assert [t.frame_index for t in truths] == [0, 1, 2, 3]
    assert [len(t.boxes3d) for t in truths] == [1, 0, 0, 1]
    assert truths[0].boxes2d.track_id.tolist() == [-1, 7]


def test_trackers_may_write_more_behind_the_score(tmp_path):
    path = tmp_path / "0000.txt"
    path.write_text(f"3 7 {CAR} 0.5 1 2 3\n")
    assert form(path) == "kitti-tracking"
    path.write_text(" ".join(["word"] * 20) + "\n")
    with pytest.raises(LogError, match="no form of boxes"):
        form(path)


def test_3d_and_2d_boxes_of_two_cameras(tmp_path):
    """KITTI's 3D boxes are at camera 0, its images those of camera 2."""
    (tmp_path / "000000.txt").write_text(f"{CAR}\n")
    mounts = {"cam0": Mount("camera", np.array([1.0, 0, 0]), FORWARD), "cam2": Mount("camera", np.zeros(3), FORWARD)}
    rig = Rig(mounts, {name: CameraModel(np.eye(3), (9, 9)) for name in mounts})
    known = CoordinateFrames(rig, tree_of(rig), "body", {})
    source = BoxSource(tmp_path, frame="cam0", camera="cam2")
    [truth] = open_boxes(source, known, FaultLog()).truths()
    assert truth.boxes2d.camera.tolist() == ["cam2"]
    np.testing.assert_allclose(truth.boxes3d.center_m[0, 0], 21)


def test_3d_boxes_at_a_camera_that_the_log_has_no_images_of(tmp_path):
    (tmp_path / "000000.txt").write_text(f"{CAR}\n")
    rig = Rig({"cam2": Mount("camera", np.zeros(3), FORWARD)}, {"cam2": CameraModel(np.eye(3), (9, 9))})
    tree = tree_of(rig)
    tree.put("cam0_link", Edge("body", np.array([1.0, 0, 0]), FORWARD))
    known = CoordinateFrames(rig, tree, "body", {})
    [truth] = open_boxes(BoxSource(tmp_path, frame="cam0_link", camera="cam2"), known, FaultLog()).truths()
    assert truth.boxes2d.camera.tolist() == ["cam2"]
    np.testing.assert_allclose(truth.boxes3d.center_m, [[21, -3, -1.6 + 0.75]], atol=1e-12)
    with pytest.raises(ConfigError, match="coordinate frame 'cam1_link' isn't in the log; did you mean 'cam0_link'"):
        list(open_boxes(BoxSource(tmp_path, frame="cam1_link", camera="cam2"), known, FaultLog()).truths())


def test_trackers_that_write_more_behind_the_score(tmp_path):
    (tmp_path / "0000.txt").write_text(f"0 7 {FLAT} 1\n")
    [truth] = read(tmp_path)
    assert (truth.boxes2d.track_id.tolist(), truth.boxes2d.score.tolist()) == ([7], [0.75])


@pytest.mark.parametrize(
    ("name", "text", "match"),
    [
        ("000000.txt", "Car 0 0\n", "no form of boxes that fbench knows"),
        ("000000.txt", f"{CAR}\nCar 0 0 1\n", "000000.txt line 2: 3 numbers after the class, expected 14, or 15"),
        ("000000.txt", f"{CAR}\n{CAR.replace('20 30', '20 x')}\n", "line 2: right is 'x', expected a number"),
        ("0000.txt", f"0 1 {CAR}\nx 1 {CAR}\n", "0000.txt line 2: frame is 'x', expected a whole number"),
        ("0000.txt", f"0 1 {CAR}\n1 1.5 {CAR}\n", "line 2: track id is '1.5', expected a whole number"),
        ("0000.txt", f"0 1 {CAR}\n0 1 {CAR}\n", "id 1 twice at frame 0"),
        ("0000.txt", f"0 1 {CAR}\n0 1 {CAR[:-4]}\n", "line 2: 16 columns, expected 17, or 18 with a score"),
        ("0000.txt", f"999999999999 1 {CAR}\n", "line 1: frame is 999999999999, expected 0 to 9999999"),
        ("0000.txt", f"0 1 {CAR}\n\udcff\n", "isn't UTF-8 text"),
        ("0000.txt", f"0 1 {CAR}\n{'1' * 200_000}\n", "line 2: longer than 100000 characters"),
    ],
)
def test_bad_files_name_the_line(tmp_path, name, text, match):
    (tmp_path / name).write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(FbenchError, match=match):
        read(tmp_path / name)


def test_which_camera_and_which_sequence(tmp_path):
    (tmp_path / "000000.txt").write_text(f"{CAR}\n")
    with pytest.raises(ConfigError, match=r"which camera are the boxes of. the log has left, right; name it"):
        read(tmp_path, "left", "right")
    with pytest.raises(ConfigError, match="'lidar' is no camera of the log; there are: cam"):
        read(tmp_path, frame="lidar")
    (tmp_path / "none").mkdir()
    with pytest.raises(LogError, match="no file that is named by a number"):
        read(tmp_path / "none", format="kitti")
    for i in range(2):
        (tmp_path / "none" / f"000{i}.txt").write_text(f"0 1 {CAR}\n")
    with pytest.raises(ConfigError, match=r"2 sequences, 0000.txt to 0001.txt; name one file"):
        read(tmp_path / "none")


def test_unknown_format_and_file(tmp_path):
    (tmp_path / "0.txt").write_text("hello\n")
    with pytest.raises(ConfigError, match="'kiti' is no form of boxes; did you mean 'kitti'"):
        read(tmp_path / "0.txt", format="kiti")
    with pytest.raises(ConfigError, match="no such file or folder"):
        read(tmp_path / "1.txt")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match="no form of boxes that fbench knows"):
        read(tmp_path / "empty")
    (tmp_path / "99999999.txt").write_text(CAR)
    with pytest.raises(LimitError, match="frame is 99999999"):
        read(tmp_path / "99999999.txt")


def calibrated(path):
    """Camera 0 and camera 2 on a body as KITTI's rectified calibration has them: P2 = K [I | t]."""
    P2 = np.array(next(line for line in path.read_text().splitlines() if line.startswith("P2")).split()[1:], float)
    P2 = P2.reshape(3, 4)
    K = P2[:, :3]
    cam2_T_cam0 = np.eye(4)
    cam2_T_cam0[:3, 3] = np.linalg.solve(K, P2[:, 3])
    body_T_cam0 = np.eye(4)
    body_T_cam0[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    poses = {"cam0": body_T_cam0, "cam2": body_T_cam0 @ inverse(cam2_T_cam0)}
    mounts = {name: Mount("camera", T[:3, 3], quaternion(T[:3, :3])) for name, T in poses.items()}
    rig = Rig(mounts, {name: CameraModel(K, (1242, 375)) for name in mounts})
    return CoordinateFrames(rig, tree_of(rig), "body", {})


def projected(boxes, known):
    """Smallest rectangles around the corners in camera 2, cut at the image's borders."""
    points = transform(inverse(known.rig.body_T_sensor("cam2")), corners(boxes).reshape(-1, 3))
    uv = points @ known.rig.cameras["cam2"].K.T
    uv = (uv[:, :2] / uv[:, 2:]).reshape(-1, 8, 2)
    low, high = uv.min(axis=1), uv.max(axis=1)
    return np.clip(np.hstack([low, high]), 0, [1241, 374, 1241, 374])


def test_projections_of_real_boxes_agree_with_their_2d_labels(shared):
    root = shared / "data/kitti_object"
    overlaps = []
    for calib in sorted((root / "calib").glob("*.txt")):
        known = calibrated(calib)
        source = BoxSource(root / "label_2" / calib.name, frame="cam0", camera="cam2")
        [truth] = open_boxes(source, known, FaultLog()).truths()
        labeled = truth.boxes2d[truth.boxes2d.source_label != "DontCare"]
        overlaps += np.diag(iou_2d(projected(truth.boxes3d, known), labeled.xyxy_px)).tolist()
    assert len(overlaps) >= 6
    assert np.mean(overlaps) > 0.9
    assert min(overlaps) > 0.85


@pytest.mark.slow
def test_tracking_sequences_hold_what_a_plain_count_finds(shared):
    known = calibrated(shared / "data/kitti_tracking/calib/0000.txt")
    folder = shared / "data/kitti_tracking/label_02"
    files = sorted(folder.glob("*.txt"))
    assert len(files) == 21
    for path in files[::3]:
        rows = [line.split() for line in path.read_text().splitlines()]
        file = open_boxes(BoxSource(path, frame="cam0", camera="cam2"), known, FaultLog())
        truths = list(file.truths())
        assert len(truths) == 1 + max(int(row[0]) for row in rows)
        flat = Counter(name for t in truths if len(t.boxes2d) for name in t.boxes2d.source_label.tolist())
        assert flat == Counter(row[2] for row in rows)
        solid = sum(len(truth.boxes3d) for truth in truths)
        assert solid == sum(row[2] != "DontCare" for row in rows)
        ids = {int(i) for t in truths if len(t.boxes3d) for i in t.boxes3d.track_id}
        assert ids == {int(row[1]) for row in rows if row[2] != "DontCare"}


def test_output_of_a_real_tracker_in_2d(shared):
    known = calibrated(shared / "data/kitti_tracking/calib/0000.txt")
    for path in sorted((shared / "data/kitti_tracking/trackers_2d/GT-SORT/data").glob("*.txt"))[:3]:
        rows = [line.split() for line in path.read_text().splitlines()]
        truths = list(open_boxes(BoxSource(path, frame="cam2", camera="cam2"), known, FaultLog()).truths())
        assert all(truth.boxes3d is None for truth in truths)
        assert sum(len(truth.boxes2d) for truth in truths) == len(rows)
        edges = np.concatenate([truth.boxes2d.xyxy_px for truth in truths])
        np.testing.assert_allclose(edges.sum(axis=0), np.array([row[6:10] for row in rows], float).sum(axis=0))


@pytest.mark.parametrize("place", ["1e999 1.6 20 0.5", "3 -1e999 nan 0.5", "1e308 1e308 1e308 1", "3 1.6 20 1e999"])
def test_numbers_that_cannot_be_warn_nobody(tmp_path, place):
    """Such boxes are left out, and counted, where they meet their frame."""
    (tmp_path / "000000.txt").write_text(f"{CAR}\n{CAR.replace('3 1.6 20 0.5', place)}\n")
    [truth] = read(tmp_path)
    assert finite(truth.boxes3d)[0].tolist() == [True, False]


AB3DMOT = "3,2,10,20,30,40,9.5,1.5,2.0,4.0,3,1.6,20,0.5,-1.5"


def test_detections_of_ab3dmot_by_hand(tmp_path):
    """The same car as in KITTI's own rows; 3 is the frame, 2 a car."""
    path = tmp_path / "0000.txt"
    path.write_text(f"{AB3DMOT}\n1{AB3DMOT[1:].replace(',2,', ',1,', 1)}\n")
    assert form(path) == form(tmp_path) == "ab3dmot"
    truths = read(path)
    assert [(t.frame_index, len(t.boxes3d), len(t.boxes2d)) for t in truths] == [
        (0, 0, 0),
        (1, 1, 1),
        (2, 0, 0),
        (3, 1, 1),
    ]
    truth = truths[3]
    np.testing.assert_allclose(truth.boxes3d.center_m, [[20, -3, -1.6 + 0.75]], atol=1e-12)
    assert truth.boxes3d.size_lwh_m.tolist() == [[4, 2, 1.5]]
    np.testing.assert_allclose(truth.boxes3d.yaw_rad, [-np.pi / 2 - 0.5], atol=1e-12)
    assert truth.boxes3d.score.tolist() == truth.boxes2d.score.tolist() == [9.5]
    assert truth.boxes2d.xyxy_px.tolist() == [[10, 20, 30, 40]]
    assert (truth.boxes3d.track_id, truth.boxes3d.occlusion) == (None, None)
    assert truth.boxes3d.source_label.tolist() == ["Car"]
    assert truths[1].boxes3d.label.tolist() == ["pedestrian"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{AB3DMOT}\n{AB3DMOT},1\n", r"0000.txt line 2: 16 columns, expected 15: frame, class, left, top"),
        (f"{AB3DMOT}\n{AB3DMOT.replace('9.5', 'x')}\n", r"0000.txt line 2: score is 'x', expected a number"),
        (f"{AB3DMOT}\n{AB3DMOT.replace(',2,', ',2.5,', 1)}\n", r"0000.txt line 2: class is '2.5', expected a whole"),
        (f"{AB3DMOT}\n-{AB3DMOT}\n", r"0000.txt line 2: frame is -3"),
    ],
)
def test_broken_detections_of_ab3dmot(tmp_path, text, message):
    (tmp_path / "0000.txt").write_text(text)
    with pytest.raises(FbenchError, match=message):
        read(tmp_path / "0000.txt")


def test_several_sequences_of_ab3dmot(tmp_path):
    for name in ("0000.txt", "0001.txt"):
        (tmp_path / name).write_text(AB3DMOT)
    with pytest.raises(ConfigError, match=r"2 sequences, 0000.txt to 0001.txt; name one file"):
        read(tmp_path)


def test_real_detections_of_ab3dmot(shared):
    path = shared / "data/kitti_tracking/pointrcnn_car_val/0012.txt"
    rows = np.loadtxt(path, delimiter=",")
    truths = read(path)
    assert sum(len(t.boxes3d) for t in truths) == len(rows)
    assert {name for t in truths if len(t.boxes3d) for name in t.boxes3d.label.tolist()} == {"car"}
    np.testing.assert_array_equal(
        np.concatenate([t.boxes3d.score for t in truths if len(t.boxes3d)]),
        rows[np.argsort(rows[:, 0], kind="stable"), 6],
    )
