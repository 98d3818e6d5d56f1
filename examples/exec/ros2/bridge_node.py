"""Runs a ROS 2 stack in lockstep: publishes each frame's messages, and waits for the boxes with the same stamp.

    fbench replay LOG -p 'exec:python3 bridge_node.py --detections /perception/objects'

The stack runs beside it with `use_sim_time`. Topics: /clock, /tf_static, /tf where the log has poses, and for a sensor
S: /S/points, /S/image or /S/image/compressed, /S/camera_info. `client.py` must be importable (PYTHONPATH=../python).
"""

import argparse
import queue
import threading
import time
from types import SimpleNamespace
from typing import Any, Protocol

import conversions
from client import columns, run, schema


class Ros(Protocol):
    """What the bridge needs of ROS."""

    types: Any

    def publish(self, topic: str, message: Any, keep: bool = False) -> None:
        """Publish; `keep`: for those who subscribe later, too."""
        ...

    def receive(self, timeout_s: float) -> tuple[str, Any] | None:
        """Topic and message of the next boxes; `None` where none come in time."""
        ...


class Bridge:
    """A stack for `client.run`."""

    def __init__(
        self, ros: Ros, detections: str, tracks: str | None, timeout_s: float, body: str = "base_link"
    ) -> None:
        self.name = "ros2 bridge"
        self._ros, self._timeout_s, self._body = ros, timeout_s, body
        self._topics = {detections: "detections"} | ({tracks: "tracks"} if tracks else {})

    def start(self, hello: schema.Hello) -> None:
        """Publish where the sensors are."""
        self._sensors = {sensor.name: sensor for sensor in hello.sensors}
        make = conversions.transform
        message = self._ros.types.TFMessage()
        message.transforms = [make(self._ros.types, self._body, s.name, 0, s) for s in hello.sensors]
        self._ros.publish("/tf_static", message, keep=True)

    def reset(self, reason: str) -> None:
        """Nodes see the jump of /clock."""
        print("reset:", reason)

    def step(self, frame: schema.Frame) -> schema.Output:
        """Publish a frame and wait for what the stack makes of it."""
        begin = time.perf_counter_ns()
        types = self._ros.types
        self._ros.publish("/clock", conversions.clock(types, frame.stamp_ns))
        for message in sorted(frame.messages, key=lambda m: (m.log_ns, m.sensor)):
            self._send(message)
        output = self._wait(frame.stamp_ns)
        output.stages.add(name="ros2", duration_ns=time.perf_counter_ns() - begin)
        return output

    def _send(self, message: schema.Message) -> None:
        types, name, at_ns = self._ros.types, message.sensor, message.stamp_ns
        kind = message.WhichOneof("content")
        content = getattr(message, kind)
        if kind == "image":
            picture = conversions.image(types, name, at_ns, content)
            suffix = "/compressed" if isinstance(picture, types.CompressedImage) else ""
            self._ros.publish(f"/{name}/image{suffix}", picture)
            if self._sensors[name].HasField("camera"):
                self._ros.publish(f"/{name}/camera_info", conversions.camera_info(types, self._sensors[name], at_ns))
        elif kind == "pose":
            moved = types.TFMessage()
            moved.transforms = [conversions.transform(types, "map", self._body, at_ns, content)]
            self._ros.publish("/tf", moved)
        else:
            self._ros.publish(f"/{name}/points", conversions.points(types, name, at_ns, columns(content)))

    def _wait(self, frame_ns: int) -> schema.Output:
        output = schema.Output()
        output.in_3d.SetInParent()
        wanted = dict(self._topics)
        deadline = time.monotonic() + self._timeout_s
        while wanted:
            received = self._ros.receive(deadline - time.monotonic())
            if received is None:
                raise TimeoutError(f"no message with stamp {frame_ns} ns on {', '.join(wanted)}")
            topic, array = received
            if topic in wanted and conversions.stamp_ns(array.header.stamp) == frame_ns:  # else one of an older frame
                boxes = getattr(output.in_3d, wanted.pop(topic))
                boxes.SetInParent()  # there, also where it is empty: tracks that aren't mean that nothing tracks
                conversions.fill_boxes(array, self._body, boxes)
        return output


def main() -> None:
    """Run as a node."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--detections", required=True, metavar="TOPIC", help="vision_msgs/Detection3DArray")
    parser.add_argument("--tracks", metavar="TOPIC", help="the same, with ids that are numbers")
    parser.add_argument("--timeout-s", type=float, default=5.0, help="so long a frame may take")
    parser.add_argument("--body-frame", default="base_link", help="coordinate frame of the boxes")
    options, _ = parser.parse_known_args()  # ROS's own arguments follow
    topics = [options.detections, *([options.tracks] if options.tracks else [])]
    run(Bridge(_node(topics), options.detections, options.tracks, options.timeout_s, options.body_frame))


def _node(topics: list[str]) -> Ros:
    """A node that spins in a thread of its own."""
    import rclpy
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from vision_msgs.msg import Detection3DArray

    class Node:
        """Publishers are made when they are first needed."""

        types = _types()

        def __init__(self) -> None:
            rclpy.init()
            self._node = rclpy.create_node("fbench_bridge")
            self._publishers: dict[str, Any] = {}
            self._received: queue.Queue[tuple[str, Any]] = queue.Queue()
            for topic in topics:
                self._node.create_subscription(Detection3DArray, topic, self._put(topic), 10)
            threading.Thread(target=rclpy.spin, args=(self._node,), daemon=True).start()

        def _put(self, topic: str) -> Any:
            return lambda message: self._received.put((topic, message))

        def publish(self, topic: str, message: Any, keep: bool = False) -> None:
            if topic not in self._publishers:
                kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
                qos = kept if keep else QoSProfile(depth=10)
                self._publishers[topic] = self._node.create_publisher(type(message), topic, qos)
                _await_subscriber(self._publishers[topic])
            self._publishers[topic].publish(message)

        def receive(self, timeout_s: float) -> tuple[str, Any] | None:
            try:
                return self._received.get(timeout=max(timeout_s, 0.0))
            except queue.Empty:
                return None

    return Node()


def _types() -> Any:
    """The message classes that conversions need."""
    from geometry_msgs.msg import TransformStamped
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, PointField
    from tf2_msgs.msg import TFMessage

    classes = (CameraInfo, Clock, CompressedImage, Image, PointCloud2, PointField, TFMessage, TransformStamped)
    return SimpleNamespace(**{cls.__name__: cls for cls in classes})


def _await_subscriber(publisher: Any) -> None:
    """The first messages are lost on subscribers that haven't found the publisher yet."""
    end = time.monotonic() + 1.0
    while not publisher.get_subscription_count() and time.monotonic() < end:
        time.sleep(0.01)


if __name__ == "__main__":
    main()
