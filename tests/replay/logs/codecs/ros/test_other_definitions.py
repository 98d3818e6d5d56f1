"""Definitions that give fields of known types other types: a message or a DecodeError of one line, nothing else."""

import re
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore
from tests.replay.logs.codecs.ros import test_boxes, test_calibration, test_objects, test_radar
from tests.replay.logs.codecs.ros.builders import DISTROS, Ros
from tests.replay.logs.codecs.ros.test_damage import use

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.logs.codecs.ros.codec import ros_codec
from fbench.replay.logs.codecs.ros.definitions import types_of
from fbench.replay.logs.container import Channel, Schema

NUM = 10
TYPES = ("string", "float64", "uint8[]", "string[]", "int64", "bool", "float64[3]", "std_msgs/Header", "uint8")
KNOWN = {
    **test_boxes.NEW, **test_radar.SCANS, test_calibration.TF2: test_calibration.TEXT,
    **test_objects.autoware("autoware_perception_msgs"),
}  # fmt: skip
NAMES = (
    "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped",
    "sensor_msgs/msg/CameraInfo", "visualization_msgs/msg/MarkerArray", "autoware_perception_msgs/msg/DetectedObjects",
    "autoware_perception_msgs/msg/TrackedObjects", test_boxes.ARRAY2, test_boxes.ARRAY3, test_radar.SCAN,
    test_calibration.TF2,
)  # fmt: skip


def instance(store, name):
    """A message with a value in every field, and two in every sequence."""
    return store.types[name](*(value(store, descriptor) for _, descriptor in store.get_msgdef(name).fields))


def value(store, descriptor):
    node, what = descriptor
    if node == Nodetype.NAME:
        return instance(store, what)
    if node == Nodetype.BASE:
        return {"string": "7", "bool": True}.get(what[0], 1.5 if what[0].startswith("float") else 1)
    inner, num = what
    items = [value(store, inner) for _ in range(num or 2)]
    return items if inner[0] == Nodetype.NAME or inner[1][0] == "string" else np.array(items, inner[1][0])


def mutate(text, random):
    """Give one field of the definition, or of those in it, another type."""
    lines = text.split("\n")
    fields = [i for i, line in enumerate(lines) if re.fullmatch(r"[\w/\[\]]+ \w+", line)]
    i = int(random.choice(fields))
    lines[i] = f"{random.choice(TYPES)} {lines[i].split()[1]}"
    return "\n".join(lines)


@pytest.mark.parametrize("distro", [DISTROS[1], DISTROS[2]], ids=["ROS 2", "ROS 1"])
@pytest.mark.parametrize("name", NAMES)
def test_fields_of_other_types(distro, name):
    ros = Ros(distro, KNOWN)
    schema = ros.schema(name)
    random = np.random.Generator(np.random.Philox(7))
    lines, num_read = [], 0
    for _ in range(NUM):
        text = mutate(schema.data.decode(), random)
        try:
            codec = ros_codec(Channel("/t", ros.encoding, Schema(name, schema.encoding, text.encode())))
        except DecodeError as error:
            lines.append(str(error))
            continue
        payload = write(ros, name, Schema(name, schema.encoding, text.encode()))
        calls: list[Callable[[memoryview], object]] = [
            codec.probe,
            *(partial(use, codec, kind) for kind in codec.kinds),
        ]
        for call in calls:
            try:
                call(payload)
                num_read += 1
            except DecodeError as error:
                lines.append(str(error))
    assert lines
    assert num_read
    assert not any("\n" in line or len(line) > 2000 for line in lines)


def write(ros, name, schema):
    store = Typestore()
    store.register(types_of(name, schema, ros.encoding))
    message = instance(store, name)
    cdr = ros.encoding == "cdr"
    return memoryview(bytes((store.serialize_cdr if cdr else store.serialize_ros1)(message, name)))
