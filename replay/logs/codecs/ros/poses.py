"""TFMessage, Odometry and the poses of geometry_msgs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import Message, Pose
from fbench.replay.logs.codecs.codec import Origin, Probe
from fbench.replay.logs.codecs.ros.cursor import plain_frame
from fbench.replay.logs.codecs.ros.decoder import Decode, MessageReader, find, get, header
from fbench.replay.logs.coordinate_frames import Edge


def edges(message: Any) -> Sequence[tuple[str, Edge]]:
    """Return child and edge of each transform of a TFMessage."""
    return [_edge(part) for part in get(message, "transforms")]


def _edge(part: Any) -> tuple[str, Edge]:
    parent = plain_frame(get(get(part, "header"), "frame_id"))
    pose = get(part, "transform")
    t, q = get(pose, "translation"), get(pose, "rotation")
    edge = Edge(parent, _array(t, "xyz"), _array(q, "xyzw"))
    return plain_frame(get(part, "child_frame_id")), edge


def _array(part: Any, names: str) -> Float64:
    return np.array([get(part, name) for name in names], np.float64)


def transform_reader(decode: Decode, encoding: str) -> MessageReader:
    """TFMessage, which has no coordinate frame of its own."""

    def probe(data: memoryview) -> Probe:
        decode(data)
        return Probe("transform", "")

    def transforms(data: memoryview) -> Sequence[tuple[str, Edge]]:
        return edges(decode(data))

    def stamps(data: memoryview) -> Sequence[int]:
        return [header(part, encoding).stamp_ns for part in get(decode(data), "transforms")]

    return MessageReader(("transform",), probe, transforms=transforms, stamps=stamps)


def pose_reader(decode: Decode, encoding: str) -> MessageReader:
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

    return MessageReader(("odometry",), probe, message)
