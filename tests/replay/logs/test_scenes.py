"""Scenes that other programs made for viewers, in Protobuf and in ROS."""

import numpy as np
import pytest
from foxglove_schemas_protobuf.Pose_pb2 import Pose as PoseProto
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, STAMP, STAMP_NS, Ros
from tests.replay.logs.test_foreign import edge, log, packed

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.open import open_log
from fbench.replay.logs.setup import BoxSource, Setup

HALF = 2**-0.5
POINTS = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])


def scene(*entities):
    """Entities as id, place, metadata and more."""
    found = SceneUpdate()
    for id_, xyz, metadata, more in entities:
        entity = found.entities.add(id=id_, frame_id=more.get("frame", "base_link"), timestamp=Timestamp(seconds=5))
        for key, value in metadata.items():
            entity.metadata.add(key=key, value=value)
        for text in more.get("texts", ()):
            entity.texts.add(text=text)
        pose = PoseProto(position=Vector3(**dict(zip("xyz", xyz, strict=True))), orientation=Quaternion(z=HALF, w=HALF))
        for _ in range(more.get("cubes", 1)):
            entity.cubes.add(pose=pose, size=Vector3(x=4, y=2, z=1.5))
    return found


def boxes(tmp_path, *entities, topic="/ground_truth"):
    reader, faults = log(
        tmp_path, ("/tf_static", edge("base_link", "lidar", (1, 0, 0))), ("/points", POINTS), (topic, scene(*entities))
    )
    [truth] = reader.truths() if topic == "/ground_truth" else reader.detections(topic)
    assert truth.stamp_ns == 5_000_000_000
    assert not faults.num_lost
    return truth.boxes3d


S = 1_000_000_000


def moved(tmp_path, frame="lidar", topic="/ground_truth", late_s=0):
    """From 5.5 s on, the LiDAR is 4 m farther ahead, and so is what someone labels in. Boxes of 5 s and 6 s, which lie
    10 m ahead in `frame`, are recorded `late_s` later.
    """
    parts: list[tuple[float, str, Message]] = []
    for second, ahead in ((5, 1), (6, 5)):
        start = 0 if second == 5 else 5.5
        parts += [(start, "/tf_static", edge("base_link", name, (ahead, 0, 0))) for name in ("lidar", "labeler")]
        cubes = scene(("a", (10, 0, 1), {}, {"frame": frame}))
        cubes.entities[0].timestamp.seconds = second
        parts += [(second, "/points", POINTS), (second, "/points2", POINTS), (second + late_s, topic, cubes)]
    with (tmp_path / "log.mcap").open("wb") as file, Writer(file) as writer:
        for at_s, name, message in sorted(parts, key=lambda part: part[0]):
            writer.write_message(name, message, log_time=round(at_s * S), publish_time=round(at_s * S))


@pytest.mark.parametrize("late_s", [0, 0.9, 30])
@pytest.mark.parametrize(("frame", "along"), [("lidar", [11, 15]), ("labeler", [11, 15]), ("base_link", [10, 10])])
def test_boxes_in_a_coordinate_frame_that_moves_are_where_it_is_at_their_stamp(tmp_path, frame, along, late_s):
    for topic, left_out in (("/ground_truth", ()), ("/my_stack/objects", ()), ("/ground_truth", ("!/points",))):
        moved(tmp_path, frame, topic, late_s)
        faults = FaultLog()
        reader = open_log(tmp_path / "log.mcap", faults, left_out)
        found = list(reader.truths() if topic == "/ground_truth" else reader.detections(topic))
        assert [truth.boxes3d.center_m[0, 0] for truth in found] == along
        assert not faults.num_lost


def test_boxes_of_a_file_in_a_coordinate_frame_that_moves_are_refused(tmp_path):
    moved(tmp_path)
    (tmp_path / "a.csv").write_text("stamp_ns,x,y,z,length,width,height,yaw\n1,10,0,1,4,2,1.5,0\n")
    for frame in ("lidar", "points", "points2", "body", "base_link"):
        setup = Setup(truth=BoxSource(tmp_path / "a.csv", frame=frame))
        reader = open_log(tmp_path / "log.mcap", FaultLog(), setup=setup)
        if frame not in ("body", "base_link"):
            with pytest.raises(LogError, match=rf"boxes in '{frame}', which moves on the body within the log; give"):
                list(reader.truths())
        else:
            assert [truth.boxes3d.center_m.tolist() for truth in reader.truths()] == [[[10, 0, 1]]]


@pytest.mark.parametrize("topic", ["/ground_truth", "/my_stack/objects"])
def test_cubes_are_boxes(tmp_path, topic):
    words = {"Class Name": "vehicle.car", "Confidence": "0.75", "track-id": "41", "velocity": "[1.5, -2]"}
    found = boxes(tmp_path, ("a", (10, 20, 1), words, {}), topic=topic)
    assert found.center_m.tolist() == [[10, 20, 1]]
    assert found.size_lwh_m.tolist() == [[4, 2, 1.5]]
    np.testing.assert_allclose(found.yaw_rad, [np.pi / 2])
    assert (found.label.tolist(), found.source_label.tolist()) == (["car"], ["vehicle.car"])
    assert (found.score.tolist(), found.track_id.tolist()) == ([0.75], [41])
    assert found.velocity_mps.tolist() == [[1.5, -2, 0]]


