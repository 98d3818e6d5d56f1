"""OpenLABEL files by hand-checked values, and what is meant ill."""

import json

import numpy as np
import pytest
from tests.replay.formats.box_files import S, form, read

from fbench.replay.contracts.errors import FbenchError, LimitError
from fbench.replay.contracts.faults import FaultLog

TURN = [0, 0, float(np.sin(0.3)), float(np.cos(0.3))]
CUBOID = {"name": "shape", "val": [1, 2, 3, *TURN, 4, 2, 1.5]}
SYSTEMS = {
    "utm": {"type": "geo_utm", "parent": "", "children": ["vehicle-iso8855"]},
    "vehicle-iso8855": {"type": "local_cs", "parent": "utm", "children": ["roof"]},
    "roof": {"type": "sensor_cs", "parent": "vehicle-iso8855", "children": [],
             "pose_wrt_parent": {"translation": [1, 0, 2], "quaternion": [0, 0, 0, 1]}},
    "tilted": {"type": "sensor_cs", "parent": "roof",
               "pose_wrt_parent": {"translation": [0, 0, 0], "euler_angles": [0, 0, np.pi / 2], "sequence": "zyx"}},
    "rows": {"type": "sensor_cs", "parent": "roof",
             "pose_wrt_parent": {"matrix4x4": [0, -1, 0, 5, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}},
    "a": {"type": "x", "parent": "b", "pose_wrt_parent": {"translation": [0, 0, 0], "quaternion": [0, 0, 0, 1]}},
    "b": {"type": "x", "parent": "a", "pose_wrt_parent": {"translation": [0, 0, 0], "quaternion": [0, 0, 0, 1]}},
}  # fmt: skip


def frame(objects, timestamp=None, **properties):
    told = {**({} if timestamp is None else {"timestamp": timestamp}), **properties}
    return {"frame_properties": told, "objects": {uid: {"object_data": data} for uid, data in objects.items()}}


def written(folder, frames, **more):
    root = {"metadata": {"schema_version": "1.0.0"}, "frames": frames, **more}
    (folder / "labels.json").write_text(json.dumps({"openlabel": root}))
    return folder / "labels.json"


def one(folder, data, **more):
    return read(written(folder, {"0": frame({"u": data}, **more.pop("properties", {}))}, **more))[0]


def placed(folder, system, **more):
    data = {"cuboid": [{**CUBOID, "coordinate_system": system}]}
    return one(folder, data, coordinate_systems=SYSTEMS, **more)


def test_objects_by_hand(tmp_path):
    num = [{"name": "score", "val": 0.9}, {"name": "num_points", "val": 12}, {"name": "age", "val": 3}]
    frames = {
        "7": frame({"42": {"cuboid": [{**CUBOID, "attributes": {"num": num}}], "bbox": [{"val": [50, 40, 20, 10]}]},
                    "b9d1": {"cuboid": {**CUBOID, "val": [1, 2, 3, 0.1, 0.2, 0.3, 4, 2, 1]}}}, 1608294055.2986164),
        "8": frame({}, "1631702348.299745001"),
    }  # fmt: skip
    path = written(tmp_path, frames, objects={"42": {"name": "car1", "type": "Car"}, "b9d1": {"type": "Person"}})
    assert form(path) == "openlabel"
    first, second = read(path)
    assert (first.stamp_ns, first.frame_index) == (1608294055298616400, None)
    assert (second.stamp_ns, len(second.boxes3d), len(second.boxes2d)) == (1631702348299745001, 0, 0)
    boxes = first.boxes3d
    assert boxes.center_m.tolist() == [[1, 2, 3], [1, 2, 3]]
    assert boxes.size_lwh_m.tolist() == [[4, 2, 1.5], [4, 2, 1]]
    np.testing.assert_allclose(boxes.yaw_rad, [0.6, 0.3])
    np.testing.assert_allclose([boxes.pitch_rad, boxes.roll_rad], [[0, 0.2], [0, 0.1]], atol=1e-15)
    assert (boxes.label.tolist(), boxes.source_label.tolist()) == (["car", "pedestrian"], ["Car", "Person"])
    assert (boxes.score[0], boxes.num_lidar_pts.tolist()) == (0.9, [12, -1])
    assert boxes.track_id[0] == 42
    assert boxes.track_id[1] > 2**62
    assert first.boxes2d.xyxy_px.tolist() == [[40, 35, 60, 45]]
    assert (first.boxes2d.camera.tolist(), first.boxes2d.track_id.tolist()) == (["cam"], [42])


def test_frames_without_timestamps_are_counted(tmp_path):
    first, second = read(written(tmp_path, {"10": frame({"u": {"cuboid": [CUBOID]}}), "9": frame({})}))
    assert (first.frame_index, first.frame_number, second.frame_index) == (9, 9, 10)
    assert (first.stamp_ns, len(first.boxes3d), first.boxes2d) == (0, 0, None)


@pytest.mark.parametrize(
    ("told", "stamp_ns"),
    [
        (1.5, 1_500_000_000), ("1.5", 1_500_000_000), (1608294055298, 1608294055298 * 1_000_000),
        (1608294055298616, 1608294055298616_000), ("1608294055298616400", 1608294055298616400),
        ("2020-12-18T12:20:55.298616400Z", 1608294055298616400), ("2020-12-18 12:20:55", 1608294055 * S),
    ],
)  # fmt: skip
def test_times(tmp_path, told, stamp_ns):
    [truth] = read(written(tmp_path, {"0": frame({"u": {"cuboid": [CUBOID]}}, told)}))
    assert truth.stamp_ns == stamp_ns


@pytest.mark.parametrize(
    ("system", "center", "yaw"),
    [
        ("", [1, 2, 3], 0.6), ("body", [1, 2, 3], 0.6), ("vehicle-iso8855", [1, 2, 3], 0.6),
        ("roof", [2, 2, 5], 0.6), ("tilted", [1 - 2, 1, 5], 0.6 + np.pi / 2),
        ("rows", [1 - 2 + 5, 1, 5], 0.6 + np.pi / 2),
        ("lidar", [1 - 2, 1, 5], 0.6 + np.pi / 2),
    ],
)  # fmt: skip
def test_coordinate_systems(tmp_path, system, center, yaw):
    truth = placed(tmp_path, system)
    np.testing.assert_allclose(truth.boxes3d.center_m, [center], atol=1e-12)
    np.testing.assert_allclose(truth.boxes3d.yaw_rad, [yaw], atol=1e-12)
    assert not truth.in_world


def test_boxes_in_the_world(tmp_path):
    """They stay there, unless the file says where the body was."""
    truth = placed(tmp_path, "utm")
    assert (truth.in_world, truth.boxes3d.center_m.tolist()) == (True, [[1, 2, 3]])
    move = {"src": "vehicle-iso8855", "dst": "utm",
            "transform_src_to_dst": {"translation": [1, 0, 0], "quaternion": [0, 0, 0.5**0.5, 0.5**0.5]}}  # fmt: skip
    truth = placed(tmp_path, "utm", properties={"transforms": {"vehicle_to_utm": move}})
    assert not truth.in_world
    np.testing.assert_allclose(truth.boxes3d.center_m, [[2, 0, 3]], atol=1e-12)
    np.testing.assert_allclose(truth.boxes3d.yaw_rad, [0.6 - np.pi / 2], atol=1e-12)
    both = {"cuboid": [{**CUBOID, "coordinate_system": name} for name in ("utm", "roof")]}
    with pytest.raises(FbenchError, match="boxes in the world and on the body at one instant"):
        one(tmp_path, both, coordinate_systems=SYSTEMS)


def test_a_system_that_leads_nowhere_is_what_the_user_names(tmp_path):
    data = {"cuboid": [{**CUBOID, "coordinate_system": "velodyne"}]}
    with pytest.raises(FbenchError, match="coordinate frame 'velodyne' isn't in the log"):
        one(tmp_path, data)
    [truth] = read(tmp_path / "labels.json", frame="lidar", camera="lidar")
    np.testing.assert_allclose(truth.boxes3d.center_m, [[-1, 1, 5]], atol=1e-12)


def test_cameras(tmp_path):
    data = {"bbox": [{"val": [5, 5, 2, 2], "coordinate_system": "rgb"}]}
    [truth] = read(
        written(tmp_path, {"0": frame({"u": data})}, streams={"rgb": {"type": "camera", "uri": "/cam/image"}})
    )
    assert truth.boxes2d.camera.tolist() == ["cam"]
    with pytest.raises(FbenchError, match="'rgb' is no camera of the log; there are: cam"):
        one(tmp_path, data)
    [truth] = read(tmp_path / "labels.json", camera="cam")
    assert truth.boxes2d.camera.tolist() == ["cam"]


def test_what_is_no_box_is_counted(tmp_path):
    data = {"cuboid": [CUBOID], "poly2d": [{"val": [1, 2]}], "bbox": [{"val": [5, 5, 2, 2], "coordinate_system": "r"}]}
    path = written(tmp_path, {str(i): frame({"u": data}) for i in range(3)}, streams={"r": {"type": "radar"}})
    faults = FaultLog()
    truths = read(path, faults=faults)
    assert [len(t.boxes3d) for t in truths] == [1, 1, 1]
    assert dict(faults.counts) == {"GT005": 2}


@pytest.mark.parametrize(
    ("frames", "match"),
    [
        ({}, "no frames; boxes that belong to no frame can't be scored"),
        ([], "frames: expected an object, got a list of 0"),
        ({"x": frame({})}, "frame 'x': frame is 'x', expected a whole number"),
        ({"9" * 30: frame({})}, "expected 0 to 9999999"),
        ({"0": frame({}, 1), "1": frame({})}, "some frames have a timestamp and some don't"),
        ({"0": frame({}, "soon")}, "frame '0': timestamp 'soon' is no time"),
        ({"0": frame({}, 1e300)}, "timestamp '1e[+]300' is no time"),
        ({"0": frame({}, [1])}, "timestamp: expected a number, got a list of 1"),
        ({"0": frame({"u": {"cuboid": [{"val": [1, 2, 3]}]}})}, "object 'u' cuboid 0: val: expected 9 or 10 numbers"),
        ({"0": frame({"u": {"cuboid": [{"val": [1, 2, 3, 0, 0, 0, 0, 1, 1, 1]}]}})}, "rotation is the quaternion 0"),
        ({"0": frame({"u": {"cuboid": "big"}})}, "cuboid: expected a list, got a text"),
        ({"0": frame({"u": {"cuboid": [CUBOID, CUBOID]}})}, "twice at frame 0"),
        ({"0": 5}, "frame '0': expected an object, got a number"),
    ],
)
def test_bad_files_name_the_place(tmp_path, frames, match):
    with pytest.raises(FbenchError, match=match):
        read(written(tmp_path, frames))


@pytest.mark.parametrize(
    ("system", "match"),
    [
        ({"parent": "body", "pose_wrt_parent": {"matrix4x4": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1]}},
         "coordinate system 's': is no rigid transform"),
        ({"parent": "body", "pose_wrt_parent": {"translation": [0, 0, 0], "quaternion": [0, 0, 0, 0]}}, "no valid rot"),
        ({"parent": "body", "pose_wrt_parent": {"translation": [0, 0, 0], "euler_angles": [0, 0, 0], "sequence": "q"}},
         "sequence is 'q'"),
        ({"parent": "body", "pose_wrt_parent": {"translation": [0, 0]}}, "translation: expected 3 numbers"),
    ],
)  # fmt: skip
def test_bad_transforms_name_the_system(tmp_path, system, match):
    with pytest.raises(FbenchError, match=match):
        one(tmp_path, {"cuboid": [{**CUBOID, "coordinate_system": "s"}]}, coordinate_systems={"s": system})


def test_bombs(tmp_path):
    """Loops, nesting, and intervals over more frames than there are."""
    with pytest.raises(FbenchError, match="coordinate systems form a loop at 'a'"):
        placed(tmp_path, "a")
    path = tmp_path / "labels.json"
    path.write_text('{"openlabel": ' + '{"frames": ' * 100_000 + "1" + "}" * 100_001)
    with pytest.raises(LimitError, match="nested too deeply"):
        read(path)
    path = written(tmp_path, {"0": frame({"u": {"cuboid": [CUBOID]}})},
                   frame_intervals=[{"frame_start": 0, "frame_end": 10**15}])  # fmt: skip
    assert len(read(path)) == 1
    chain = {f"s{i}": {"parent": f"s{i + 1}", "pose_wrt_parent": {"translation": [1, 0, 0], "quaternion": [0, 0, 0, 1]}}
             for i in range(2000)}  # fmt: skip
    truth = one(tmp_path, {"cuboid": [{**CUBOID, "coordinate_system": "s0"}]},
                coordinate_systems={**chain, "s2000": {"type": "local", "parent": ""}})  # fmt: skip
    assert truth.boxes3d.center_m.tolist() == [[2001, 2, 3]]
