"""KITTI: labels come out as they went in, and results as its tools and our reader expect them."""

from dataclasses import replace

import numpy as np
import pytest
from tests.replay.formats.exports import (
    CAMERA,
    FORWARD,
    exported,
    flats,
    log_of_labels,
    read,
    rig,
    run_of,
    solids,
    stamp,
    sweeps,
    write_log,
)

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import Mount, Rig

TRACKING = """\
0 -1 DontCare -1 -1 -10.000000 320.980000 172.900000 357.440000 195.810000 -1000.000000 -1000.000000 -1000.000000 \
-10.000000 -1.000000 -1.000000 -1.000000
0 0 Car 1 0 -2.162543 894.768323 190.650299 1241.000000 374.000000 1.381664 1.510562 4.101504 3.407977 1.536793 \
4.758829 -1.570796
0 3 Person 0 3 3.141593 892.000000 190.000000 900.000000 200.500000 1.600000 0.500000 0.600000 -3.000000 0.000001 \
12.000000 3.100000
2 3 Misc 2 2 0.000000 892.000000 190.000000 900.000000 200.500000 1.600000 0.500000 0.600000 -3.000000 1.400000 \
-12.000000 -3.100000
"""
MOUNT_M = np.array([1.5, 0.25, -0.5])
OBJECT = {
    0: "Pedestrian 0.00 0 -0.20 712.40 143.00 810.73 307.92 1.89 0.48 1.20 1.84 1.47 8.41 0.01\n",
    1: "Truck 0.25 0 -1.57 599.41 156.40 629.75 189.25 2.85 2.63 12.34 0.47 1.49 69.44 -1.56\n"
    "DontCare -1 -1 -10 503.89 169.71 590.61 190.13 -1 -1 -1 -1000 -1000 -1000 -10\n",
    2: "",
}


def test_tracking_labels_come_out_byte_for_byte(tmp_path):
    label = tmp_path / "0003.txt"
    label.write_text(TRACKING)
    done = exported("kitti-tracking", tmp_path / "out", log_of_labels(label, tmp_path / "0003.mcap"))
    assert (tmp_path / "out" / "0003.txt").read_text() == TRACKING
    assert (done.num_rows, done.num_frames, done.left_out) == (4, 3, {})
    assert done.view == "2D boxes in image_02, 3D boxes in body"


def test_object_labels_come_out_byte_for_byte(tmp_path):
    (tmp_path / "label_2").mkdir()
    for number, text in OBJECT.items():
        (tmp_path / "label_2" / f"{number:06d}.txt").write_text(text)
    exported("kitti", tmp_path / "out", log_of_labels(tmp_path / "label_2", tmp_path / "object.mcap", "kitti"))
    assert {int(file.stem): file.read_text() for file in (tmp_path / "out").iterdir()} == OBJECT


@pytest.mark.slow
def test_real_tracking_labels_come_out_byte_for_byte(shared, tmp_path):
    from fbench.datasets.importing.run import import_recordings
    from fbench.datasets.kitti import Kitti
    from fbench.replay.contracts.importing import ImportRequest
    from fbench.replay.logs.convert.target import Target

    source = shared / "data" / "kitti_tracking"
    names = tuple(Kitti().names(source))[::3]
    targets = {name: Target(tmp_path / f"{name}.mcap") for name in names}
    logs = [log.path for log in import_recordings(Kitti(), source, ImportRequest(names), targets)]
    exported("kitti-tracking", tmp_path / "out", *logs)
    labels = sorted((source / "label_02").glob("*.txt"))[::3]
    assert len(labels) == 7
    assert [file.name for file in labels if (tmp_path / "out" / file.name).read_bytes() != file.read_bytes()] == []


def test_real_object_labels_come_out_byte_for_byte(shared, tmp_path):
    folder = shared / "data" / "kitti_object" / "label_2"
    exported("kitti", tmp_path / "out", log_of_labels(folder, tmp_path / "object.mcap", "kitti"))
    for file in sorted(folder.glob("*.txt")):
        assert (tmp_path / "out" / file.name).read_bytes() == file.read_bytes()


def test_truth_without_ids_is_paired_in_order_within_a_class(tmp_path):
    flat = flats(4, source_label=["Van", "Car", "DontCare", "Car"], ignore=[False, False, True, False])
    solid = solids([10, 20, 30], source_label=["Car", "Van", "Car"])
    log = write_log(tmp_path / "a.mcap", [Truth(stamp(0), stamp(0), solid, flat, 0)])
    exported("kitti", tmp_path / "out", log)
    rows = [row.split() for row in (tmp_path / "out" / "000000.txt").read_text().splitlines()]
    assert [(row[0], float(row[4]), float(row[13])) for row in rows] == [
        ("Van", 0, 20), ("Car", 100.25, 10), ("DontCare", 200.5, -1000), ("Car", 300.75, 30)
    ]  # fmt: skip