@pytest.mark.parametrize(
    ("id_", "metadata", "texts", "label", "source"),
    [
        ("7", {"category": "Bus"}, ["car 0.9"], "bus", "Bus"),
        ("7", {}, ["pedestrian 0.93"], "pedestrian", "pedestrian"),
        ("truck_7", {}, [], "truck", "truck"),
        ("rickshaw #12", {}, [], "other", "rickshaw"),
        ("3f2a-77bc", {}, [], "", ""),
        ("12", {}, ["0.93"], "", ""),
    ],
)
def test_classes(tmp_path, id_, metadata, texts, label, source):
    found = boxes(tmp_path, (id_, (0, 0, 0), metadata, {"texts": texts}))
    assert (found.label.tolist(), found.source_label.tolist()) == ([label], [source])


@pytest.mark.parametrize(
    ("ids", "expected"),
    [
        (("7", "8"), [7, 8]), (("car_7", "van-008"), [7, 8]), (("car", "van"), None), (("car 1", "van"), None),
        (("1.5", "2.5"), None),
    ],
)  # fmt: skip
def test_tracks_by_the_ids_of_entities(tmp_path, ids, expected):
    found = boxes(tmp_path, *((id_, (0, 0, 0), {}, {}) for id_ in ids)).track_id
    assert (None if found is None else found.tolist()) == expected


def test_uuids_are_tracks(tmp_path):
    ids = ("6f9619ff-8b86-d011-b42d-00c04fc964ff", "6F9619FF-8B86-D011-B42D-00C04FC964FE")
    found = boxes(tmp_path, *((id_, (0, 0, 0), {}, {}) for id_ in ids)).track_id
    (tmp_path / "again").mkdir()
    again = boxes(tmp_path / "again", *((id_.lower(), (0, 0, 0), {}, {}) for id_ in ids[::-1])).track_id
    assert found.tolist() == again.tolist()[::-1]
    (tmp_path / "cubes").mkdir()
    twice = boxes(tmp_path / "cubes", (ids[0], (0, 0, 0), {}, {"cubes": 2}))
    assert (len(twice), twice.track_id) == (2, None)


@pytest.mark.parametrize(
    ("metadata", "velocity"),
    [
        ({"vx": "1", "vy": "2"}, [1, 2, 0]), ({"velocity.x": "1", "velocity.y": "2", "velocity.z": "3"}, [1, 2, 3]),
        ({"speed": "3"}, [0, 3, 0]), ({"velocity": "fast"}, None), ({"velocity": "1"}, None),
    ],
)  # fmt: skip
def test_velocities(tmp_path, metadata, velocity):
    found = boxes(tmp_path, ("1", (0, 0, 0), metadata, {})).velocity_mps
    if velocity is None:
        assert found is None
    else:
        np.testing.assert_allclose(found, [velocity], atol=1e-12)


def test_what_only_some_entities_say(tmp_path):
    found = boxes(tmp_path, ("a", (0, 0, 0), {"score": "0.5", "vx": "1", "vy": "0"}, {}), ("b", (0, 0, 0), {}, {}))
    assert found.score is None
    assert np.isnan(found.velocity_mps).tolist() == [[False] * 3, [True] * 3]


def test_entities_in_several_coordinate_frames(tmp_path):
    found = boxes(
        tmp_path, ("a", (1, 0, 0), {}, {"frame": "lidar"}), ("b", (5, 0, 0), {}, {}),
        ("c", (2, 0, 0), {}, {"frame": "/lidar"}),
    )  # fmt: skip
    assert found.center_m[:, 0].tolist() == [2, 5, 3]
    np.testing.assert_allclose(found.yaw_rad, [np.pi / 2] * 3)


def test_scenes_without_cubes_are_empty(tmp_path):
    gone = SceneUpdate()
    gone.deletions.add(type=SceneEntityDeletion.ALL, timestamp=Timestamp(seconds=7))
    reader, faults = log(tmp_path, ("/points", POINTS), ("/gt", gone), ("/gt", SceneUpdate()))
    assert [(t.stamp_ns, len(t.boxes3d)) for t in reader.truths()] == [(2, 0), (7_000_000_000, 0)]
    assert not faults.num_lost


def test_damaged_scenes_are_counted(tmp_path):
    nowhere = scene(("a", (np.nan, 0, 0), {}, {}))
    reader, faults = log(tmp_path, ("/points", POINTS), ("/gt", nowhere))
    assert list(reader.truths()) == []
    assert faults.places["DEC001"] == ["log.mcap: /gt at 1: box 0 isn't finite"]


