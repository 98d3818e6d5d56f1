"""Poses of the body from transforms that move, and from odometry."""

import numpy as np
import pytest
from google.protobuf.timestamp_pb2 import Timestamp
from tests.cli.test_recorded import START_S, drive, pose, write
from tests.replay.logs.codecs.ros.builders import DISTROS, Ros
from tests.replay.logs.test_foreign import edge, log, packed

from fbench.replay.contracts.errors import ConfigError, DecodeError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Pose
from fbench.replay.logs.coordinate_frames import Edge, TransformTree
from fbench.replay.logs.open import open_log
from fbench.replay.logs.poses import TfPoses, of_body
from fbench.replay.logs.setup import Setup
from fbench.replay.logs.truth import PosesIn

HALF = 2**-0.5
UPRIGHT = np.array([0.0, 0, 0, 1])
LEFT = np.array([0, 0, HALF, HALF])
POINTS = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])


def link(parent, xyz, xyzw=UPRIGHT):
    return Edge(parent, np.array(xyz, np.float64), xyzw)


def test_chain_to_the_world():
    poses = TfPoses("tf", TransformTree({"lidar": link("base_link", (1, 0, 0))}), "base_link", "map")
    assert poses.take([("base_link", link("odom", (5, 0, 0)))], [10], 11) is None  # not linked yet
    first = poses.take([("odom", link("map", (100, 0, 0), LEFT))], [12], 13)
    # 5 m ahead of odom, which looks along y of the map.
    np.testing.assert_allclose(first.translation_m, [100, 5, 0], atol=1e-12)
    np.testing.assert_allclose(first.rotation_xyzw, LEFT)
    assert (first.sensor, first.stamp_ns, first.log_ns) == ("tf", 12, 13)
    assert poses.take([("wheel", link("base_link", (0, 1, 0)))], [14], 15) is None
    both = [("wheel", link("base_link", (0, 1, 0))), ("base_link", link("odom", (6, 1, 0)))]
    second = poses.take(both, [20, 18], 21)
    np.testing.assert_allclose(second.translation_m, [99, 6, 0], atol=1e-12)
    assert second.stamp_ns == 18
    assert poses.take(both, [0, 0], 31).stamp_ns == 31


def two_worlds(tmp_path):
    """A body that moves in `odom`, which lies beside the origin of `map`."""
    return log(
        tmp_path, ("/tf_static", edge("base_link", "lidar", (1, 0, 0))), ("/points", POINTS),
        ("/tf", edge("map", "odom", (100, 0, 0))), ("/tf", edge("odom", "base_link", (5, 0, 0))),
    )[0]  # fmt: skip


@pytest.mark.parametrize(("world", "x"), [("", 105), ("map", 105), ("odom", 5)])
def test_the_world_may_be_chosen(tmp_path, world, x):
    path = two_worlds(tmp_path).container.path
    reader = open_log(path, FaultLog(), setup=Setup(pose="/tf", world=world))
    last = [m for m in reader.messages() if isinstance(m, Pose)][-1]
    assert last.translation_m.tolist() == [x, 0, 0]
    frames = reader.coordinate_frames
    assert frames.world == (world or "map")
    assert [frames.is_world(name) for name in ("map", "odom", "world")] == [world != "odom", world == "odom", True]


def test_a_world_that_transforms_dont_reach_is_refused(tmp_path):
    path = two_worlds(tmp_path).container.path
    with pytest.raises(LogError, match="topic '/tf' doesn't say where 'base_link' is in 'earth'"):
        list(open_log(path, FaultLog(), setup=Setup(pose="/tf", world="earth")).messages())


@pytest.mark.parametrize(("frame", "poses", "is_there"), [
    ("odom", PosesIn(True, "odom"), True), ("world", PosesIn(True, "odom"), True), ("map", PosesIn(True), True),
    ("utm", PosesIn(True, "utm"), True), ("utm", PosesIn(True), False), ("map", PosesIn(False), False),
    ("base_link", PosesIn(True, "map"), False),
])  # fmt: skip
def test_poses_link_their_own_world_alone(frame, poses, is_there):
    assert poses.link(frame, "base_link") == is_there


