"""nuScenes submissions: by hand, and the boxes of a real key frame."""

import json

import numpy as np
import pytest
from tests.replay.formats.box_files import form, read

from fbench.replay.contracts.errors import FbenchError, LimitError, LogError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.formats.nuscenes import parse_box, to_box_columns
from fbench.replay.formats.open import results_entry, truth_entry
from fbench.replay.formats.text import digest_of
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import inverse, quaternion
from fbench.replay.logs.setup import BoxSource

BOX = {
    "sample_token": "abc", "translation": [10, 20, 1], "size": [2, 4, 1.5],
    "rotation": [np.cos(0.3), 0, 0, np.sin(0.3)], "velocity": [3, -1],
    "detection_name": "car", "detection_score": 0.5, "attribute_name": "vehicle.moving",
}  # fmt: skip


def submission(folder, results, **companions):
    (folder / "results.json").write_text(json.dumps({"meta": {"use_lidar": True}, "results": results}))
    for name, text in companions.items():
        (folder / name.replace("_", ".")).write_text(text)
    return folder / "results.json"


def test_boxes_by_hand(tmp_path):
    table = json.dumps([{"token": "abc", "timestamp": 1532402927647951, "prev": ""}, {"token": "d", "timestamp": 1}])
    path = submission(tmp_path, {"abc": [BOX], "d": []}, sample_json=table)
    assert form(path) == "nuscenes"
    empty, truth = read(path)
    assert (empty.stamp_ns, len(empty.boxes3d)) == (1000, 0)
    assert (truth.stamp_ns, truth.in_world, truth.boxes2d) == (1532402927647951000, True, None)
    boxes = truth.boxes3d
    assert (boxes.center_m.tolist(), boxes.size_lwh_m.tolist()) == ([[10, 20, 1]], [[4, 2, 1.5]])
    np.testing.assert_allclose(boxes.yaw_rad, [0.6], atol=1e-15)
    assert (boxes.velocity_mps.tolist(), boxes.score.tolist()) == ([[3, -1, 0]], [0.5])
    assert (boxes.label.tolist(), boxes.attribute.tolist()) == (["car"], ["vehicle.moving"])


def test_tracks_and_tokens_that_are_frames_or_stamps(tmp_path):
    track = {**BOX, "tracking_name": "truck", "tracking_id": "17", "tracking_score": 0.25}
    path = submission(tmp_path, {"12": [track], "3": []})
    empty, truth = read(path)
    assert (empty.frame_index, truth.frame_index, truth.frame_number, truth.stamp_ns) == (3, 12, 12, 0)
    assert (truth.boxes3d.label.tolist(), truth.boxes3d.track_id.tolist()) == (["truck"], [17])
    [truth] = read(submission(tmp_path, {"1532402927647951000": [BOX]}))
    assert (truth.frame_index, truth.stamp_ns) == (None, 1532402927647951000)
    [truth] = read(submission(tmp_path, {"abc": [BOX]}, samples_csv="token,stamp_ns\nabc,77\n"))
    assert truth.stamp_ns == 77


def test_what_a_submission_is_read_with_is_part_of_its_digest(tmp_path):
    path = submission(tmp_path, {"abc": [BOX]}, samples_csv="token,stamp_ns\nabc,77\n")
    source = BoxSource(path)
    before = truth_entry(source)
    (tmp_path / "samples.csv").write_text("token,stamp_ns\nabc,78\n")
    after = truth_entry(source)
    assert (before.name, before.format) == (after.name, after.format) == ("results.json", "nuscenes")
    assert len({before.digest, after.digest, results_entry(source).digest}) == 2
    (tmp_path / "samples.csv").unlink()
    assert truth_entry(source).digest == digest_of(path)


def test_scores_that_no_float_holds_are_what_a_single_box_has():
    box, where = {**BOX, "detection_score": 10**400}, "results.json: sample 'abc' box 0"
    columns = to_box_columns([(where, box)], [0])
    assert columns["score"].tolist() == [parse_box(box, where).score]
    with pytest.raises(LogError, match="score: expected a number"):
        to_box_columns([(where, {**BOX, "detection_score": "high"})], [0])


