"""Rewrite a log as a ROS 2 recorder on another vehicle would have written it: an MCAP file of CDR messages.

Nothing in it speaks of fbench: other topics and names, a transform tree, camera_info, vision_msgs for labels, two
radars instead of one, and if wanted the tracks of a run as the output of a perception stack.

    python examples/ros2_log.py runs/demo/city.mcap drive.mcap
    python examples/ros2_log.py runs/demo/city.mcap drive.mcap --results runs/demo/urban-clear-202/lidar3d --delay-ms 80
"""

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import CameraModel, Rig, RigChange
from fbench.replay.logs.open import open_log
from fbench.replay.runs.folder import Run

_VISION = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}
_NUMPY_CODES = {"<f4": 7, "<u2": 4, "<i4": 5}
_MAST = np.array([0.4, 0.0, 1.2])
"""A link between the body and its sensors, as vehicles have them [m]."""
BODY = "base_link"


class Sent(NamedTuple):
    """One message as it is recorded."""

    topic: str
    log_ns: int
    stamp_ns: int
    message: Any


class Ros:
    """Makes and writes ROS 2 messages."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        types = {}
        for name, text in _VISION.items():
            types |= get_types_from_msg(text, name)
        self._store.register(types)

    def make(self, name: str, *args: Any, **fields: Any) -> Any:
        """Return a message of a type such as `std_msgs/Header`."""
        package, _, short = name.partition("/")
        return self._store.types[f"{package}/msg/{short}"](*args, **fields)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """Return a header."""
        stamp = self.make("builtin_interfaces/Time", stamp_ns // 10**9, stamp_ns % 10**9)
        return self.make("std_msgs/Header", stamp=stamp, frame_id=frame_id)

    def pose(self, xyz: Any, xyzw: Any) -> Any:
        """Return a pose."""
        point = self.make("geometry_msgs/Point", *map(float, xyz))
        return self.make("geometry_msgs/Pose", point, self.make("geometry_msgs/Quaternion", *map(float, xyzw)))

    def vector(self, xyz: Any) -> Any:
        """Return a vector."""
        return self.make("geometry_msgs/Vector3", *map(float, xyz))

    def definition(self, name: str) -> bytes:
        """Return the definition of a type, as recorders embed it."""
        return self._store.generate_msgdef(name, ros_version=2)[0].encode()

    def write(self, message: Any) -> bytes:
        """Return a message as CDR."""
        return bytes(self._store.serialize_cdr(message, message.__msgtype__))


class Names:
    """What the other vehicle calls the sensors."""

    def __init__(self, rig: Rig) -> None:
        self._places = {
            name: place
            for kind, place in (("camera", "front"), ("lidar", "top"), ("radar", "front"))
            for place, name in zip(_number(place), rig.sensors(kind), strict=False)  # type: ignore[arg-type]
        }
        self._kinds = {name: mount.kind for name, mount in rig.mounts.items()}

    def topic(self, sensor: str, what: str) -> str:
        """Topic of a sensor's messages."""
        return f"/sensing/{self._kinds[sensor]}/{self._places[sensor]}{what}"

    def frame(self, sensor: str) -> str:
        """Coordinate frame of a sensor."""
        optical = "_optical_frame" if self._kinds[sensor] == "camera" else "_link"
        return f"{self._kinds[sensor]}_{self._places[sensor]}{optical}"


def _number(place: str) -> Iterator[str]:
    yield place
    number = 2
    while True:
        yield f"{place}_{number}"
        number += 1


def rewrite(source: Path, out: Path, results: Path | None = None, delay_ms: float = 80.0) -> None:
    """Write `out`; `results` is a run folder whose tracks come `delay_ms` after their frames."""
    reader = open_log(source, FaultLog())
    rig = reader.rig
    ros, names = Ros(), Names(rig)
    sent: list[Sent] = []
    start_ns = None
    for message in reader.messages():
        if isinstance(message, RigChange):
            rig = message.rig
        if start_ns is None or isinstance(message, RigChange):
            start_ns = message.log_ns
            sent.append(Sent("/tf_static", start_ns, start_ns, transforms(ros, names, rig, start_ns)))
        if not isinstance(message, RigChange):
            sent += messages(ros, names, rig, message)
    for truth in reader.truths():
        if truth.boxes3d is not None:
            sent.append(labels(ros, "/annotation/objects", truth))
    if results is not None:
        sent += tracks(ros, Run(results), round(delay_ms * 1e6))
    _save(ros, sorted(sent, key=lambda item: (item.log_ns, item.topic)), out)


