"""Boxes of raw drives."""

import numpy as np
import pytest

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import FrameRange
from fbench.replay.geometry.iou import corners


def test_boxes_stand_where_they_were_labelled(drive, make_tracklet):
    """Corners as in the devkit's run_demoTracklets.m: l/2, w/2 about the bottom, turned by rz, in LiDAR coordinates."""
    drive.write_tracklets(make_tracklet([drive.pose.format(10, 2, -1.7, 0.6, 2, 0, 0)], hwl="1.5 1.6 4.2"))
    found = drive.imported()
    length, width, height = 4.2, 1.6, 1.5
    local = np.array([[x * length / 2, y * width / 2, z] for x in (1, -1) for y in (1, -1) for z in (0, height)])
    turn = np.array([[np.cos(0.6), -np.sin(0.6), 0], [np.sin(0.6), np.cos(0.6), 0], [0, 0, 1]])
    body_T_velo = found.log.rig.body_T_sensor("velodyne")
    expected = (local @ turn.T + [10, 2, -1.7]) @ body_T_velo[:3, :3].T + body_T_velo[:3, 3]
    boxes = found.truths[0].boxes3d
    assert boxes.size_lwh_m.tolist() == [[4.2, 1.6, 1.5]]
    got = corners(boxes)[0]
    nearest = np.linalg.norm(got[:, None] - expected[None], axis=2)
    assert sorted(nearest.argmin(axis=1)) == list(range(8))
    assert nearest.min(axis=1).max() < 1e-9
    ahead = got[[0, 2, 4, 6]].mean(axis=0) - boxes.center_m[0]
    np.testing.assert_allclose(ahead, body_T_velo[:3, :3] @ turn @ [2.1, 0, 0], atol=1e-9)


def test_every_frame_has_truth_at_the_stamp_of_the_lidar(drive, make_tracklet):
    drive.write_tracklets(make_tracklet([drive.pose.format(10, 2, -1.7, 0.6, 2, 0, 0)], first=1))
    found = drive.imported()
    assert [(t.frame_number, len(t.boxes3d)) for t in found.truths] == [(0, 0), (1, 1), (2, 0)]
    assert [t.stamp_ns for t in found.truths] == [m.stamp_ns for m in found.of("velodyne")]


def test_classes_tracks_and_levels_are_kept(drive, make_tracklet):
    drive.write_tracklets(
        make_tracklet([drive.pose.format(10, 2, -1.7, 0, 2, 0, 1), drive.pose.format(11, 2, -1.7, 0, 1, -1, -1)]),
        make_tracklet([], "Tram"),
        make_tracklet([drive.pose.format(20, 2, -1, 0, 0, 2, 99)], "Person (sitting)", first=1),
    )
    first, second, _ = (t.boxes3d for t in drive.imported().truths)
    assert first.source_label.tolist() == ["Car"]
    assert (first.occlusion.tolist(), first.truncation.tolist(), first.attribute.tolist()) == ([0], [1], ["labelled"])
    assert second.source_label.tolist() == ["Car", "Person (sitting)"]
    assert second.label.tolist() == ["car", "pedestrian"]
    assert second.track_id.tolist() == [0, 2]
    assert second.attribute.tolist() == ["interpolated", ""]
    np.testing.assert_array_equal(second.occlusion, [np.nan, 2])
    np.testing.assert_array_equal(second.truncation, [np.nan, 99])


@pytest.mark.parametrize(
    ("kind", "label"),
    [
        ("Car", "car"), ("Van", "van"), ("Truck", "truck"), ("Pedestrian", "pedestrian"), ("Cyclist", "bicycle"),
        ("Tram", "other"), ("Misc", "other"),
    ],
)  # fmt: skip
def test_classes(drive, make_tracklet, kind, label):
    drive.write_tracklets(make_tracklet([drive.pose.format(10, 2, -1.7, 0, 2, 0, 1)], kind))
    assert drive.imported().truths[0].boxes3d.label.tolist() == [label]


def test_drives_without_tracklets_have_no_truth(drive):
    found = drive.imported()
    assert found.truths == []
    assert "no boxes: no tracklet_labels.xml" in found.lines


def test_an_empty_list_means_that_nothing_was_there(drive):
    drive.write_tracklets()
    assert [len(t.boxes3d) for t in drive.imported().truths] == [0, 0, 0]


def test_boxes_of_frames_that_lack_are_counted(drive, make_tracklet):
    poses = [drive.pose.format(10, 2, -1.7, 0, 2, 0, 0)] * 5
    drive.write_tracklets(make_tracklet(poses))
    found = drive.imported()
    assert [len(t.boxes3d) for t in found.truths] == [1, 1, 1]
    assert "boxes left out: 2 in frames 3 to 4, which velodyne hasn't" in found.lines
    assert "boxes: 3 (Car 3) of 1 tracklets, 0 of them interpolated between labeled ones" in found.lines


