"""Logs as drivers leave them: messages of ROS on topics, written as a bag or as MCAP by the libraries of both."""

from pathlib import Path
from typing import Any

from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores
from tests.replay.logs.codecs.ros.builders import Ros

MS = 1_000_000
_TF = "tf2_msgs/msg/TFMessage"


class DriverLog:
    """A list of (topic, log time, message); `form` is `bag` (ROS 1) or `mcap` (ROS 2)."""

    def __init__(self, form: str, definitions: dict[str, str], start_ns: int) -> None:
        self.form, self.start_ns = form, start_ns
        if form == "bag":
            definitions = {**definitions, _TF: "geometry_msgs/TransformStamped[] transforms"}
        self.ros = Ros(Stores.ROS1_NOETIC if form == "bag" else Stores.ROS2_JAZZY, definitions)
        self.items: list[tuple[str, int, Any]] = []

    def add(self, topic: str, log_ns: int, message: object) -> None:
        self.items.append((topic, log_ns, message))

    def transform(self, child: str, x: float = 1.0, z: float = 2.0) -> None:
        """Place a coordinate frame on the body."""
        make = self.ros.make
        where = make("geometry_msgs/msg/Vector3", x, 0.0, z)
        pose = make("geometry_msgs/msg/Transform", where, make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
        part = make("geometry_msgs/msg/TransformStamped", self.ros.header("base_link"), child, pose)
        self.add("/tf_static", self.start_ns, make(_TF, [part]))

    def write(self, folder: Path) -> Path:
        """Write the messages in the order of their times."""
        path = folder / f"drive.{self.form}"
        self.items.sort(key=lambda item: item[1])
        (self._write_bag if self.form == "bag" else self._write_mcap)(path)
        return path

    def _write_bag(self, path: Path) -> None:
        types = {topic: message.__msgtype__ for topic, _, message in self.items}
        with BagWriter(path) as bag:
            connections = {t: bag.add_connection(t, name, typestore=self.ros.store) for t, name in types.items()}
            for topic, log_ns, message in self.items:
                bag.write(connections[topic], log_ns, bytes(self.ros.write(message)))

    def _write_mcap(self, path: Path) -> None:
        with path.open("wb") as file:
            writer = McapWriter(file)
            writer.start()
            channels: dict[str, int] = {}
            for topic, log_ns, message in self.items:
                if topic not in channels:
                    schema = self.ros.schema(message.__msgtype__)
                    id_ = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[topic] = writer.register_channel(topic, "cdr", id_)
                writer.add_message(channels[topic], log_ns, bytes(self.ros.write(message)), log_ns)
            writer.finish()