def messages(ros: Ros, names: Names, rig: Rig, message: Image | PointCloud | RadarScan | Pose) -> Iterator[Sent]:
    """Return what one measurement becomes."""

    def one(topic: str, content: Any) -> Sent:
        return Sent(topic, message.log_ns, message.stamp_ns, content)

    if isinstance(message, Pose):
        yield one("/localization/odometry", odometry(ros, message))
        return
    header = ros.header(message.stamp_ns, names.frame(message.sensor))
    match message:
        case Image():
            camera = names.topic(message.sensor, "")
            data = np.frombuffer(message.data, np.uint8)
            image = ros.make("sensor_msgs/CompressedImage", header=header, format=message.encoding, data=data)
            yield one(f"{camera}/image_color/compressed", image)
            yield one(f"{camera}/camera_info", camera_info(ros, header, rig.cameras[message.sensor]))
        case PointCloud():
            columns = {"x": message.xyz[:, 0], "y": message.xyz[:, 1], "z": message.xyz[:, 2]}
            columns |= {} if message.intensity is None else {"intensity": message.intensity}
            columns |= {} if message.ring is None else {"ring": message.ring}
            yield one(names.topic(message.sensor, "/pointcloud"), cloud(ros, header, columns))
        case RadarScan():
            yield from _two_radars(ros, names, message)


def _two_radars(ros: Ros, names: Names, scan: RadarScan) -> Iterator[Sent]:
    """Split one radar by azimuth: the left half and the right half, as if there were two at one place."""
    for side, rows in (("left", scan.xyz[:, 1] >= 0), ("right", scan.xyz[:, 1] < 0)):
        columns = {"x": scan.xyz[rows, 0], "y": scan.xyz[rows, 1], "z": scan.xyz[rows, 2]}
        columns |= {} if scan.radial_velocity_mps is None else {"doppler": scan.radial_velocity_mps[rows]}
        columns |= {} if scan.rcs_dbsm is None else {"rcs": scan.rcs_dbsm[rows]}
        header = ros.header(scan.stamp_ns, f"{names.frame(scan.sensor)}_{side}")
        topic = names.topic(scan.sensor, f"_{side}/detections")
        yield Sent(topic, scan.log_ns, scan.stamp_ns, cloud(ros, header, columns))


def cloud(ros: Ros, header: Any, columns: Mapping[str, np.ndarray]) -> Any:
    """Return a PointCloud2 of columns (N,)."""
    dtype = np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    rows = np.zeros(len(next(iter(columns.values()))), dtype)
    for name, column in columns.items():
        rows[name] = column
    named = dtype.fields or {}
    fields = [
        ros.make("sensor_msgs/PointField", name, named[name][1], _NUMPY_CODES[dtype[name].str], 1) for name in columns
    ]
    return ros.make(
        "sensor_msgs/PointCloud2", header=header, height=1, width=len(rows), fields=fields, is_bigendian=False,
        point_step=dtype.itemsize, row_step=dtype.itemsize * len(rows), data=rows.view(np.uint8).reshape(-1),
        is_dense=True,
    )  # fmt: skip


