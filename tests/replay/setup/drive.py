"""A drive as a ROS 2 recorder would write it: four cameras, two LiDARs, five radars, transforms, odometry and boxes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tests.replay.logs.codecs.ros.builders import Ros, cloud, structured

from fbench.replay.data.images import encode_jpeg

ROS = Ros(Stores.ROS2_HUMBLE)
START_NS = 1_700_000_000_000_000_000
MS = 1_000_000
SIZE_WH = (80, 60)
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
JPEG = encode_jpeg(np.full((60, 80, 3), 90, np.uint8))


def stamp(ns: int) -> tuple[int, int]:
    return divmod(ns, 1_000_000_000)


@dataclass
class Drive:
    """Messages to write: topic, type, log time, message."""

    rows: list[tuple[int, str, str, Any]] = field(default_factory=list)

    def add(self, topic: str, log_ns: int, message: Any) -> None:
        self.rows.append((log_ns, topic, message.__msgtype__, message))

    def write(self, path: Path) -> Path:
        with path.open("wb") as file:
            writer = Writer(file, chunk_size=200_000)
            writer.start(profile="ros2")
            ids: dict[str, int] = {}
            for log_ns, topic, kind, message in sorted(self.rows, key=lambda row: row[:2]):
                if topic not in ids:
                    schema = ROS.schema(kind)
                    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                    ids[topic] = writer.register_channel(topic, "cdr", schema_id)
                writer.add_message(ids[topic], log_ns, bytes(ROS.write(message)), log_ns)
            writer.finish()
        return path

    def write_bag1(self, path: Path, compression: str = "none") -> Path:
        """Write the same messages as a bag of ROS 1."""
        writer = Writer1(path)
        writer.chunk_threshold = 20_000
        if compression != "none":
            writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        with writer:
            ids: dict[str, Any] = {}
            for log_ns, topic, kind, message in sorted(self.rows, key=lambda row: row[:2]):
                if topic not in ids:
                    text, md5 = NOETIC.generate_msgdef(kind, ros_version=1)
                    ids[topic] = writer.add_connection(topic, kind, msgdef=text, md5sum=md5)
                writer.write(ids[topic], log_ns, bytes(ROS.store.cdr_to_ros1(bytes(ROS.write(message)), kind)))
        return path

    def write_bag2(self, folder: Path, storage: str = "sqlite3") -> Path:
        """Write the same messages as rosbag2 does."""
        with Writer2(folder, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
            ids: dict[str, Any] = {}
            for log_ns, topic, kind, message in sorted(self.rows, key=lambda row: row[:2]):
                if topic not in ids:
                    ids[topic] = writer.add_connection(topic, kind, typestore=ROS.store)
                writer.write(ids[topic], log_ns, bytes(ROS.write(message)))
        return folder


def points(frame: str, ns: int, num: int = 200, **columns: Any) -> Any:
    xyz = np.random.Generator(np.random.Philox(num)).uniform(-30, 30, (num, 3)).astype(np.float32)
    rows = structured(x=xyz[:, 0], y=xyz[:, 1], z=xyz[:, 2], intensity=xyz[:, 2], **columns)
    return cloud(ROS, rows, frame_id=frame, stamp=stamp(ns))


def radar_points(
    frame: str,
    ns: int,
    speed_mps: float,
    yaw_rad: float = 0.0,
    sign: int = 1,
    field_name: str = "velocity",
    num: int = 60,
) -> Any:
    """What a radar that looks along `yaw_rad` sees of things that stand still, from a vehicle that drives forward; a
    tenth of the points move on their own.
    """
    rng = np.random.Generator(np.random.Philox(int(ns % 1000) + num))
    azimuth, distance = rng.uniform(-0.9, 0.9, num), rng.uniform(5, 60, num)
    rate = -speed_mps * np.cos(azimuth + yaw_rad) + rng.normal(0, 0.03, num)
    rate[: num // 10] += 7.0
    f4 = np.float32
    rows = structured(
        x=(distance * np.cos(azimuth)).astype(f4), y=(distance * np.sin(azimuth)).astype(f4), z=np.zeros(num, f4),
        **{field_name: (sign * rate).astype(f4)}, rcs=np.ones(num, f4),
    )  # fmt: skip
    return cloud(ROS, rows, frame_id=frame, stamp=stamp(ns))


def raw_image(frame: str, ns: int, encoding: str = "mono8") -> Any:
    pixels = np.zeros(SIZE_WH[0] * SIZE_WH[1] * (2 if "16" in encoding else 1), np.uint8)
    step = len(pixels) // SIZE_WH[1]
    return ROS.make(
        "sensor_msgs/msg/Image", ROS.header(frame, stamp(ns)), SIZE_WH[1], SIZE_WH[0], encoding, 0, step, pixels
    )


def jpeg(frame: str, ns: int, form: str = "jpeg") -> Any:
    return ROS.make(
        "sensor_msgs/msg/CompressedImage", ROS.header(frame, stamp(ns)), form, np.frombuffer(JPEG, np.uint8)
    )


def info(frame: str, ns: int, size_wh: tuple[int, int] = SIZE_WH, distortion: Sequence[float] = (0.0,) * 5) -> Any:
    roi = ROS.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    K = np.array([60.0, 0, 39.5, 0, 60, 29.5, 0, 0, 1])
    return ROS.make(
        "sensor_msgs/msg/CameraInfo", ROS.header(frame, stamp(ns)), size_wh[1], size_wh[0], "plumb_bob",
        np.array(distortion, np.float64), K, np.eye(3).ravel(), np.zeros(12), 0, 0, roi,
    )  # fmt: skip


def transforms(edges: Sequence[tuple[str, str, Sequence[float], Sequence[float]]], ns: int = START_NS) -> Any:
    parts = [
        ROS.make(
            "geometry_msgs/msg/TransformStamped", ROS.header(parent, stamp(ns)), child,
            ROS.make(
                "geometry_msgs/msg/Transform", ROS.make("geometry_msgs/msg/Vector3", *map(float, xyz)),
                ROS.make("geometry_msgs/msg/Quaternion", *map(float, xyzw)),
            ),
        )
        for parent, child, xyz, xyzw in edges
    ]  # fmt: skip
    return ROS.make("tf2_msgs/msg/TFMessage", parts)


def odometry(ns: int, x: float, child: str = "base_link") -> Any:
    point = ROS.make("geometry_msgs/msg/Point", x, 0.0, 0.0)
    pose = ROS.make("geometry_msgs/msg/Pose", point, ROS.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
    zero = ROS.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    twist = ROS.make("geometry_msgs/msg/Twist", zero, zero)
    return ROS.make(
        "nav_msgs/msg/Odometry", ROS.header("odom", stamp(ns)), child,
        ROS.make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
        ROS.make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
    )  # fmt: skip


VISION = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id\n"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nDetection3D[] detections\n",
}


NOETIC = get_typestore(Stores.ROS1_NOETIC)


def _register() -> None:
    more = {**VISION, "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms"}
    for store in (ROS.store, NOETIC):
        for name, text in more.items():
            if name not in store.types:
                store.register(get_types_from_msg(text, name))


_register()


def boxes(ns: int, names: Sequence[str], frame: str = "base_link") -> Any:
    make = ROS.make
    pose = make(
        "geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", 12.0, 0.0, 0.8),
        make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0),
    )  # fmt: skip
    whole = make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))

    def hypothesis(name: str) -> Any:
        return make("vision_msgs/msg/ObjectHypothesis", name, 1.0)

    found = [
        make(
            "vision_msgs/msg/Detection3D", ROS.header(frame, stamp(ns)),
            [make("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis(name), whole)],
            make("vision_msgs/msg/BoundingBox3D", pose, make("geometry_msgs/msg/Vector3", 4.0, 1.8, 1.6)), str(i),
        )
        for i, name in enumerate(names)
    ]  # fmt: skip
    return make("vision_msgs/msg/Detection3DArray", ROS.header(frame, stamp(ns)), found)


RADARS = {"front": 0.0, "front_left": 0.8, "front_right": -0.8, "rear_left": 2.4, "rear_right": -2.4}
CAMERAS = ("front", "left", "rear", "right")


def static() -> list[tuple[str, str, Sequence[float], Sequence[float]]]:
    edges: list[tuple[str, str, Sequence[float], Sequence[float]]] = [
        ("base_link", "lidar_top", (0, 0, 1.8), (0, 0, 0, 1)), ("base_link", "lidar_rear", (-2, 0, 1.0), (0, 0, 0, 1))
    ]  # fmt: skip
    for name, yaw in RADARS.items():
        edges.append(("base_link", f"radar_{name}", (0, 0, 0.5), (0, 0, np.sin(yaw / 2), np.cos(yaw / 2))))
    return [*edges, *(("base_link", f"camera_{name}_optical", (0, 0, 1.5), OPTICAL) for name in CAMERAS)]


Speed = Callable[[int], float]


def steps(num: int, period_ms: float) -> Iterator[tuple[int, int]]:
    for i in range(num):
        yield i, START_NS + round(i * period_ms * MS)


def drive(num: int = 20, speed_mps: float = 9.0, odometry_too: bool = True) -> Drive:
    """Two seconds of everything; `front_right` gives approaching as positive, `rear_left` removed the motion."""
    d = Drive()
    d.add("/tf_static", START_NS, transforms(static()))
    for i, ns in steps(num, 100):
        for name in CAMERAS:
            frame, folder = f"camera_{name}_optical", f"/sensing/camera/{name}"
            d.add(f"{folder}/camera_info", ns + 20 * MS, info(frame, ns, distortion=(0.1, 0, 0, 0, 0)))
            d.add(f"{folder}/image_raw", ns + 55 * MS, raw_image(frame, ns))
            d.add(f"{folder}/image_raw/compressed", ns + 60 * MS, jpeg(frame, ns))
            d.add(f"{folder}/image_rect", ns + 70 * MS, raw_image(frame, ns))
        for name in ("top", "rear"):
            d.add(f"/sensing/lidar/{name}/pointcloud_raw", ns + 10 * MS, points(f"lidar_{name}", ns))
        d.add("/sensing/lidar/concatenated/pointcloud", ns + 12 * MS, points("base_link", ns, 400))
        d.add("/map/pointcloud", ns + 1 * MS, points("map", ns))
        d.add("/labels/objects", ns + 2 * MS, boxes(ns, ["Car", "CAR", "ufo 7"] if i % 2 else ["Car"]))
        d.add("/depth/image", ns + 3 * MS, raw_image("camera_front_optical", ns, "32FC1"))
        for name, yaw in RADARS.items():
            moving, sign = (0.0 if name == "rear_left" else speed_mps), (-1 if name == "front_right" else 1)
            message = radar_points(f"radar_{name}", ns, moving, yaw, sign)
            d.add(f"/sensing/radar/{name}/points", ns + 15 * MS, message)
    for _, ns in steps(num * 5 if odometry_too else 0, 20):
        d.add("/localization/odometry", ns + 1 * MS, odometry(ns, speed_mps * (ns - START_NS) / 1e9))
    return d
