"""Messages written by rosbags, in the types of several ROS distributions, and the codec that reads them."""

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fbench.replay.logs.codecs.codec import Origin
from fbench.replay.logs.codecs.ros.codec import ros_codec
from fbench.replay.logs.container import Channel, Schema

STAMP = (1_700_000_000, 123_456_789)
STAMP_NS = 1_700_000_000_123_456_789
ORIGIN = Origin("s", STAMP_NS + 5, STAMP_NS + 3, 7)
DISTROS = (Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.ROS1_NOETIC)


class Ros:
    """One distribution: makes messages from keyword arguments and serializes them."""

    def __init__(self, distro: Stores, definitions: dict[str, str] | None = None, *, big: bool = False) -> None:
        self.store = get_typestore(distro)
        self.encoding = "ros1" if distro is Stores.ROS1_NOETIC else "cdr"
        self.big = big
        for name, text in (definitions or {}).items():
            self.store.register(get_types_from_msg(text, name))

    def make(self, name: str, *args, **fields):
        return self.store.types[name](*args, **fields)

    def header(self, frame_id="sensor", stamp=STAMP):
        sequence = {"seq": 9} if self.encoding == "ros1" else {}
        return self.make("std_msgs/msg/Header", **sequence, stamp=self.time(stamp), frame_id=frame_id)

    def time(self, stamp=STAMP):
        return self.make("builtin_interfaces/msg/Time", *stamp)

    def write(self, message) -> memoryview:
        name = message.__msgtype__
        if self.encoding == "ros1":
            return memoryview(bytes(self.store.serialize_ros1(message, name)))
        return memoryview(bytes(self.store.serialize_cdr(message, name, little_endian=not self.big)))

    def schema(self, name: str, *, text: bool = True) -> Schema:
        """The definition as recorders embed it."""
        version = 1 if self.encoding == "ros1" else 2
        data = self.store.generate_msgdef(name, ros_version=version)[0].encode() if text else b""
        return Schema(name, f"ros{version}msg" if text else "", data)

    def codec(self, name: str, *, text: bool = True):
        return ros_codec(Channel("/topic", self.encoding, self.schema(name, text=text)))


CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8, "i8": 9, "u8": 10}


def cloud(ros: Ros, rows: np.ndarray, *, row_padding: int = 0, frame_id="lidar", stamp=STAMP, **changes):
    """A PointCloud2 of a structured array (N,) or (H, W), in its byte order."""
    table = np.atleast_2d(rows)
    dtype = table.dtype
    fields = [
        ros.make("sensor_msgs/msg/PointField", name, dtype.fields[name][1], CODES[dtype.fields[name][0].str[1:]], 1)
        for name in dtype.names
    ]
    data = b"".join(row.tobytes() + bytes(row_padding) for row in table)
    big = any(dtype.fields[name][0].str[0] == ">" for name in dtype.names)
    parts = {
        "header": ros.header(frame_id, stamp), "height": table.shape[0], "width": table.shape[1], "fields": fields,
        "is_bigendian": big, "point_step": dtype.itemsize, "row_step": table.shape[1] * dtype.itemsize + row_padding,
        "data": np.frombuffer(data, np.uint8), "is_dense": True,
    }  # fmt: skip
    return ros.make("sensor_msgs/msg/PointCloud2", **{**parts, **changes})


def structured(**columns) -> np.ndarray:
    """A structured array of the given columns, packed."""
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    rows = np.zeros(len(next(iter(arrays.values()))), [(name, array.dtype) for name, array in arrays.items()])
    for name, array in arrays.items():
        rows[name] = array
    return rows
