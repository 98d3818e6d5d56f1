"""Messages of any type by the log's own definition, as decoders get them; definitions are untrusted."""

import numpy as np
import pytest
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from rosbags.typesys import Stores
from tests.replay.logs.codecs.ros.builders import STAMP, Ros

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.logs.codecs.generic import parser_of
from fbench.replay.logs.container import Channel, Schema

TYPES = {
    "acme_msgs/msg/Targets": "std_msgs/Header header\nTarget[] targets\nfloat32[] raw",
    "acme_msgs/msg/Target": "float32 range\nstring label",
}
DEFINITION = "std_msgs/Header header\nTarget[] targets\nfloat32[] raw\n" + "=" * 80 + "\nMSG: acme_msgs/Target\n"
DEFINITION += "float32 range\nstring label\n"


def targets(ros):
    target = ros.make("acme_msgs/msg/Target", 5.5, "car")
    return ros.make("acme_msgs/msg/Targets", ros.header("dev"), [target], np.array([1, 2], np.float32))


@pytest.mark.parametrize("distro", [Stores.ROS2_HUMBLE, Stores.ROS1_NOETIC])
@pytest.mark.parametrize("own", [True, False])
def test_ros_by_the_definition_of_the_log_or_of_the_decoder(distro, own):
    ros = Ros(distro, TYPES)
    schema = ros.schema("acme_msgs/msg/Targets", text=own)
    parse = parser_of(Channel("/a", ros.encoding, schema), "" if own else DEFINITION)
    message = parse(ros.write(targets(ros)))
    assert (message.header.frame_id, message.header.stamp.sec, message.header.stamp.nanosec) == ("dev", *STAMP)
    assert [(target.range, target.label) for target in message.targets] == [(5.5, "car")]
    assert message.raw.tolist() == [1, 2]


def test_bulk_data_may_be_larger_than_messages_of_many_parts():
    ros = Ros(Stores.ROS2_HUMBLE, {"acme_msgs/msg/Blob": "uint8[] data", "acme_msgs/msg/Names": "string[] names"})
    blob = ros.make("acme_msgs/msg/Blob", np.zeros(9 * 2**20, np.uint8))
    parse = parser_of(Channel("/a", "cdr", ros.schema("acme_msgs/msg/Blob")))
    assert len(parse(ros.write(blob)).data) == 9 * 2**20
    parse = parser_of(Channel("/a", "cdr", ros.schema("acme_msgs/msg/Names")))
    with pytest.raises(DecodeError, match="acme_msgs/msg/Names of 8388609 bytes, more than 8388608"):
        parse(memoryview(bytes(8 * 2**20 + 1)))


NUMBER, TEXT, PART, REPEATED = (
    FieldDescriptorProto.TYPE_DOUBLE, FieldDescriptorProto.TYPE_STRING, FieldDescriptorProto.TYPE_MESSAGE,
    FieldDescriptorProto.LABEL_REPEATED,
)  # fmt: skip


def files():
    """A type that uses another file's, in the order of nobody."""
    part = FileDescriptorProto(name="part.proto", package="acme", syntax="proto3")
    point = part.message_type.add(name="Point")
    point.field.add(name="x", number=1, type=NUMBER, label=1)
    whole = FileDescriptorProto(name="whole.proto", package="acme", syntax="proto3", dependency=["part.proto"])
    path = whole.message_type.add(name="Path")
    path.field.add(name="points", number=1, type=PART, type_name=".acme.Point", label=REPEATED)
    path.field.add(name="name", number=2, type=TEXT, label=1)
    return FileDescriptorSet(file=[whole, part])


def make_path(**fields):
    pool = descriptor_pool.DescriptorPool()
    for file in reversed(files().file):
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("acme.Path"))(**fields)


def protobuf(data, name="acme.Path"):
    return parser_of(Channel("/a", "protobuf", Schema(name, "protobuf", data)))


def test_protobuf_by_the_files_of_the_log_in_any_order():
    parse = protobuf(files().SerializeToString())
    message = parse(memoryview(make_path(points=[{"x": 1.5}, {"x": 2}], name="p").SerializeToString()))
    assert ([point.x for point in message.points], message.name) == ([1.5, 2], "p")


def test_two_logs_may_define_one_name_differently():
    other = FileDescriptorProto(name="whole.proto", package="acme", syntax="proto3")
    other.message_type.add(name="Path").field.add(name="length", number=1, type=NUMBER, label=1)
    first = protobuf(files().SerializeToString())
    second = protobuf(FileDescriptorSet(file=[other]).SerializeToString())
    assert hasattr(second(memoryview(b"")), "length")
    assert hasattr(first(memoryview(b"")), "points")


def circle():
    a = FileDescriptorProto(name="a", dependency=["b"])
    return FileDescriptorSet(file=[a, FileDescriptorProto(name="b", dependency=["a"])]).SerializeToString()


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "definition of acme.Path is missing"),
        (b"\xff\xff", "definition of acme.Path can't be used"),
        (FileDescriptorSet(file=files().file[:1]).SerializeToString(), "definition of acme.Path can't be used"),
        (circle(), "definition of acme.Path can't be used"),
        (bytes(5 * 2**20), "more than 4194304"),
    ],
)
def test_protobuf_definitions_that_cannot_be_used(data, reason):
    with pytest.raises(DecodeError, match=reason):
        protobuf(data)


def test_protobuf_that_is_damaged_or_would_grow_too_much():
    parse = protobuf(files().SerializeToString())
    with pytest.raises(DecodeError, match=r"not a acme\.Path"):
        parse(memoryview(b"\x0a\xff"))
    with pytest.raises(DecodeError, match=r"acme\.Path of 8388610 bytes, more than 8388608"):
        parse(memoryview(b"\x0a\0" * (4 * 2**20 + 1)))


def test_json_and_encodings_that_need_bytes():
    assert parser_of(Channel("/a", "json"))(memoryview(b'{"a": [1, null]}')) == {"a": [1, None]}
    with pytest.raises(DecodeError, match="encoding 'flatbuffer' has no general decoder"):
        parser_of(Channel("/a", "flatbuffer"))


@pytest.mark.parametrize(
    ("schema", "reason"),
    [
        (None, "'' isn't the name of a message type"),
        (Schema("acme_msgs/msg/Targets", "", b""), "definition of acme_msgs/msg/Targets is missing"),
    ],
)
def test_ros_without_a_definition(schema, reason):
    with pytest.raises(DecodeError, match=reason):
        parser_of(Channel("/a", "cdr", schema))
