"""Definitions in IDL, as rosbag2 stores them for packages that have no .msg files: those of Autoware.Auto, say."""

import time

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores
from tests.replay.logs.codecs.ros.builders import ORIGIN, Ros
from tests.replay.logs.codecs.ros.test_objects import autoware, aware

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.logs.codecs.generic import parser_of
from fbench.replay.logs.codecs.ros.codec import ros_codec
from fbench.replay.logs.codecs.ros.idl import MAX_BYTES, idl_texts
from fbench.replay.logs.container import Channel, Schema

RULE = "=" * 80
_IDL = {
    "bool": "boolean", "byte": "octet", "float32": "float", "float64": "double", "uint32": "unsigned long",
    "int64": "long long", "uint64": "unsigned long long", "int16": "short", "uint16": "unsigned short", "int32": "long",
}  # fmt: skip
IDENTITY = (0.0, 0.0, 0.0, 1.0)


def idl(types, name):
    """The file of a type as rosidl's tools make it from the fields that rosbags knows."""
    package, _, short = name.split("/")
    typedefs, members = [], []

    def kind(descriptor):
        node, what = descriptor
        if node == Nodetype.BASE:
            return _IDL.get(what[0], what[0])
        if node == Nodetype.NAME:
            return what.replace("/", "::")
        inner = kind(what[0])
        if node == Nodetype.SEQUENCE:
            return f"sequence<{inner}>"
        alias = f"{inner.replace('::', '__').replace(' ', '_')}__{what[1]}"
        typedefs.append(f"    typedef {inner} {alias}[{what[1]}];\n")
        return alias

    for field, descriptor in types[name][1]:
        members.append(f'\n      @unit (value="m {{")\n      {kind(descriptor)} {field};\n')
    return (
        f'// generated from (nothing)\n#include "std_msgs/msg/Header.idl"\n\nmodule {package} {{\n  module msg {{\n'
        f"{''.join(dict.fromkeys(typedefs))}    module {short}_Constants {{\n      const uint8 CAR = 1;\n    }};\n"
        f'    @verbatim (language="comment", text=\n      "struct X {{ \\"a\\" (" "b")\n'
        f"    struct {short} {{{''.join(members)}    }};\n  }};\n}};\n"
    )


def sections(types, names):
    return "".join(f"{RULE}\nIDL: {name}\n{idl(types, name)}" for name in names).encode()


@pytest.mark.parametrize("kind", ["Detected", "Tracked", "Predicted"])
def test_objects_of_autoware_auto(kind):
    package = "autoware_auto_perception_msgs"
    definitions = autoware(package)
    ros = Ros(Stores.ROS2_HUMBLE, definitions)
    name = f"{package}/msg/{kind}Objects"
    row = (list(range(16)), [(1, 0.9)], ((10, 2, 0.5), IDENTITY), (3, 0, 0), (0, (), (4, 2, 1.5)))
    data = aware(ros, package, kind, [row])
    text = sections(ros.store.fielddefs, sorted(definitions, reverse=True))
    read, expected = (
        ros_codec(Channel("/a", "cdr", schema)).truth(data, ORIGIN).truth.boxes3d
        for schema in (Schema(name, "ros2idl", text), ros.schema(name))
    )
    assert read.center_m.tolist() == [[10, 2, 0.5]]
    assert {key: array.tolist() for key, array in read.arrays().items() if key != "velocity_mps"} == {
        key: array.tolist() for key, array in expected.arrays().items() if key != "velocity_mps"
    }
    np.testing.assert_array_equal(read.velocity_mps, expected.velocity_mps)


