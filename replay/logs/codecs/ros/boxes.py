"""Boxes of vision_msgs, radar_msgs, Autoware, derived_object_msgs, foxglove_msgs and RViz markers.

All functions raise DecodeError where a box isn't finite, there are too many, or the message lacks a field.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.classes import labels
from fbench.replay.data.messages import Truth
from fbench.replay.logs.codecs.boxes import check_boxes, matrix, orientation, rotate, scene_boxes, track_ids
from fbench.replay.logs.codecs.codec import Origin, TruthPart, part_of
from fbench.replay.logs.codecs.ros.cursor import Header
from fbench.replay.logs.codecs.ros.decoder import find, get, header, stamp_ns


def detections3d(message: Any, encoding: str, origin: Origin) -> TruthPart:
    """Read a Detection3DArray; zeros for orientation are yaw 0. Raises DecodeError for several coordinate frames."""
    head, parts = header(message, encoding), get(message, "detections")
    boxes = [get(part, "bbox") for part in parts]
    poses = [get(box, "center") for box in boxes]
    center, size = _vectors(poses, "position"), _vectors(boxes, "size")
    found = check_boxes(Boxes3D(center, size, **_orientation(poses), **_columns(parts)))
    return _part(found, head.stamp_ns, origin, frame_id=_frame_of(parts, head, encoding))


def detections2d(message: Any, encoding: str, origin: Origin) -> TruthPart:
    """Read a Detection2DArray, whose coordinate frame is that of the camera; turned boxes as the rectangle around them.
    vision_msgs doesn't say where pixels have their centers: values are taken as they are, centers at integers. Raises
    DecodeError where boxes are in several coordinate frames.
    """
    head, parts = header(message, encoding), get(message, "detections")
    camera = _frame_of(parts, head, encoding)
    xyxy = np.array([_rectangle(get(part, "bbox")) for part in parts], np.float64).reshape(-1, 4)
    found = check_boxes(Boxes2D(np.array([camera] * len(parts), np.str_), xyxy, **_columns(parts)))
    truth = Truth(head.stamp_ns, origin.log_ns, boxes2d=found, frame_number=origin.frame_number)
    return TruthPart(truth, is_2d=True, frame_id=camera)


def _frame_of(parts: Sequence[Any], whole: Header, encoding: str) -> str:
    """Coordinate frame of an array of detections: that of its header, else the one that all detections name."""
    frames = {name for part in parts if (name := header(part, encoding).frame_id)}
    frames = frames | {whole.frame_id} if whole.frame_id else frames
    if len(frames) > 1:
        raise DecodeError(f"boxes are in several coordinate frames: {', '.join(sorted(frames))}")
    return next(iter(frames), "")


def _columns(parts: Sequence[Any]) -> dict[str, Any]:
    """Class, score and track: those of the most probable hypothesis, the first one of equals."""
    best: list[tuple[str | None, float]] = []
    for part in parts:
        known = [find(result, "hypothesis") or result for result in get(part, "results")]
        pairs = [(str(get(h, "class_id", "id")), float(get(h, "score"))) for h in known]
        best.append(max(pairs, key=lambda pair: pair[1], default=(None, 0.0)))
    scored = all(name is not None for name, _ in best)
    return {
        **labels([name or "" for name, _ in best]),
        "score": np.array([score for _, score in best], np.float64) if scored else None,
        "track_id": track_ids([find(part, "id", "tracking_id") for part in parts]),
    }


def _rectangle(box: Any) -> tuple[float, float, float, float]:
    center = get(box, "center")
    position = find(center, "position") or center
    x, y, theta = float(get(position, "x")), float(get(position, "y")), float(get(center, "theta"))
    w, h = float(get(box, "size_x")), float(get(box, "size_y"))
    if theta:
        c, s = abs(np.cos(theta)), abs(np.sin(theta))
        w, h = w * c + h * s, w * s + h * c
    return x - w / 2, y - h / 2, x + w / 2, y + h / 2


def radar_tracks(message: Any, encoding: str, origin: Origin) -> TruthPart:
    """Read a RadarTracks: sizes along the sensor's axes, so yaw is 0; ids are UUIDs, at first numbers."""
    head, parts = header(message, encoding), get(message, "tracks")
    center, size, velocity = (_vectors(parts, name) for name in ("position", "size", "velocity"))
    names = labels([str(get(part, "classification")) for part in parts])
    uuids = [(part, find(part, "uuid")) for part in parts]
    ids = track_ids([find(part, "track_id") if uuid is None else bytes(get(uuid, "uuid")) for part, uuid in uuids])
    found = Boxes3D(center, size, np.zeros(len(parts)), velocity_mps=velocity, track_id=ids, **names)
    return _part(check_boxes(found), head.stamp_ns, origin, frame_id=head.frame_id)


