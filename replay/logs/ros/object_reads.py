"""What messages with objects, scenes and poses are decoded to."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Message, Pose, Truth
from fbench.replay.logs.codec import Origin, Probe
from fbench.replay.logs.ros.cursor import ROS1, Header, nanoseconds, plain_frame
from fbench.replay.logs.ros.decoder import Decode
from fbench.replay.logs.ros.fields import find, get, header
from fbench.replay.logs.ros.objects import autoware_objects, derived_objects, marker_boxes, shown
from fbench.replay.logs.ros.reads import Reads
from fbench.replay.logs.scenes import scene_boxes
from fbench.replay.logs.truth_part import TruthPart, part_of


def autoware_reads(decode: Decode, encoding: str) -> Reads:
    """DetectedObjects, TrackedObjects, PredictedObjects."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        head = header(message, encoding)
        return _part(autoware_objects(message), (), head, origin)

    return Reads(("truth",), _nowhere("truth"), truth=truth)


def derived_reads(decode: Decode, encoding: str) -> Reads:
    """ObjectArray of derived_object_msgs; objects may have coordinate frames of their own."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        frames = [header(part, encoding).frame_id for part in get(message, "objects")]
        return _part(derived_objects(message), frames, header(message, encoding), origin)

    return Reads(("truth",), _nowhere("truth"), truth=truth)


def marker_reads(decode: Decode, encoding: str) -> Reads:
    """MarkerArray: never ground truth unless the user says so, since it only shows what other topics hold."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        markers = shown(decode(data))
        heads = [header(marker, encoding) for marker in markers]
        stamp_ns = max((head.stamp_ns for head in heads), default=0)
        return _part(marker_boxes(markers), [head.frame_id for head in heads], Header(stamp_ns, ""), origin)

    return Reads(("detections",), _nowhere("detections"), truth=truth)


def scene_reads(decode: Decode, encoding: str) -> Reads:
    """SceneUpdate of foxglove_msgs."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        entities = get(message, "entities")
        stamps = [_time_ns(get(part, "timestamp"), encoding) for part in entities or get(message, "deletions")]
        boxes, frames = scene_boxes(entities)
        return _part(boxes, frames, Header(max(stamps, default=0), ""), origin)

    return Reads(("truth",), _nowhere("truth"), truth=truth)


def pose_reads(decode: Decode, encoding: str) -> Reads:
    """Odometry, PoseStamped, PoseWithCovarianceStamped; only the first says whose pose it is."""

    def probe(data: memoryview) -> Probe:
        found = decode(data)
        child = find(found, "child_frame_id")
        world = header(found, encoding).frame_id
        return Probe("odometry", "" if child is None else plain_frame(str(child)), world)

    def message(kind: str, data: memoryview, origin: Origin) -> Message:
        found = decode(data)
        pose = get(found, "pose")
        pose = get(pose, "pose") if find(pose, "position") is None else pose
        position, rotation = get(pose, "position"), get(pose, "orientation")
        return Pose(
            origin.sensor, header(found, encoding).stamp_ns, origin.log_ns,
            np.array([get(position, name) for name in "xyz"], np.float64),
            np.array([get(rotation, name) for name in "xyzw"], np.float64), origin.frame_number,
        )  # fmt: skip

    return Reads(("odometry",), probe, message)


def _nowhere(kind: str) -> Callable[[memoryview], Probe]:
    return lambda data: Probe(kind, "")


def _part(boxes: Boxes3D, frames: Sequence[str], head: Header, origin: Origin) -> TruthPart:
    truth = Truth(head.stamp_ns, origin.log_ns, boxes, frame_number=origin.frame_number)
    return part_of(truth, tuple(frames), head.frame_id)


def _time_ns(time: Any, encoding: str) -> int:
    sec = get(time, "sec") & 0xFFFFFFFF if encoding == ROS1 else get(time, "sec")
    return nanoseconds(sec, get(time, "nanosec"))


POSES: Mapping[str, Callable[[Decode, str], Reads]] = {
    "nav_msgs/msg/Odometry": pose_reads,
    "geometry_msgs/msg/PoseStamped": pose_reads,
    "geometry_msgs/msg/PoseWithCovarianceStamped": pose_reads,
}
OBJECTS: Mapping[str, Callable[[Decode, str], Reads]] = {
    **{
        f"{package}/msg/{name}Objects": autoware_reads
        for package in ("autoware_perception_msgs", "autoware_auto_perception_msgs")
        for name in ("Detected", "Tracked", "Predicted")
    },
    "derived_object_msgs/msg/ObjectArray": derived_reads,
    "foxglove_msgs/msg/SceneUpdate": scene_reads,
    "visualization_msgs/msg/MarkerArray": marker_reads,
}
UNDEFINED = frozenset(name for name in OBJECTS if not name.startswith("visualization_msgs/"))
"""Types that are read only where the log carries their definition: there are several generations of each."""