def test_a_result_by_hand(tmp_path):
    """A car 10 m ahead, 4 long, 1.8 wide, 1.5 high: its rear is 8 m away, f is 700 px, the center at (600, 180)."""
    log = write_log(tmp_path / "0007.mcap", sweeps(2))
    run = run_of(log, lambda i: solids([10.0], score=[0.75], track_id=[5]) if i else solids([]))
    exported("kitti-tracking", tmp_path / "out", run)
    left, top = 600 - 700 * 0.9 / 8, 180 - 700 * 0.75 / 8
    right, bottom = 600 + 700 * 0.9 / 8, 180 + 700 * 0.75 / 8
    # It faces z, whereas rotation_y is 0 for x; atan2(x, z) is 0.
    expected = (
        f"1 5 Car -1 -1 -1.570796 {left:.6f} {top:.6f} {right:.6f} {bottom:.6f} 1.500000 1.800000 4.000000 "
        "0.000000 0.750000 10.000000 -1.570796 0.750000\n"
    )
    assert (tmp_path / "out" / "0007.txt").read_text() == expected


@pytest.mark.parametrize("form", ["kitti", "kitti-tracking"])
def test_results_are_read_back(tmp_path, form):
    rng = np.random.default_rng(1)
    boxes = [
        Boxes3D(
            np.stack([rng.uniform(8, 40, 7), rng.uniform(-3, 3, 7), rng.uniform(-1, 1, 7)], axis=1),
            rng.uniform(1, 5, (7, 3)), rng.uniform(-np.pi, np.pi, 7), score=rng.random(7), track_id=np.arange(7),
            label=np.array(["car", "van", "truck", "pedestrian", "bicycle", "bus", "other"]),
        )
        for _ in range(3)
    ]  # fmt: skip
    moved = Rig({"cam": Mount("camera", MOUNT_M, FORWARD)}, {"cam": CAMERA})
    log = write_log(tmp_path / "a.mcap", sweeps(3), of=Rig({**rig().mounts, **moved.mounts}, moved.cameras))
    exported(form, tmp_path / "out", run_of(log, boxes.__getitem__))
    path = tmp_path / "out" / "a.txt" if form == "kitti-tracking" else tmp_path / "out"
    for wanted, truth in zip(boxes, read(path, form, "cam"), strict=True):
        got = truth.boxes3d
        np.testing.assert_allclose(got.center_m + MOUNT_M, wanted.center_m, atol=2e-6)
        np.testing.assert_allclose(got.size_lwh_m, wanted.size_lwh_m, atol=1e-6)
        np.testing.assert_allclose(np.exp(1j * got.yaw_rad), np.exp(1j * wanted.yaw_rad), atol=2e-6)
        np.testing.assert_allclose(got.score, wanted.score, atol=1e-6)
        assert got.source_label.tolist() == ["Car", "Van", "Truck", "Pedestrian", "Cyclist", "Misc", "Misc"]
        if form == "kitti-tracking":
            assert got.track_id.tolist() == list(range(7))


def test_angles_are_wrapped(tmp_path):
    log = write_log(tmp_path / "a.mcap", sweeps(1))
    run = run_of(log, lambda i: replace(solids([10.0, 20.0]), yaw_rad=np.array([3.0, 1.6])))
    exported("kitti", tmp_path / "out", run)
    angles = [float(row.split()[14]) for row in (tmp_path / "out" / "000000.txt").read_text().splitlines()]
    np.testing.assert_allclose(angles, [-3 - np.pi / 2 + 2 * np.pi, -1.6 - np.pi / 2 + 2 * np.pi], atol=1e-6)


def test_boxes_in_images_alone_have_no_3d_numbers(tmp_path):
    run = run_of(write_log(tmp_path / "a.mcap", sweeps(1)), lambda i: flats(1, score=[0.5]))
    done = exported("kitti", tmp_path / "out", run)
    text = (tmp_path / "out" / "000000.txt").read_text()
    assert text.split()[8:] == [f"{v:.6f}" for v in (-1, -1, -1, -1000, -1000, -1000, -10, 0.5)]
    assert text.split()[3] == "-10.000000"
    assert read(tmp_path / "out", "kitti")[0].boxes3d is None
    assert done.view == "2D boxes in cam"


def test_what_is_left_out_is_counted(tmp_path):
    log = write_log(tmp_path / "a.mcap", sweeps(1))
    scores, ids = [0.1, 0.2, 0.3, np.inf, 0.4], [1, 2, 3, 4, -1]
    run = run_of(log, lambda i: solids([10, -10, np.nan, 20, 30], score=scores, track_id=ids))
    done = exported("kitti-tracking", tmp_path / "out", run)
    assert done.left_out == {"not seen by cam": 1, "not finite": 2, "without a track id": 1}
    assert done.num_rows == 1