def test_a_range_of_frames_has_its_boxes(drive, make_tracklet):
    drive.write_tracklets(make_tracklet([drive.pose.format(10 + i, 2, -1.7, 0, 2, 0, 0) for i in range(3)]))
    whole, part = drive.imported().truths, drive.imported(frames=FrameRange(2)).truths
    assert [t.frame_number for t in part] == [2]
    np.testing.assert_array_equal(part[0].boxes3d.center_m, whole[2].boxes3d.center_m)


ENTITIES = '<!DOCTYPE boost_serialization [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[: len(text) // 2], "isn't XML"),
        (lambda text: "", "isn't XML"),
        (lambda text: text.replace("<!DOCTYPE boost_serialization>", ENTITIES), "with a DTD is refused"),
        (lambda text: text.replace("boost_serialization>", 'boost_serialization SYSTEM "x">', 1), "a DTD is refused"),
        (lambda text: "<html></html>", "<html> instead of <boost_serialization>"),
        (lambda text: text.replace("<objectType>", "<a>" * 100000), "nested more than 16 deep"),
        (lambda text: text.replace("<h>", "<h>" + "1" * 5000), "a text of more than 1000 characters"),
        (lambda text: text.replace("<count>1</count>", "<count>2</count>", 1), "<count> is 2, but there are 1"),
        (lambda text: text.replace("<count>1</count>", "<count>-1</count>", 1), "<count> is -1, expected 0 or more"),
        (lambda text: text.replace("<count>1</count>", "", 1), "no <count>"),
    ],
)
def test_files_that_are_no_tracklets_are_refused(drive, make_tracklet, change, message):
    path = drive.write_tracklets(make_tracklet([drive.pose.format(10, 2, -1.7, 0, 2, 0, 0)] * 3))
    path.write_text(change(path.read_text()))
    with pytest.raises(LogError, match=f"tracklet_labels.xml: .*{message}") as caught:
        drive.imported()
    assert "\n" not in str(caught.value)
    found = drive.imported(skip=True)
    assert (found.bad.num, found.truths) == (1, [])
    assert len(found.messages) == 12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("<tx>10<", "<tx>nan<", 1), "<tx> is 'nan', expected a finite number"),
        (lambda text: text.replace("<tx>10<", "<tx>1e400<", 1), "<tx> is '1e400'"),
        (lambda text: text.replace("<tx>10</tx>", "", 1), "no <tx>"),
        (lambda text: text.replace("<tx>10<", "<tx>ten<", 1), "<tx> is 'ten', expected a number"),
        (lambda text: text.replace("<count>3<", "<count>4<", 1), "<count> is 4, but there are 3"),
        (lambda text: text.replace("<count>3<", "<count>-3<", 1), "<count> is -3"),
        (lambda text: text.replace("<first_frame>0<", "<first_frame>-1<", 1), "<first_frame> is -1, expected 0 or"),
        (lambda text: text.replace("<first_frame>0<", "<first_frame>1e99<", 1), "<first_frame> is '1e99'"),
        (lambda text: text.replace("<state>2<", "<state>7<", 1), "<state> is 7, expected one of 0, 1, 2"),
        (lambda text: text.replace("<h>1.5<", "<h>0<", 1), "the box has no size"),
        (lambda text: text.replace("<objectType>Car</objectType>", "", 1), "no <objectType>"),
    ],
)
def test_tracklets_that_cant_be_used_are_skipped_alone(drive, make_tracklet, change, message):
    poses = [drive.pose.format(10, 2, -1.7, 0, 2, 0, 0)] * 3
    path = drive.write_tracklets(make_tracklet(poses), make_tracklet(poses, "Van"))
    path.write_text(change(path.read_text()))
    with pytest.raises(LogError, match=f"tracklet_labels.xml: line [0-9]+: <[a-z]+>: .*{message}"):
        drive.imported()
    found = drive.imported(skip=True)
    assert found.bad.num == 1
    assert [t.boxes3d.source_label.tolist() for t in found.truths] == [["Van"]] * 3
    assert found.truths[0].boxes3d.track_id.tolist() == [1]


def test_files_that_arent_utf8_are_refused(drive, make_tracklet):
    path = drive.write_tracklets(make_tracklet([], "Fußgänger"))
    path.write_bytes(path.read_text().encode("latin-1"))
    with pytest.raises(LogError, match=r"tracklet_labels.xml: isn't XML \(not well-formed"):
        drive.imported()


def test_boxes_need_the_place_of_the_lidar(drive):
    drive.write_tracklets()
    (drive.date / "calib_velo_to_cam.txt").unlink()
    for path in sorted((drive.folder / "velodyne_points").rglob("*.bin")):
        path.unlink()
    with pytest.raises(LogError, match=r"tracklet_labels.xml: needs calib_velo_to_cam.txt"):
        drive.imported()
