"""ROS 1 bags whose `/tf` holds both of the types that it has had."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores
from tests.program import fbench
from tests.replay.logs.codecs.ros.builders import STAMP, Ros

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.open import open_log

TYPES = ("tf/msg/tfMessage", "tf2_msgs/msg/TFMessage")
ROS = Ros(Stores.ROS1_NOETIC, dict.fromkeys(TYPES, "geometry_msgs/TransformStamped[] transforms"))
START_NS = 1_700_000_000_000_000_000


def transform(kind, child, x):
    make = ROS.make
    pose = make(
        "geometry_msgs/msg/Transform",
        make("geometry_msgs/msg/Vector3", x, 0.0, 0.0),
        make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0),
    )
    return make(kind, [make("geometry_msgs/msg/TransformStamped", ROS.header("base_link"), child, pose)])


def cloud(frame_id, stamp=STAMP):
    fields = [ROS.make("sensor_msgs/msg/PointField", name, 4 * i, 7, 1) for i, name in enumerate("xyz")]
    data = np.arange(30, dtype="<f4").view(np.uint8)
    return ROS.make(
        "sensor_msgs/msg/PointCloud2", ROS.header(frame_id, stamp), 1, 10, fields, False, 12, 120, data, True
    )


def write_bag(path, messages):
    """Write (topic, message), a millisecond apart."""
    with Writer(path) as writer:
        connections = {
            key: writer.add_connection(*key, typestore=ROS.store)
            for key in dict.fromkeys((topic, message.__msgtype__) for topic, message in messages)
        }
        for i, (topic, message) in enumerate(messages):
            writer.write(connections[topic, message.__msgtype__], START_NS + i * 1_000_000, bytes(ROS.write(message)))
    return path


@pytest.fixture
def bag(tmp_path):
    messages = [
        ("/tf", transform(TYPES[0], "left", 1.0)),
        ("/tf", transform(TYPES[1], "right", 2.0)),
        ("/left", cloud("left")),
        ("/right", cloud("right")),
    ]
    return write_bag(tmp_path / "drive.bag", messages)


def test_both_place_sensors(bag):
    faults = FaultLog()
    log = open_log(bag, faults)
    assert {name: mount.translation_m[0] for name, mount in log.rig.mounts.items()} == {"left": 1, "right": 2}
    assert [message.sensor for message in log.messages()] == ["left", "right"]
    assert faults.num_lost == 0


@pytest.mark.parametrize("name", ["drive.mcap", "drive.parquet"])
def test_both_are_converted(bag, tmp_path, name):
    assert fbench("log", "convert", bag, "-o", tmp_path / name) == 0
    converted = open_log(tmp_path / name, FaultLog())
    assert {name: mount.translation_m[0] for name, mount in converted.rig.mounts.items()} == {"left": 1, "right": 2}
