"""Write a log as a vendor's recorder does: an MCAP file with types that nobody else knows.

A radar sends a ROS 2 message of the vendor's own package, a LiDAR a Protobuf message, and labels come as JSON. A car
drives ahead of the vehicle. `docs/plugins.md` shows the decoders that read it.

    python examples/vendor_log.py vendor.mcap
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START_NS, STEP_NS, NUM = 1_700_000_000_000_000_000, 100_000_000, 30
SPEED_MPS = 5.0
SIZE_M = (4.5, 1.8, 1.5)
TARGETS = """std_msgs/Header header
Target[] targets
================================================================================
MSG: acme_msgs/Target
float32 range_m
float32 azimuth_rad
float32 speed_mps
float32 rcs_dbsm
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
MOUNTS = {"acme_radar": (3.8, 0.0, 0.5), "acme_lidar": (1.2, 0.0, 1.8)}


def sweep_file() -> FileDescriptorProto:
    """Return what `acme.proto` says."""
    file = FileDescriptorProto(name="acme.proto", package="acme", syntax="proto3")
    sweep = file.message_type.add(name="Sweep")
    types = FieldDescriptorProto.TYPE_UINT64, FieldDescriptorProto.TYPE_STRING, FieldDescriptorProto.TYPE_BYTES
    for number, (name, kind) in enumerate(zip(("time_ns", "frame", "points"), types, strict=True), 1):
        sweep.field.add(name=name, number=number, type=kind, label=FieldDescriptorProto.LABEL_OPTIONAL)
    return file


def car_points(x: float) -> Any:
    """Points (N, 3) on the back and the sides of a car whose middle is at `x`, and on the ground around, in the body's
    coordinates.
    """
    length, width, height = SIZE_M
    z, side = np.linspace(0.2, height, 8), np.linspace(-0.5, 0.5, 25)
    back = [(x - length / 2, v * width, w) for v in side for w in z]
    sides = [(x + u * length, s * width / 2, w) for u in side for s in (-1, 1) for w in z]
    ground = [(r * np.cos(a), r * np.sin(a), 0.0) for r in np.arange(4, 40, 1.5) for a in np.linspace(-1, 1, 80)]
    return np.array([*back, *sides, *ground], np.float32)


class Vendor:
    """Writes one log."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._store.register(get_types_from_msg(TARGETS, "acme_msgs/msg/Targets"))
        pool = descriptor_pool.DescriptorPool()
        pool.Add(sweep_file())
        self._sweep = message_factory.GetMessageClass(pool.FindMessageTypeByName("acme.Sweep"))
        files = FileDescriptorSet(file=[sweep_file()]).SerializeToString()
        self._radar = self._channel("/acme/radar", "cdr", "acme_msgs/msg/Targets", "ros2msg", TARGETS.encode())
        self._lidar = self._channel("/acme/lidar", "protobuf", "acme.Sweep", "protobuf", files)
        self._labels = self._channel("/acme/labels", "json", "acme.Objects", "jsonschema", b'{"type": "object"}')
        self._tf = self._channel("/tf_static", "json", "foxglove.FrameTransform", "jsonschema", b"{}")

    def write(self) -> None:
        """Write all messages."""
        for name, (x, y, z) in MOUNTS.items():
            place = {"translation": {"x": x, "y": y, "z": z}, "rotation": {"x": 0, "y": 0, "z": 0, "w": 1}}
            self._add(self._tf, START_NS, {"parent_frame_id": "base_link", "child_frame_id": name, **place})
        for i in range(NUM):
            stamp_ns, x = START_NS + i * STEP_NS, 12.0 + SPEED_MPS * i * STEP_NS / 1e9
            points = car_points(x) - np.array(MOUNTS["acme_lidar"], np.float32)
            rows = np.concatenate([points, np.full((len(points), 1), 30, np.float32)], axis=1)
            sweep = self._sweep(time_ns=stamp_ns, frame="acme_lidar", points=rows.astype("<f4").tobytes())
            self._add(self._lidar, stamp_ns, sweep.SerializeToString())
            self._add(self._radar, stamp_ns, self._targets(stamp_ns, x - SIZE_M[0] / 2))
            length, width, height = SIZE_M
            car = {"id": 7, "class": "CAR", "position": [x - 1.2, 0, height / 2 - 1.8], "size": [length, width, height]}
            objects = [{**car, "yaw": 0.0, "velocity": [SPEED_MPS, 0, 0]}]
            self._add(self._labels, stamp_ns, {"time_ns": stamp_ns, "frame": "acme_lidar", "objects": objects})

    def _targets(self, stamp_ns: int, back_m: float) -> bytes:
        types = self._store.types
        stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        targets = [
            types["acme_msgs/msg/Target"](float(np.hypot(x, y)), float(np.arctan2(y, x)), SPEED_MPS, 12.0)
            for x, y in [(back_m - MOUNTS["acme_radar"][0], y) for y in np.linspace(-0.8, 0.8, 6)]
        ]
        header = types["std_msgs/msg/Header"](stamp, "acme_radar")
        message = types["acme_msgs/msg/Targets"](header, targets)
        return bytes(self._store.serialize_cdr(message, "acme_msgs/msg/Targets"))

    def _channel(self, topic: str, encoding: str, schema: str, schema_encoding: str, definition: bytes) -> int:
        return int(
            self._writer.register_channel(
                topic, encoding, self._writer.register_schema(schema, schema_encoding, definition)
            )
        )

    def _add(self, channel: int, stamp_ns: int, message: Any) -> None:
        data = message if isinstance(message, bytes) else json.dumps(message).encode()
        self._writer.add_message(channel, stamp_ns + 2_000_000, data, stamp_ns)


def main(path: Path) -> None:
    """Write the log."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()  # type: ignore[no-untyped-call]
        Vendor(writer).write()
        writer.finish()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