_AUTOWARE = ("unknown", "car", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian", "animal", "hazard",
             "over_drivable", "under_drivable")  # fmt: skip
"""Labels of `ObjectClassification` by number."""
_POLYGON = 2  # Of Autoware's `Shape.type`; cylinders have their diameter for length and width


def autoware_objects(message: Any, encoding: str, origin: Origin) -> TruthPart:
    """Read DetectedObjects, TrackedObjects or PredictedObjects (where they are now, not their paths). The class is the
    most probable one, the score the probability that the object exists; velocities are those of the twist, which is
    given in the object's own axes; of a polygon it is the rectangle around it along the object's axes.
    """
    head, parts = header(message, encoding), get(message, "objects")
    motions = [get(part, "kinematics") for part in parts]
    poses = [get(get(m, "initial_pose_with_covariance", "pose_with_covariance"), "pose") for m in motions]
    xyzw = matrix([get(pose, "orientation") for pose in poses], "xyzw")
    shift, size = _extents([get(part, "shape") for part in parts])
    ids = ((part, find(part, "object_id", "id")) for part in parts)
    found = Boxes3D(
        _vectors(poses, "position") + rotate(xyzw, shift), size, **orientation(xyzw),
        velocity_mps=rotate(xyzw, np.array([_twist(motion) for motion in motions], np.float64).reshape(-1, 3)),
        **labels([_most_probable(get(part, "classification")) for part in parts]),
        score=np.array([get(part, "existence_probability") for part in parts], np.float64),
        track_id=track_ids([None if id_ is None else bytes(get(id_, "uuid")) for _, id_ in ids]),
    )  # fmt: skip
    return _part(check_boxes(found), head.stamp_ns, origin, frame_id=head.frame_id)


def _extents(shapes: Sequence[Any]) -> tuple[Float64, Float64]:
    """Middle, in each object's axes, and size (N, 3)."""
    size = _vectors(shapes, "dimensions")
    middle = np.zeros_like(size)
    for i, shape in enumerate(shapes):
        corners = matrix(get(get(shape, "footprint"), "points"), "xy")
        if get(shape, "type") == _POLYGON and len(corners):
            low, high = corners.min(axis=0), corners.max(axis=0)
            middle[i, :2], size[i, :2] = (low + high) / 2, high - low
    return middle, size


def _twist(motion: Any) -> tuple[float, ...]:
    twist = get(motion, "initial_twist_with_covariance", "twist_with_covariance")
    if find(motion, "has_twist") is False:
        return (np.nan,) * 3
    linear = get(get(twist, "twist"), "linear")
    return tuple(float(get(linear, name)) for name in "xyz")


def _most_probable(classification: Sequence[Any]) -> str:
    pairs = [(int(get(c, "label")), float(get(c, "probability"))) for c in classification]
    return _name(_AUTOWARE, max(pairs, key=lambda pair: pair[1], default=(0, 0.0))[0])


_DERIVED = ("unknown", "unknown_small", "unknown_medium", "unknown_big", "pedestrian", "bike", "car", "truck",
            "motorcycle", "other_vehicle", "barrier", "sign")  # fmt: skip
"""Classifications of `derived_object_msgs/Object` by number."""
_SOLIDS: Mapping[tuple[int, int], tuple[tuple[int, float], ...]] = {
    (1, 3): ((0, 1.0), (1, 1.0), (2, 1.0)), (2, 1): ((0, 2.0),) * 3, (3, 2): ((1, 2.0), (1, 2.0), (0, 1.0)),
}  # fmt: skip
"""Box, sphere and cylinder of `shape_msgs/SolidPrimitive`, by type and number of its dimensions: which of these, times
what, are length, width and height. A radius counts twice.
"""


