"""TFMessage, Odometry and the poses of geometry_msgs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import Pose
from fbench.replay.logs.codecs.codec import Origin, Probe
from fbench.replay.logs.codecs.ros.cursor import plain_frame
from fbench.replay.logs.codecs.ros.decoder import find, get, header
from fbench.replay.logs.coordinate_frames import Edge


def transforms(message: Any) -> Sequence[tuple[str, Edge]]:
    """Child and edge of each transform of a TFMessage."""
    result = []
    for part in get(message, "transforms"):
        parent, pose = plain_frame(get(get(part, "header"), "frame_id")), get(part, "transform")
        t, q = get(pose, "translation"), get(pose, "rotation")
        edge = Edge(parent, _array(t, "xyz"), _array(q, "xyzw"))
        result.append((plain_frame(get(part, "child_frame_id")), edge))
    return result


def stamps(message: Any, encoding: str) -> Sequence[int]:
    """When each transform of a TFMessage holds [ns]."""
    return [header(part, encoding).stamp_ns for part in get(message, "transforms")]


def probe_pose(message: Any, encoding: str) -> Probe:
    """Tell the coordinate frames of a pose; only Odometry says whose it is."""
    child, world = find(message, "child_frame_id"), header(message, encoding).frame_id
    return Probe("odometry", "" if child is None else plain_frame(str(child)), world)


def pose(kind: str, message: Any, encoding: str, origin: Origin) -> Pose:
    """Read an Odometry, PoseStamped or PoseWithCovarianceStamped."""
    found = get(message, "pose")
    found = get(found, "pose") if find(found, "position") is None else found
    position, rotation = get(found, "position"), get(found, "orientation")
    stamp_ns = header(message, encoding).stamp_ns
    t, q = _array(position, "xyz"), _array(rotation, "xyzw")
    return Pose(origin.sensor, stamp_ns, origin.log_ns, t, q, origin.frame_number)


def _array(part: Any, names: str) -> Float64:
    return np.array([get(part, name) for name in names], np.float64)