ROS_SCENE = {
    f"foxglove_msgs/msg/{name}": text
    for name, text in {
        "KeyValuePair": "string key\nstring value",
        "SceneEntityDeletion": "builtin_interfaces/Time timestamp\nuint8 type\nstring id",
        "CubePrimitive": "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nstd_msgs/ColorRGBA color",
        "TextPrimitive": "geometry_msgs/Pose pose\nbool billboard\nfloat64 font_size\nstring text",
        "SceneEntity": (
            "builtin_interfaces/Time timestamp\nstring frame_id\nstring id\nbuiltin_interfaces/Duration lifetime\n"
            "bool frame_locked\nKeyValuePair[] metadata\nCubePrimitive[] cubes\nTextPrimitive[] texts"
        ),
        "SceneUpdate": "SceneEntityDeletion[] deletions\nSceneEntity[] entities",
    }.items()
}


@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
def test_scenes_of_ros(distro):
    ros = Ros(distro, ROS_SCENE)

    def made(name, *args):
        return ros.make(f"foxglove_msgs/msg/{name}", *args)

    pose = ros.make(
        "geometry_msgs/msg/Pose", ros.make("geometry_msgs/msg/Point", 1.0, 2.0, 3.0),
        ros.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, HALF, HALF),
    )  # fmt: skip
    color = ros.make("std_msgs/msg/ColorRGBA", 0.0, 0.0, 0.0, 1.0)
    cube = made("CubePrimitive", pose, ros.make("geometry_msgs/msg/Vector3", 4.0, 2.0, 1.5), color)
    lifetime = ros.make("builtin_interfaces/msg/Duration", 0, 0)
    metadata = [made("KeyValuePair", "label", "car"), made("KeyValuePair", "score", "0.5")]
    text = made("TextPrimitive", pose, True, 1.0, "van")
    entity = made("SceneEntity", ros.time(STAMP), "map", "9", lifetime, False, metadata, [cube], [text])
    codec = ros.codec("foxglove_msgs/msg/SceneUpdate")
    part = codec.truth(ros.write(made("SceneUpdate", [], [entity])), ORIGIN)
    found = part.truth.boxes3d
    assert (part.frame_id, part.truth.stamp_ns) == ("map", STAMP_NS)
    assert (found.center_m.tolist(), found.label.tolist()) == ([[1, 2, 3]], ["car"])
    assert (found.score.tolist(), found.track_id.tolist()) == ([0.5], [9])
    deletion = made("SceneEntityDeletion", ros.time(STAMP), 1, "")
    gone = codec.truth(ros.write(made("SceneUpdate", [deletion], [])), ORIGIN)
    assert (len(gone.truth.boxes3d), gone.truth.stamp_ns) == (0, STAMP_NS)


def test_boxes_in_the_world_stay_there_where_poses_move_them(tmp_path):
    """All transforms on one moving topic: what it says first of the body's place must not count as fixed."""
    plain, _ = log(
        tmp_path, ("/points", POINTS), ("/tf", edge("map", "base_link", (3, 0, 0))),
        ("/tf", edge("base_link", "lidar", (1, 0, 0))), ("/gt", scene(("1", (10, 0, 0), {}, {"frame": "map"}))),
    )  # fmt: skip
    reader = open_log(plain.container.path, FaultLog(), setup=Setup(pose="/tf", source="fbench.toml"))
    [truth] = reader.truths()
    assert truth.in_world
    assert truth.boxes3d.center_m.tolist() == [[10, 0, 0]]


def hostile(tmp_path, message):
    """What a scene loses that comes before a sane one."""
    sane = scene(("a", (1, 2, 3), {}, {}))
    static = ("/tf_static", edge("base_link", "lidar", (1, 0, 0)))
    reader, faults = log(tmp_path, static, ("/points", POINTS), ("/objects", message), ("/objects", sane))
    assert [len(truth.boxes3d) for truth in reader.detections("/objects")] == [1]
    return next(str(row["places"]) for row in faults.rows() if row["code"] == "DEC001")


def test_scenes_of_more_boxes_than_can_be(tmp_path):
    """Of two bytes each, and a hundred times that in memory."""
    assert "10001 boxes in one message, more than 10000" in hostile(
        tmp_path, scene(("a", (1, 2, 3), {}, {"cubes": 10_001}))
    )
    assert "bytes, more than 8388608" in hostile(tmp_path, scene(("a" * 2**23, (1, 2, 3), {}, {})))


def test_speeds_that_are_no_number_are_unknown(tmp_path):
    assert len(boxes(tmp_path, ("a", (1, 2, 3), {"speed": "inf"}, {}))) == 1


@pytest.mark.parametrize("metadata", [{"velocity": "1e999 0"}, {"speed": "1e308"}])
def test_speeds_that_cannot_be_are_refused(tmp_path, metadata):
    assert "box 0 isn't finite" in hostile(tmp_path, scene(("a", (1, 2, 3), metadata, {})))


def test_rotation_that_is_not_finite(tmp_path):
    broken = scene(("a", (1, 2, 3), {}, {}))
    broken.entities[0].cubes[0].pose.orientation.w = np.inf
    assert "box 0 isn't finite" in hostile(tmp_path, broken)