@pytest.mark.parametrize(
    ("results", "match"),
    [
        ({"abc": [BOX]}, "when was sample 'abc'. put sample.json or samples.csv beside the file"),
        ({}, "no results; expected an object with 'results' by sample token"),
        ([1], "results: expected an object, got a list of 1"),
        ({"1": 5}, "sample '1': expected a list, got a number"),
        ({"1": [{**BOX, "size": [1, 2]}]}, "sample '1' box 0: size: expected 3 numbers, got a list of 2"),
        ({"1": [{**BOX, "size": [1, 2, "x"]}]}, "size: expected a number, got a text"),
        ({"1": [{**BOX, "rotation": [0, 0, 0, 0]}]}, "rotation: rotation is the quaternion 0 0 0 0"),
        ({"1": [{"translation": [1, 2, 3]}]}, "neither detection_name nor tracking_name"),
        ({"1": [{**BOX, "tracking_id": 4}, {**BOX, "tracking_id": 4}]}, "id 4 twice at frame 1"),
    ],
)
def test_bad_submissions_name_the_box(tmp_path, results, match):
    with pytest.raises(FbenchError, match=match):
        read(submission(tmp_path, results))


def test_bad_json(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"results": ')
    with pytest.raises(FbenchError, match="isn't JSON"):
        read(path)
    path.write_text('{"results": ' + "[" * 200_000 + "]" * 200_000 + "}")
    with pytest.raises(LimitError, match="nested too deeply"):
        read(path)
    path.write_text('{"results": {"1": [{"translation": [' + "9" * 5000 + "]}]}}")
    with pytest.raises(FbenchError, match="isn't JSON"):
        read(path)
    with path.open("wb") as file:
        file.write(b'{"results": ')
        file.truncate(300 * 2**20)
    with pytest.raises(LimitError, match="300 MiB of JSON, more than 256"):
        read(path)
    with pytest.raises(FbenchError, match=r"samples.csv: expected the columns token and stamp_ns"):
        read(submission(tmp_path, {"abc": [BOX]}, samples_csv="name\nabc\n"))


def test_a_real_frame_survives_the_way_through_the_world(tmp_path, shared):
    """Boxes of the LiDAR's coordinate frame, written as a submission and moved back with the pose."""
    frame = json.loads((shared / "data/nuscenes_frame/frame.json").read_text())
    world_T_lidar = np.array(frame["ego2global"]) @ np.array(frame["lidar_points"]["lidar2ego"])
    told = np.array([item["bbox_3d"] for item in frame["instances"]])
    local = Boxes3D(told[:, :3] + [0, 0, 0.5] * told[:, 5:6], told[:, 3:6], told[:, 6])
    world = move_boxes(local, world_T_lidar)
    rows = [
        {"translation": c.tolist(), "size": [s[1], s[0], s[2]], "detection_name": "car", "detection_score": -1.0,
         "rotation": np.roll(rotation(y, p, r), 1).tolist()}
        for c, s, y, p, r in zip(world.center_m, world.size_lwh_m, world.yaw_rad, world.pitch_rad, world.roll_rad,
                                 strict=True)
    ]  # fmt: skip
    [truth] = read(submission(tmp_path, {"0": rows}))
    back = move_boxes(truth.boxes3d, inverse(world_T_lidar))
    np.testing.assert_allclose(back.center_m, local.center_m, atol=1e-6)
    np.testing.assert_allclose(np.sin(back.yaw_rad - local.yaw_rad), 0, atol=1e-6)
    np.testing.assert_allclose([back.pitch_rad, back.roll_rad], 0, atol=1e-6)


def rotation(yaw, pitch, roll):
    from scipy.spatial.transform import Rotation

    return quaternion(Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix())