def camera_info(ros: Ros, header: Any, camera: CameraModel) -> Any:
    """Return the intrinsics of a camera."""
    projection = np.hstack([camera.K, np.zeros((3, 1))])
    region = ros.make("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False)
    return ros.make(
        "sensor_msgs/CameraInfo", header=header, height=camera.size_wh[1], width=camera.size_wh[0],
        distortion_model=camera.distortion_model or "plumb_bob", d=camera.distortion, k=camera.K.reshape(-1),
        r=np.eye(3).reshape(-1), p=projection.reshape(-1), binning_x=0, binning_y=0, roi=region,
    )  # fmt: skip


def transforms(ros: Ros, names: Names, rig: Rig, stamp_ns: int) -> Any:
    """Return the tree: the body, a mast on it, all sensors on the mast."""
    parts = [_transform(ros, stamp_ns, BODY, "mast", _MAST, (0.0, 0.0, 0.0, 1.0))]
    for name, mount in sorted(rig.mounts.items()):
        sides = ("_left", "_right") if mount.kind == "radar" else ("",)
        for side in sides:
            place = mount.translation_m - _MAST
            parts.append(_transform(ros, stamp_ns, "mast", names.frame(name) + side, place, mount.rotation_xyzw))
    return ros.make("tf2_msgs/TFMessage", parts)


def _transform(ros: Ros, stamp_ns: int, parent: str, child: str, xyz: Any, xyzw: Any) -> Any:
    rotation = ros.make("geometry_msgs/Quaternion", *map(float, xyzw))
    pose = ros.make("geometry_msgs/Transform", ros.vector(xyz), rotation)
    header = ros.header(stamp_ns, parent)
    return ros.make("geometry_msgs/TransformStamped", header=header, child_frame_id=child, transform=pose)


def odometry(ros: Ros, message: Pose) -> Any:
    """Return a pose of the body as odometry; its speed isn't known."""
    covariance = np.zeros(36)
    pose = ros.pose(message.translation_m, message.rotation_xyzw)
    still = ros.make("geometry_msgs/Twist", ros.vector(np.zeros(3)), ros.vector(np.zeros(3)))
    return ros.make(
        "nav_msgs/Odometry", header=ros.header(message.stamp_ns, "odom"), child_frame_id=BODY,
        pose=ros.make("geometry_msgs/PoseWithCovariance", pose, covariance),
        twist=ros.make("geometry_msgs/TwistWithCovariance", still, covariance),
    )  # fmt: skip


def labels(ros: Ros, topic: str, truth: Truth) -> Sent:
    """Return ground truth as a Detection3DArray."""
    boxes = Boxes3D.empty() if truth.boxes3d is None else truth.boxes3d
    return Sent(topic, truth.log_ns, truth.stamp_ns, detections(ros, truth.stamp_ns, boxes))


def tracks(ros: Ros, run: Run, delay_ns: int) -> Iterator[Sent]:
    """Return the tracks of a run, as if a stack on the vehicle had published them a little later."""
    for frame in run.frames:
        boxes = run.tracks.at(frame.index)
        if isinstance(boxes, Boxes3D):
            arrival_ns = frame.stamp_ns + delay_ns
            yield Sent("/perception/tracks", arrival_ns, frame.stamp_ns, detections(ros, frame.stamp_ns, boxes))


def detections(ros: Ros, stamp_ns: int, boxes: Boxes3D) -> Any:
    """Return boxes as a Detection3DArray in body coordinates."""
    return ros.make(
        "vision_msgs/Detection3DArray", header=ros.header(stamp_ns, BODY),
        detections=[_detection(ros, stamp_ns, boxes, i) for i in range(len(boxes))],
    )  # fmt: skip


def _detection(ros: Ros, stamp_ns: int, boxes: Boxes3D, i: int) -> Any:
    names = boxes.label if boxes.source_label is None else boxes.source_label
    label = "" if names is None else str(names[i])
    score = 1.0 if boxes.score is None else float(boxes.score[i])
    angles = [a[i] if a is not None else 0.0 for a in (boxes.yaw_rad, boxes.pitch_rad, boxes.roll_rad)]
    pose = ros.pose(boxes.center_m[i], Rotation.from_euler("ZYX", angles).as_quat())
    unknown = ros.make("geometry_msgs/PoseWithCovariance", pose, np.zeros(36))
    hypothesis = ros.make("vision_msgs/ObjectHypothesis", label, score)
    return ros.make(
        "vision_msgs/Detection3D", header=ros.header(stamp_ns, BODY),
        results=[ros.make("vision_msgs/ObjectHypothesisWithPose", hypothesis, unknown)],
        bbox=ros.make("vision_msgs/BoundingBox3D", pose, ros.vector(boxes.size_lwh_m[i])),
        id="" if boxes.track_id is None else str(boxes.track_id[i]),
    )  # fmt: skip


def _save(ros: Ros, sent: list[Sent], out: Path) -> None:
    channels: dict[str, int] = {}
    with out.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="examples/ros2_log.py")
        for item in sent:
            name = item.message.__msgtype__
            if item.topic not in channels:
                schema = writer.register_schema(name, "ros2msg", ros.definition(name))
                channels[item.topic] = writer.register_channel(item.topic, "cdr", schema)
            writer.add_message(channels[item.topic], item.log_ns, ros.write(item.message), item.log_ns)
        writer.finish()


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, help="a log that fbench reads")
    parser.add_argument("out", type=Path, help="the MCAP file to write")
    parser.add_argument("--results", type=Path, help="a run whose tracks the log shall hold, too")
    parser.add_argument("--delay-ms", type=float, default=80.0, help="how much later than their frame they come")
    options = parser.parse_args()
    rewrite(options.source, options.out, options.results, options.delay_ms)


if __name__ == "__main__":
    main()