def test_a_message_of_every_type_for_a_decoder():
    definitions = {
        "acme_msgs/msg/All": "bool a\nbyte b\nint8 c\nuint8 d\nint16 e\nuint16 f\nint32 g\nuint32 h\nint64 i\n"
        "uint64 j\nfloat32 k\nfloat64 l\nstring m\nfloat32[3] n\nuint16[] o\nInner[] p\nInner[2] q\nstd_msgs/Header r",
        "acme_msgs/msg/Inner": "string name\nfloat64[36] covariance",
    }
    ros = Ros(Stores.ROS2_HUMBLE, definitions)
    inner = [ros.make("acme_msgs/msg/Inner", text, np.arange(36.0)) for text in ("x", "yy")]
    message = ros.make(
        "acme_msgs/msg/All", True, 1, -2, 3, -4, 5, -6, 7, -8, 9, 1.5, 2.5, "text", np.array([1, 2, 3], np.float32),
        np.array([4, 5], np.uint16), inner, inner, ros.header("dev"),
    )  # fmt: skip
    types = dict(ros.store.fielddefs)
    text = sections(types, ["acme_msgs/msg/Inner", "acme_msgs/msg/All", "std_msgs/msg/Header"])
    found = parser_of(Channel("/a", "cdr", Schema("acme_msgs/msg/All", "ros2idl", text)))(ros.write(message))
    for field in "abcdefghijklm":
        assert getattr(found, field) == getattr(message, field)
    assert (found.n.tolist(), found.o.tolist()) == ([1, 2, 3], [4, 5])
    assert [(part.name, part.covariance.sum()) for part in (*found.p, *found.q)] == [("x", 630), ("yy", 630)] * 2
    assert found.r.frame_id == "dev"


def test_what_people_write_by_hand():
    text = b"""module acme { module msg {
      typedef sequence<double, 10> Numbers; const long N = 3;
      @final struct Point { @key float x, y; string<16> name; @default(value=(1)) Numbers z; ::acme::msg::Other o; };
      struct Other { Point points[2]; acme::msg::Point p; char c; };
    }; };"""
    assert idl_texts(text) == {
        "acme/msg/Point": "float32 x\nfloat32 y\nstring name\nfloat64[] z\nacme/Other o\n",
        "acme/msg/Other": "acme/Point[2] points\nacme/Point p\nuint8 c\n",
    }


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("module a { module msg { struct S { long x; }; };", "'' instead of '}'"),
        ("module a { union U { long x; }; };", "'union' instead of a module, struct, typedef or constant"),
        ("struct S : Base { long x; };", "':' instead of '{'"),
        ("struct S { wstring x; };", "has a 'wstring', which isn't read"),
        ("struct S { long double x; };", "has a 'long double', which isn't read"),
        ("struct S { long x[3][4]; };", r"'\[' instead of ';'"),
        ("struct S { sequence<long> x[4]; };", "arrays of arrays, of int32"),
        ("struct S { long x[N]; };", "an array of 'N'"),
        ("struct S { 3 x; };", "'3' instead of a name"),
        ("typedef long", "'' instead of a name"),
        ("const long X = 3", "'' instead of ';'"),
        ("@a(" + "(" * 1000, "'' instead of more|'' instead of '\\)'"),
        ("struct S { " + "sequence<" * 50_000, "a sequence of sequences"),
        ("module a { " * 40_000, "more than 4 modules in each other"),
        ("@a(" + "/*" * 100_000, r"has a /\* without its end"),
        ("@a(" + '\\"' * 100_000, 'has a " without its end'),
        ("x" * (MAX_BYTES + 1), "more than 524288"),
    ],
)
def test_what_is_no_idl_of_ros_is_refused_fast(text, reason):
    start = time.process_time()
    with pytest.raises(DecodeError, match=reason):
        idl_texts(text.encode())
    assert time.process_time() - start < 5


def test_names_in_it_are_as_strictly_checked_as_in_msg():
    text = b"module a { module msg { struct S { b::msg::T x; }; }; };"
    with pytest.raises(DecodeError, match="definition of b/msg/T is missing"):
        parser_of(Channel("/a", "cdr", Schema("a/msg/S", "ros2idl", text)))
    text = b"module a { module msg { struct S { S x; }; }; };"
    with pytest.raises(DecodeError, match="contains itself"):
        parser_of(Channel("/a", "cdr", Schema("a/msg/S", "ros2idl", text)))


@pytest.mark.parametrize("name", ["sensor_msgs/CompressedImage", "sensor_msgs::msg::dds_::CompressedImage_"])
def test_names_as_recorders_of_dds_write_them(name):
    ros = Ros(Stores.ROS2_HUMBLE)
    image = ros.make("sensor_msgs/msg/CompressedImage", ros.header("cam"), "jpeg", np.zeros(3, np.uint8))
    codec = ros_codec(Channel("rt/image", "cdr", Schema(name, "omgidl", b"module sensor_msgs {")))
    assert codec.probe(ros.write(image)).frame_id == "cam"
