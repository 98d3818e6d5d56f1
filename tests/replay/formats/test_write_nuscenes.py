"""nuScenes submissions: what the devkit asserts of them, and boxes where they are in the world."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.replay.formats.exports import exported, flats, poses, read, run_of, solids, stamp, sweeps, write_log

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth

TOKENS = {"nuscenes.sample_tokens": "aaa bbb ccc"}
KEYFRAMES = (0, None, 1, None, 2)
WHERE_M = (400.0, 1200.0, 1.5)
TURN = Rotation.from_euler("ZYX", [1.2, 0.05, -0.02])
# Of the devkit (v1.0), eval/detection/constants.py and eval/tracking/constants.py.
DETECTED = {
    "car", "truck", "bus", "trailer", "construction_vehicle", "pedestrian", "motorcycle", "bicycle", "traffic_cone",
    "barrier",
}  # fmt: skip
TRACKED = {"bicycle", "bus", "car", "motorcycle", "pedestrian", "trailer", "truck"}
ATTRIBUTES = {
    "", "pedestrian.moving", "pedestrian.sitting_lying_down", "pedestrian.standing", "cycle.with_rider",
    "cycle.without_rider", "vehicle.moving", "vehicle.parked", "vehicle.stopped",
}  # fmt: skip


def drive(tmp_path: Path, metadata=TOKENS, has_poses=True, truths=()) -> Path:
    """Five sweeps of which three are keyframes."""
    where = poses(5, WHERE_M, TURN.as_quat()) if has_poses else []
    return write_log(tmp_path / "scene.mcap", [*sweeps(5, KEYFRAMES), *where, *truths], metadata)


def require_valid(path: Path, task: str, tokens: set[str]) -> dict[str, Any]:
    """What `load_prediction` and the classes of boxes of the devkit assert, written anew."""
    content = json.loads(path.read_text())
    assert set(content["meta"]) == {"use_camera", "use_lidar", "use_radar", "use_map", "use_external"}
    assert all(isinstance(value, bool) for value in content["meta"].values())
    assert set(content["results"]) == tokens
    for token, boxes in content["results"].items():
        assert len(boxes) <= 500
        for box in boxes:
            assert box["sample_token"] == token
            for name, num in (("translation", 3), ("size", 3), ("rotation", 4), ("velocity", 2)):
                assert len(box[name]) == num
                assert all(isinstance(v, float) and math.isfinite(v) for v in box[name])
            assert abs(np.linalg.norm(box["rotation"]) - 1) < 1e-6
            assert min(box["size"]) > 0
            assert isinstance(box[f"{task}_score"], float)
            assert 0 <= box[f"{task}_score"] <= 1
            if task == "detection":
                assert box["detection_name"] in DETECTED
                assert box["attribute_name"] in ATTRIBUTES
            else:
                assert box["tracking_name"] in TRACKED
                assert isinstance(box["tracking_id"], str)
    return content


def test_a_submission_holds_all_samples_and_no_sweeps(tmp_path):
    run = run_of(drive(tmp_path), lambda i: solids([10.0] if i in (1, 2) else [], score=[0.5] if i in (1, 2) else []))
    done = exported("nuscenes", tmp_path / "out.json", run)
    content = require_valid(tmp_path / "out.json", "detection", {"aaa", "bbb", "ccc"})
    assert [len(boxes) for boxes in content["results"].values()] == [0, 1, 0]
    assert (done.num_rows, done.num_frames, done.view) == (1, 3, "3D boxes in the world")


def test_where_boxes_are_in_the_world(tmp_path):
    velocity = np.array([[3.0, -0.5, 0.0]])
    boxes = replace(solids([10.0], score=[0.25]), yaw_rad=np.array([0.7]), velocity_mps=velocity)
    exported("nuscenes", tmp_path / "out.json", run_of(drive(tmp_path), lambda i: boxes))
    box = require_valid(tmp_path / "out.json", "detection", {"aaa", "bbb", "ccc"})["results"]["aaa"][0]
    np.testing.assert_allclose(box["translation"], np.array(WHERE_M) + TURN.apply([10, 0, 0]), atol=1e-6)
    np.testing.assert_allclose(box["velocity"], TURN.apply(velocity[0])[:2], atol=1e-6)
    assert box["size"] == [1.8, 4.0, 1.5]
    w, x, y, z = box["rotation"]
    turn = Rotation.from_quat([x, y, z, w])
    assert (turn.inv() * TURN * Rotation.from_euler("Z", 0.7)).magnitude() < 1e-11
    assert (box["detection_name"], box["detection_score"], box["attribute_name"]) == ("car", 0.25, "vehicle.moving")


def test_results_are_read_back(tmp_path):
    rng = np.random.default_rng(2)
    boxes = Boxes3D(
        rng.uniform(-40, 40, (6, 3)), rng.uniform(0.5, 9, (6, 3)), rng.uniform(-3, 3, 6), score=rng.random(6),
        velocity_mps=rng.normal(size=(6, 3)), track_id=np.arange(6),
        label=np.array(["car", "truck", "bus", "trailer", "pedestrian", "bicycle"]),
    )  # fmt: skip
    exported("nuscenes-tracking", tmp_path / "out.json", run_of(drive(tmp_path), lambda i: boxes))
    require_valid(tmp_path / "out.json", "tracking", {"aaa", "bbb", "ccc"})
    (tmp_path / "samples.csv").write_text("token,stamp_ns\naaa,1\nbbb,2\nccc,3\n")
    for truth in read(tmp_path / "out.json", "nuscenes"):
        got = truth.boxes3d
        assert truth.in_world
        np.testing.assert_allclose(got.center_m, TURN.apply(boxes.center_m.copy()) + WHERE_M, atol=2e-6)
        np.testing.assert_allclose(got.size_lwh_m, boxes.size_lwh_m, atol=1e-6)
        angles = np.stack([got.yaw_rad, got.pitch_rad, got.roll_rad], axis=1)
        wanted = TURN * Rotation.from_euler("Z", boxes.yaw_rad[:, None])
        assert (Rotation.from_euler("ZYX", angles).inv() * wanted).magnitude().max() < 1e-11
        assert got.track_id.tolist() == list(range(6))
        assert got.label.tolist() == boxes.label.tolist()


def test_truth_keeps_the_sets_own_classes_and_attributes(tmp_path):
    names = [
        "vehicle.construction", "movable_object.trafficcone", "human.pedestrian.wheelchair", "vehicle.car",
        "human.pedestrian.child", "animal",
    ]  # fmt: skip
    labels = ["other", "other", "pedestrian", "car", "pedestrian", "other"]
    told = ["vehicle.parked", "", "", "vehicle.stopped", "nonsense", ""]
    boxes = replace(solids([10.0 * i for i in range(1, 7)], source_label=names, attribute=told), label=np.array(labels))
    log = drive(tmp_path, truths=[Truth(stamp(0), stamp(0), boxes, None, 0)])
    done = exported("nuscenes", tmp_path / "out.json", log)
    results = require_valid(tmp_path / "out.json", "detection", {"aaa", "bbb", "ccc"})["results"]["aaa"]
    assert [(box["detection_name"], box["attribute_name"]) for box in results] == [
        ("construction_vehicle", "vehicle.parked"), ("traffic_cone", ""), ("car", "vehicle.stopped"),
        ("pedestrian", ""),
    ]  # fmt: skip
    assert done.left_out == {"of classes that nuScenes doesn't score": 2}


def test_attributes_follow_from_speed(tmp_path):
    labels = ["car", "bus", "pedestrian", "bicycle", "car", "car"]
    speeds = np.array([[0.1, 0, 0], [0, 0.1, 0], [0.5, 0, 0], [0, 0.1, 0], [0.15, 0.15, 0], [np.nan, np.nan, np.nan]])
    boxes = replace(solids([10.0 * i for i in range(1, 7)]), label=np.array(labels), velocity_mps=speeds)
    exported("nuscenes", tmp_path / "out.json", run_of(drive(tmp_path), lambda i: boxes))
    results = require_valid(tmp_path / "out.json", "detection", {"aaa", "bbb", "ccc"})["results"]["bbb"]
    assert [box["attribute_name"] for box in results] == [
        "vehicle.parked", "vehicle.stopped", "pedestrian.moving", "cycle.without_rider", "vehicle.moving", "",
    ]  # fmt: skip
    assert results[5]["velocity"] == [0.0, 0.0]


def test_only_the_best_500_stay_in_their_order(tmp_path):
    scores = np.random.default_rng(3).permutation(600) / 600
    run = run_of(drive(tmp_path), lambda i: solids(range(10, 610), score=scores) if i == 0 else solids([]))
    done = exported("nuscenes", tmp_path / "out.json", run)
    results = require_valid(tmp_path / "out.json", "detection", {"aaa", "bbb", "ccc"})["results"]["aaa"]
    np.testing.assert_allclose([box["detection_score"] for box in results], scores[scores >= 100 / 600], atol=1e-6)
    assert done.left_out == {"beyond the 500 of a sample with the highest scores": 100}


def test_sensors_that_were_used(tmp_path):
    log = drive(tmp_path)

    def meta(sources: int | None) -> set[str]:
        boxes = solids([10.0]) if sources is None else solids([10.0], sources=np.array([sources], np.uint8))
        exported("nuscenes", tmp_path / "out.json", run_of(log, lambda i: boxes), overwrite=True)
        return {k.removeprefix("use_") for k, v in json.loads((tmp_path / "out.json").read_text())["meta"].items() if v}

    assert meta(2) == {"lidar"}
    assert meta(1 | 4) == {"camera", "radar"}
    assert meta(None) == {"camera", "lidar"}  # all that the pipeline got


def test_several_scenes_make_one_submission(tmp_path):
    runs = []
    for name, tokens in (("b", "ddd eee fff"), ("a", "aaa bbb ccc")):
        (tmp_path / name).mkdir()
        log = drive(tmp_path / name, {"nuscenes.sample_tokens": tokens}).rename(tmp_path / f"{name}.mcap")
        runs.append(run_of(log, lambda i: solids([10.0])))
    exported("nuscenes", tmp_path / "out.json", *runs)
    content = require_valid(tmp_path / "out.json", "detection", {"aaa", "bbb", "ccc", "ddd", "eee", "fff"})
    assert sum(map(len, content["results"].values())) == 6


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({}, "no nuScenes sample tokens"),
        ({"nuscenes.sample_tokens": "aaa aaa bbb"}, "a sample token is twice"),
        ({"nuscenes.sample_tokens": "aaa bbb"}, "keyframe 2 has no sample token, there are 2"),
    ],
)
def test_tokens_that_do_not_fit(tmp_path, metadata, message):
    with pytest.raises(LogError, match=message):
        exported("nuscenes", tmp_path / "out.json", run_of(drive(tmp_path, metadata), lambda i: solids([10.0])))
    assert [path.name for path in tmp_path.iterdir() if "out" in path.name] == []


def test_poses_are_needed(tmp_path):
    run = run_of(drive(tmp_path, has_poses=False), lambda i: solids([10.0]))
    with pytest.raises(LogError, match="no pose of the body is known"):
        exported("nuscenes", tmp_path / "out.json", run)


def test_a_redacted_run_tells_no_tokens(tmp_path):
    run = run_of(drive(tmp_path), lambda i: solids([10.0]), redact=True)
    with pytest.raises(LogError, match="runs without --redact"):
        exported("nuscenes", tmp_path / "out.json", run)


def test_boxes_in_images_cannot_be_submitted(tmp_path):
    with pytest.raises(LogError, match="nuScenes scores boxes in 3D"):
        exported("nuscenes", tmp_path / "out.json", run_of(drive(tmp_path), lambda i: flats(1)))


@pytest.mark.filterwarnings("error")
def test_numbers_beyond_all_reason_stay_out(tmp_path):
    """Rounding them would give infinity, which JSON lacks."""
    speeds = [[1e306, 0, 0], [np.inf, 0, 0], [1.0, 2, 0]]
    boxes = solids([10.0, 20, 30], score=[1e305, 0.5, 0.25], velocity_mps=speeds)
    far = write_log(
        tmp_path / "far.mcap", [*sweeps(3, (0, 1, 2)), *poses(3, [1e306, 0, 0], [0, 0, 0, 1]),
                                Truth(stamp(0), stamp(0), boxes)], TOKENS
    )  # fmt: skip
    here = drive(tmp_path, truths=[Truth(stamp(0), stamp(0), boxes)])
    assert exported("nuscenes", tmp_path / "out.json", here).left_out == {"not finite": 2}
    results = require_valid(tmp_path / "out.json", "detection", {"aaa", "bbb", "ccc"})["results"]["aaa"]
    assert len(results) == 1
    assert math.hypot(*results[0]["velocity"]) == pytest.approx(5**0.5, rel=0.01)
    with pytest.raises(LogError, match="no pose of the body is known"):  # a pose so far away is none
        exported("nuscenes", tmp_path / "far.json", far)