def decode_derived_objects(message: Any, encoding: str, origin: Origin) -> TruthPart:
    """Read an ObjectArray or ObjectWithCovarianceArray of derived_object_msgs, whose objects may have coordinate frames
    of their own; its twist is in the axes of the header. Raises DecodeError where a shape isn't a box, sphere or
    cylinder.
    """
    parts = get(message, "objects")
    frames = [header(part, encoding).frame_id for part in parts]
    poses, twists = ([_without_covariance(get(part, name), name) for part in parts] for name in ("pose", "twist"))
    found = Boxes3D(
        _vectors(poses, "position"),
        np.array([_solid(get(part, "shape")) for part in parts], np.float64).reshape(-1, 3), **_orientation(poses),
        velocity_mps=_vectors(twists, "linear"),
        **labels([_name(_DERIVED, get(part, "classification")) for part in parts]),
        score=np.array([get(part, "classification_certainty") for part in parts], np.float64) / 255,
        track_id=track_ids([get(part, "id") for part in parts]),
    )  # fmt: skip
    check_boxes(found)
    head = header(message, encoding)
    return _part(found, head.stamp_ns, origin, frames, head.frame_id)


def _without_covariance(part: Any, name: str) -> Any:
    inner = find(part, name)
    return part if inner is None else inner


def _name(names: Sequence[str], number: int) -> str:
    return names[number] if 0 <= number < len(names) else str(number)


def _solid(shape: Any) -> list[float]:
    kind, numbers = int(get(shape, "type")), [float(number) for number in get(shape, "dimensions")]
    sides = _SOLIDS.get((kind, len(numbers)))
    if sides is None:
        raise DecodeError(f"shape {kind} of {len(numbers)} sizes isn't a box, sphere or cylinder")
    return [numbers[which] * times for which, times in sides]


_CUBE, _ADD = 1, 0  # Of `visualization_msgs/Marker`


def marker_boxes(message: Any, encoding: str, origin: Origin) -> TruthPart:
    """Read the cubes that a MarkerArray adds: never ground truth unless the user says so, since it only shows what
    other topics hold. Their class is what the text says, else the namespace, their track the marker's id.
    """
    markers = [m for m in get(message, "markers") if get(m, "type") == _CUBE and get(m, "action") == _ADD]
    heads = [header(marker, encoding) for marker in markers]
    poses, ids = [get(marker, "pose") for marker in markers], [get(marker, "id") for marker in markers]
    place = _vectors(poses, "position"), _vectors(markers, "scale")
    columns = _orientation(poses) | labels([str(get(marker, "text") or get(marker, "ns")) for marker in markers])
    columns["track_id"] = track_ids(ids) if len(set(ids)) == len(ids) else None
    found = Boxes3D(*place, **columns)
    newest_ns = max((head.stamp_ns for head in heads), default=0)
    return _part(check_boxes(found), newest_ns, origin, [head.frame_id for head in heads])


def scene_update(message: Any, encoding: str, origin: Origin) -> TruthPart:
    """Read a SceneUpdate of foxglove_msgs."""
    entities = get(message, "entities")
    stamps = [stamp_ns(get(part, "timestamp"), encoding) for part in entities or get(message, "deletions")]
    boxes, frames = scene_boxes(entities)
    return _part(boxes, max(stamps, default=0), origin, frames)


def _vectors(parts: Sequence[Any], name: str) -> Float64:
    return matrix([get(part, name) for part in parts], "xyz")


def _orientation(poses: Sequence[Any]) -> dict[str, Any]:
    return orientation(matrix([get(pose, "orientation") for pose in poses], "xyzw"))


def _part(boxes: Boxes3D, stamp_ns: int, origin: Origin, frames: Sequence[str] = (), frame_id: str = "") -> TruthPart:
    truth = Truth(stamp_ns, origin.log_ns, boxes, frame_number=origin.frame_number)
    return part_of(truth, tuple(frames), frame_id)
