"""Boxes of Autoware's perception messages, derived_object_msgs and RViz's markers, in the coordinate frame of each."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.classes import labels
from fbench.replay.errors import DecodeError
from fbench.replay.logs.box_parts import checked, matrix, orientation, track_ids, turned
from fbench.replay.logs.ros.fields import find, get

_AUTOWARE = ("unknown", "car", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian", "animal", "hazard",
             "over_drivable", "under_drivable")  # fmt: skip
"""Labels of `ObjectClassification` by number."""
_POLYGON = 2
"""Of Autoware's `Shape.type`; cylinders have their diameter for length and width."""
_DERIVED = ("unknown", "unknown_small", "unknown_medium", "unknown_big", "pedestrian", "bike", "car", "truck",
            "motorcycle", "other_vehicle", "barrier", "sign")  # fmt: skip
"""Classifications of `derived_object_msgs/Object` by number."""
_SOLIDS: Mapping[tuple[int, int], tuple[tuple[int, float], ...]] = {
    (1, 3): ((0, 1.0), (1, 1.0), (2, 1.0)), (2, 1): ((0, 2.0),) * 3, (3, 2): ((1, 2.0), (1, 2.0), (0, 1.0)),
}  # fmt: skip
"""Box, sphere and cylinder of `shape_msgs/SolidPrimitive`, by type and number of its dimensions: which of these, times
what, are length, width and height. A radius counts twice.
"""
_CUBE, _ADD = 1, 0
"""Of `visualization_msgs/Marker`."""


def autoware_objects(message: Any) -> Boxes3D:
    """Return the boxes of DetectedObjects, TrackedObjects or PredictedObjects (where they are now, not their paths).

    The class is the most probable one, the score the probability that the object exists; velocities are those of the
    twist, which is given in the object's own axes; of a polygon it is the rectangle around it along the object's axes.

    Raises:
        DecodeError: where a box isn't finite.
    """
    parts = get(message, "objects")
    motions = [get(part, "kinematics") for part in parts]
    poses = [get(get(m, "initial_pose_with_covariance", "pose_with_covariance"), "pose") for m in motions]
    xyzw = matrix([get(pose, "orientation") for pose in poses], "xyzw")
    shift, size = _extents([get(part, "shape") for part in parts])
    return checked(
        Boxes3D(
            matrix([get(pose, "position") for pose in poses], "xyz") + turned(xyzw, shift), size, **orientation(xyzw),
            velocity_mps=turned(xyzw, np.array([_twist(motion) for motion in motions], np.float64).reshape(-1, 3)),
            **labels([_class(get(part, "classification")) for part in parts]),
            score=np.array([get(part, "existence_probability") for part in parts], np.float64),
            track_id=track_ids([_uuid(part) for part in parts]),
        )
    )  # fmt: skip


def derived_objects(message: Any) -> Boxes3D:
    """Return the boxes of an ObjectArray; its twist is in the axes of the header.

    Raises:
        DecodeError: where a box isn't finite, or a shape isn't a box, sphere or cylinder.
    """
    parts = get(message, "objects")
    poses = [get(part, "pose") for part in parts]
    return checked(
        Boxes3D(
            matrix([get(pose, "position") for pose in poses], "xyz"),
            np.array([_solid(get(part, "shape")) for part in parts], np.float64).reshape(-1, 3),
            **orientation(matrix([get(pose, "orientation") for pose in poses], "xyzw")),
            velocity_mps=matrix([get(get(part, "twist"), "linear") for part in parts], "xyz"),
            **labels([_name(_DERIVED, get(part, "classification")) for part in parts]),
            score=np.array([get(part, "classification_certainty") for part in parts], np.float64) / 255,
            track_id=track_ids([get(part, "id") for part in parts]),
        )
    )  # fmt: skip


def shown(message: Any) -> list[Any]:
    """Markers of a MarkerArray that add a cube."""
    return [m for m in get(message, "markers") if get(m, "type") == _CUBE and get(m, "action") == _ADD]


def marker_boxes(markers: Sequence[Any]) -> Boxes3D:
    """Return cubes as boxes; their class is what the text says, else the namespace, their track the marker's id.

    Raises:
        DecodeError: where a box isn't finite.
    """
    poses = [get(marker, "pose") for marker in markers]
    ids = [get(marker, "id") for marker in markers]
    return checked(
        Boxes3D(
            matrix([get(pose, "position") for pose in poses], "xyz"),
            matrix([get(marker, "scale") for marker in markers], "xyz"),
            **orientation(matrix([get(pose, "orientation") for pose in poses], "xyzw")),
            **labels([str(get(marker, "text") or get(marker, "ns")) for marker in markers]),
            track_id=track_ids(ids) if len(set(ids)) == len(ids) else None,
        )
    )  # fmt: skip


def _class(classification: Sequence[Any]) -> str:
    pairs = [(int(get(c, "label")), float(get(c, "probability"))) for c in classification]
    return _name(_AUTOWARE, max(pairs, key=lambda pair: pair[1], default=(0, 0.0))[0])


def _name(names: Sequence[str], number: int) -> str:
    return names[number] if 0 <= number < len(names) else str(number)


def _uuid(part: Any) -> bytes | None:
    found = find(part, "object_id", "id")
    return None if found is None else bytes(get(found, "uuid"))


def _twist(motion: Any) -> tuple[float, ...]:
    twist = get(motion, "initial_twist_with_covariance", "twist_with_covariance")
    if find(motion, "has_twist") is False:
        return (np.nan,) * 3
    linear = get(get(twist, "twist"), "linear")
    return tuple(float(get(linear, name)) for name in "xyz")


def _extents(shapes: Sequence[Any]) -> tuple[Float64, Float64]:
    """Middle, in each object's axes, and size (N, 3)."""
    size = matrix([get(shape, "dimensions") for shape in shapes], "xyz")
    middle = np.zeros_like(size)
    for i, shape in enumerate(shapes):
        corners = matrix(get(get(shape, "footprint"), "points"), "xy")
        if get(shape, "type") == _POLYGON and len(corners):
            low, high = corners.min(axis=0), corners.max(axis=0)
            middle[i, :2], size[i, :2] = (low + high) / 2, high - low
    return middle, size


def _solid(shape: Any) -> list[float]:
    kind, numbers = int(get(shape, "type")), [float(number) for number in get(shape, "dimensions")]
    sides = _SOLIDS.get((kind, len(numbers)))
    if sides is None:
        raise DecodeError(f"shape {kind} of {len(numbers)} sizes isn't a box, sphere or cylinder")
    return [numbers[which] * times for which, times in sides]