def test_boxes_in_another_world_than_poses_are_refused():
    with pytest.raises(DecodeError, match="boxes in 'map', but poses in 'odom'; name a topic with poses in 'map'"):
        PosesIn(True, "odom").link("map", "base_link")


def test_loops_are_refused():
    poses = TfPoses("tf", TransformTree({}), "base_link", "map")
    with pytest.raises(DecodeError, match="transforms form a loop"):
        poses.take([("base_link", link("odom", (0, 0, 0))), ("odom", link("base_link", (0, 0, 0)))], [1, 1], 1)


def test_pose_of_what_is_fixed_to_the_body():
    """An IMU 2 m ahead of the body's origin that looks left; it is at (10, 0) and looks along x of the world."""
    body_T_imu = np.array([[0.0, -1, 0, 2], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    found = of_body(Pose("p", 1, 2, np.array([10.0, 0, 0]), UPRIGHT), body_T_imu)
    world_T_imu = found.world_T_body @ body_T_imu
    np.testing.assert_allclose(world_T_imu[:3], [[1, 0, 0, 10], [0, 1, 0, 0], [0, 0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(found.translation_m, [10, 2, 0], atol=1e-12)
    with pytest.raises(DecodeError, match="pose has no valid rotation"):
        of_body(Pose("p", 1, 2, np.zeros(3), np.zeros(4)), body_T_imu)


def reopened(reader, pose):
    faults = FaultLog()
    return open_log(reader.container.path, faults, setup=Setup(pose=pose, source="fbench.toml")), faults


def test_transforms_of_a_log_that_the_user_names(tmp_path):
    moving = [edge("map", "base_link", (x, 0, 0)) for x in (3, 4)]
    for i, transform in enumerate(moving):
        transform.timestamp.CopyFrom(Timestamp(nanos=100 + i))
    plain, _ = log(
        tmp_path, ("/tf_static", edge("base_link", "lidar", (1, 0, 0))), ("/points", POINTS), ("/tf", moving[0]),
        ("/tf", edge("base_link", "wheel")), ("/tf", moving[1]),
    )  # fmt: skip
    assert (plain.poses, [m.sensor for m in plain.messages()]) == ((), ["lidar"])
    reader, faults = reopened(plain, "/tf")
    assert (reader.poses, dict(reader.num_messages)) == (("tf",), {"lidar": 1, "tf": 3})
    poses = [m for m in reader.messages() if isinstance(m, Pose)]
    assert [(p.stamp_ns, p.translation_m.tolist()) for p in poses] == [(100, [3, 0, 0]), (101, [4, 0, 0])]
    assert poses[0].sensor == "tf"
    whole = [m for _, m in reader.everything() if isinstance(m, Pose)]
    assert [p.stamp_ns for p in whole] == [100, 101]
    assert reader.rig.mounts["lidar"].translation_m.tolist() == [1, 0, 0]
    assert not faults.num_lost


def test_transforms_that_dont_say_where_the_body_is(tmp_path):
    plain, _ = log(tmp_path, ("/points", POINTS), ("/tf", edge("base_link", "lidar", (1, 0, 0))))
    reader, _ = reopened(plain, "/tf")
    with pytest.raises(LogError, match="topic '/tf' doesn't say where 'base_link' is"):
        list(reader.messages())


ROS = Ros(DISTROS[1])


def odometry(ms, x, child):
    def vector(*xyz):
        return ROS.make("geometry_msgs/msg/Vector3", *map(float, xyz))

    pose = ROS.make(
        "geometry_msgs/msg/Pose", ROS.make("geometry_msgs/msg/Point", float(x), 0.0, 0.0),
        ROS.make("geometry_msgs/msg/Quaternion", *UPRIGHT.tolist()),
    )  # fmt: skip
    twist = ROS.make("geometry_msgs/msg/Twist", vector(0, 0, 0), vector(0, 0, 0))
    message = ROS.make(
        "nav_msgs/msg/Odometry", ROS.header("odom", (START_S, ms * 1_000_000)), child,
        ROS.make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
        ROS.make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
    )  # fmt: skip
    return ms + 1, f"/odom/{child}", "nav_msgs/msg/Odometry", ROS.write(message)


def test_odometry_counts_only_where_the_user_names_it(tmp_path):
    path = write(
        tmp_path / "log.mcap", *drive(odometry(0, 1, "base_link"), odometry(0, 2, "lidar"), odometry(0, 3, "imu"))
    )
    faults = FaultLog()
    plain = open_log(path, faults)
    assert plain.poses == ()
    assert not any(isinstance(m, Pose) for m in plain.messages())
    assert "LOG012" not in faults.counts
    for child in ("base_link", "lidar"):
        reader = open_log(path, faults, setup=Setup(pose=f"/odom/{child}", source="fbench.toml"))
        [pose] = [m for m in reader.messages() if isinstance(m, Pose)]
        assert (reader.poses, pose.sensor) == ((f"odom/{child}",), f"odom/{child}")
        assert pose.translation_m.tolist() == [1 if child == "base_link" else 2, 0, 0]
    assert not faults.num_lost
    adrift = open_log(path, faults, setup=Setup(pose="/odom/imu", source="fbench.toml"))
    assert not any(isinstance(m, Pose) for m in adrift.messages())
    assert "pose of 'imu', which no fixed transform links to the body" in faults.places["DEC001"][0]
    with pytest.raises(ConfigError, match=r"body\.pose: the log has no topic '/odom/base'; did you mean"):
        open_log(path, faults, setup=Setup(pose="/odom/base", source="fbench.toml"))


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("xyz", "xyzw", "why"),
    [
        ((NAN, 0, 0), UPRIGHT, "isn't finite"),
        ((1e308, 0, 0), UPRIGHT, "isn't finite"),
        ((0, 0, 0), np.full(4, NAN), "has no valid rotation"),
        ((0, 0, 0), np.array([INF, 0, 0, 1]), "has no valid rotation"),
        ((0, 0, 0), np.full(4, 1e308), "has no valid rotation"),
        ((0, 0, 0), np.zeros(4), "has no valid rotation"),
    ],
)
@pytest.mark.parametrize("above", [{}, {"odom": link("map", (1, 0, 0))}], ids=["direct", "chain"])
def test_transforms_that_cannot_be(xyz, xyzw, why, above):
    poses = TfPoses("tf", TransformTree(above), "base_link", "map" if above else "odom")
    with pytest.raises(DecodeError, match=f"transform of 'base_link' {why}"):
        poses.take([("base_link", link("odom", xyz, xyzw))], [1], 2)


def test_boxes_in_a_coordinate_frame_whose_transform_cannot_be():
    tree = TransformTree({"tower": link("base_link", (0, 0, 0), np.array([INF, 0, 0, 1]))})
    with pytest.raises(DecodeError, match="transform of 'tower' has no valid rotation"):
        tree.pose("tower", "base_link")


def test_odometry_that_cannot_be_is_counted(tmp_path):
    def turned(ms, x):
        message = pose(ms, x)
        message.pose.position.x = NAN if ms == 100 else x
        return ROS.write(message)

    kind = "geometry_msgs/msg/PoseStamped"
    odometry = [(ms + 1, "/odom", kind, turned(ms, float(ms))) for ms in range(0, 600, 100)]
    faults = FaultLog()
    reader = open_log(write(tmp_path / "log.mcap", *drive(*odometry)), faults, setup=Setup(pose="/odom"))
    assert len(list(reader.body_poses())) == 5
    [row] = [row for row in faults.rows() if row["code"] == "DEC001"]
    assert row["count"] == 1
    assert "pose isn't finite" in str(row)