def test_boxes_of_other_cameras_are_left_out(tmp_path):
    of = rig("cam", "rear")
    log = write_log(tmp_path / "a.mcap", sweeps(1), of=of)
    run = run_of(log, lambda i: replace(flats(3), camera=np.array(["cam", "rear", "cam"])))
    with pytest.raises(ConfigError, match="which camera's image is meant\\? name one of cam, rear with --camera"):
        exported("kitti", tmp_path / "out", run)
    with pytest.raises(ConfigError, match="--camera reer: isn't in the log; did you mean 'rear'"):
        exported("kitti", tmp_path / "out", run, camera="reer")
    assert exported("kitti", tmp_path / "out", run, camera="cam").left_out == {"of other cameras": 1}


def test_large_ids_get_small_numbers(tmp_path):
    ids = [2**62 + 5, 7, 2**62 + 6]
    log = write_log(tmp_path / "a.mcap", sweeps(2))
    exported("kitti-tracking", tmp_path / "out", run_of(log, lambda i: solids([10, 20, 30], track_id=ids)))
    rows = [row.split() for row in (tmp_path / "out" / "a.txt").read_text().splitlines()]
    assert [row[1] for row in rows] == ["0", "1", "2"] * 2


def test_classes(tmp_path):
    log = write_log(tmp_path / "a.mcap", sweeps(1))
    run = run_of(log, lambda i: replace(solids([10.0]), label=None))
    with pytest.raises(LogError, match="boxes without a class; say which they are of with --class, such as Car"):
        exported("kitti", tmp_path / "out", run)
    with pytest.raises(ConfigError, match="--class Vna: no class of kitti; did you mean 'Van'"):
        exported("kitti", tmp_path / "out", run, class_name="Vna")
    exported("kitti", tmp_path / "out", run, class_name="Van")
    assert (tmp_path / "out" / "000000.txt").read_text().startswith("Van -1 -1 ")


def test_coordinate_frames(tmp_path):
    raised = Rig({**rig().mounts, "cam": Mount("camera", np.array([0, 0, 1.0]), FORWARD)}, {"cam": CAMERA})
    run = run_of(write_log(tmp_path / "a.mcap", sweeps(1), of=raised), lambda i: solids([10.0]))

    def y(out: str, **asked: str) -> float:
        exported("kitti", tmp_path / out, run, **asked)
        return float((tmp_path / out / "000000.txt").read_text().split()[12])

    assert y("a") == 1.75  # the bottom is 0.75 m below the body's origin, the camera 1 m above that
    assert y("b", frame="body") == 0.75
    with pytest.raises(ConfigError, match="--frame lidar: neither 'body' nor a camera"):
        y("c", frame="lidar")


def test_ids_are_needed(tmp_path):
    run = run_of(write_log(tmp_path / "a.mcap", sweeps(1)), lambda i: solids([10.0]))
    with pytest.raises(LogError, match="no track ids, which this format needs"):
        exported("kitti-tracking", tmp_path / "out", run)


def test_a_log_without_truth(tmp_path):
    with pytest.raises(LogError, match="has no truth to export"):
        exported("kitti", tmp_path / "out", write_log(tmp_path / "a.mcap", sweeps(1)))


def test_frames_without_numbers_of_their_own_count(tmp_path):
    """Truth at the second and fourth of five sweeps."""
    truths = [Truth(stamp(i), stamp(i), solids([10.0]), None) for i in (1, 3)]
    exported("kitti", tmp_path / "out", write_log(tmp_path / "a.mcap", [*sweeps(5), *truths]))
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["000001.txt", "000003.txt"]


def test_truth_of_a_run_is_that_of_its_log(tmp_path):
    flat = flats(2, source_label=["Car", "DontCare"], ignore=[False, True])
    truths = [Truth(stamp(i), stamp(i), solids([10.0 + i], source_label=["Car"]), flat, 10 + i) for i in range(3)]
    log = write_log(tmp_path / "a.mcap", [*sweeps(3, [10, 11, 12]), *truths])
    exported("kitti", tmp_path / "log", log)
    exported("kitti", tmp_path / "run", run_of(log, lambda i: solids([])), boxes="truth")
    texts = [{f.name: f.read_text() for f in (tmp_path / side).iterdir()} for side in ("log", "run")]
    assert texts[0] == texts[1]
    assert sorted(texts[0]) == ["000010.txt", "000011.txt", "000012.txt"]


@pytest.mark.filterwarnings("error")
def test_numbers_beyond_all_reason_are_left_out(tmp_path):
    boxes = solids([10.0, 1e12, 20.0], track_id=[1, 2, 3], occlusion=[np.inf, 0, 1e300], truncation=[np.inf, 0, 0.5])
    log = write_log(tmp_path / "a.mcap", [*sweeps(1), Truth(stamp(0), stamp(0), boxes)])
    assert exported("kitti-tracking", tmp_path / "out", log).left_out == {"not finite": 1}
    rows = [row.split() for row in (tmp_path / "out/a.txt").read_text().splitlines()]
    assert [row[1:5] for row in rows] == [["1", "Car", "-1", "-1"], ["3", "Car", "0.5", "-1"]]
