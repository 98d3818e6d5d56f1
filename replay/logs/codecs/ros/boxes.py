"""Boxes of vision_msgs, radar_msgs, Autoware, derived_object_msgs, foxglove_msgs and RViz markers."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.classes import labels
from fbench.replay.data.messages import Truth
from fbench.replay.logs.codecs.boxes import check_boxes, matrix, orientation, rotate, scene_boxes, track_ids
from fbench.replay.logs.codecs.codec import Origin, Probe, TruthPart, part_of
from fbench.replay.logs.codecs.ros.cursor import ROS1, Header, nanoseconds
from fbench.replay.logs.codecs.ros.decoder import Decode, MessageReader, find, get, header, probe_header


def frame_of(message: Any, whole: Header, encoding: str) -> str:
    """Coordinate frame of an array of detections: that of its header, else the one that all detections name. Raises
    DecodeError where detections name several.
    """
    frames = {name for part in get(message, "detections") if (name := header(part, encoding).frame_id)}
    frames = frames | {whole.frame_id} if whole.frame_id else frames
    if len(frames) > 1:
        raise DecodeError(f"boxes are in several coordinate frames: {', '.join(sorted(frames))}")
    return next(iter(frames), "")


def detections3d(message: Any) -> Boxes3D:
    """Return the boxes of a Detection3DArray; an orientation of zeros, which means that none was given, is yaw 0.
    Raises DecodeError where a box isn't finite.
    """
    parts = get(message, "detections")
    boxes = [get(part, "bbox") for part in parts]
    poses = [get(box, "center") for box in boxes]
    return check_boxes(
        Boxes3D(
            matrix([get(pose, "position") for pose in poses], "xyz"), matrix([get(b, "size") for b in boxes], "xyz"),
            **orientation(matrix([get(pose, "orientation") for pose in poses], "xyzw")), **_columns(parts),
        )
    )  # fmt: skip


def detections2d(message: Any, camera: str) -> Boxes2D:
    """Return the boxes of a Detection2DArray, turned ones as the rectangle around them.

    vision_msgs doesn't say where pixels have their centers: values are taken as they are, centers at integers. Raises
    DecodeError where a box isn't finite.
    """
    parts = get(message, "detections")
    xyxy = np.array([_rectangle(get(part, "bbox")) for part in parts], np.float64).reshape(-1, 4)
    return check_boxes(Boxes2D(np.array([camera] * len(parts), np.str_), xyxy, **_columns(parts)))


def radar_tracks(message: Any) -> Boxes3D:
    """Return the boxes of a RadarTracks: sizes along the axes of the sensor, so yaw is 0.

    Their ids are UUIDs, in the first generation numbers. Raises DecodeError where a box isn't finite.
    """
    parts = get(message, "tracks")
    center, size, velocity = (matrix([get(p, n) for p in parts], "xyz") for n in ("position", "size", "velocity"))
    names = labels([str(get(part, "classification")) for part in parts])
    ids = track_ids([_id(part) for part in parts])
    return check_boxes(Boxes3D(center, size, np.zeros(len(parts)), velocity_mps=velocity, track_id=ids, **names))


def _id(track: Any) -> object:
    uuid = find(track, "uuid")
    return find(track, "track_id") if uuid is None else bytes(get(uuid, "uuid"))


def _columns(parts: Sequence[Any]) -> dict[str, Any]:
    """Class, score and track: those of the most probable hypothesis, the first one of equals."""
    best = [_best(get(part, "results")) for part in parts]
    scored = all(name is not None for name, _ in best)
    return {
        **labels([name or "" for name, _ in best]),
        "score": np.array([score for _, score in best], np.float64) if scored else None,
        "track_id": track_ids([find(part, "id", "tracking_id") for part in parts]),
    }


def _best(results: Sequence[Any]) -> tuple[str | None, float]:
    known = [find(result, "hypothesis") or result for result in results]
    pairs = [(str(get(h, "class_id", "id")), float(get(h, "score"))) for h in known]
    return max(pairs, key=lambda pair: pair[1], default=(None, 0.0))


def _rectangle(box: Any) -> tuple[float, float, float, float]:
    center = get(box, "center")
    position = find(center, "position") or center
    x, y, theta = float(get(position, "x")), float(get(position, "y")), float(get(center, "theta"))
    w, h = float(get(box, "size_x")), float(get(box, "size_y"))
    if theta:
        c, s = abs(np.cos(theta)), abs(np.sin(theta))
        w, h = w * c + h * s, w * s + h * c
    return x - w / 2, y - h / 2, x + w / 2, y + h / 2


def _part_2d_or_3d(found: Boxes3D | Boxes2D, head: Header, frame_id: str, origin: Origin) -> TruthPart:
    stamp_ns, is_2d = head.stamp_ns, isinstance(found, Boxes2D)
    columns: dict[str, Any] = {"boxes2d" if is_2d else "boxes3d": found}
    truth = Truth(stamp_ns, origin.log_ns, **columns, frame_number=origin.frame_number)
    return TruthPart(truth, is_2d, frame_id=frame_id)


def detections3d_reader(decode: Decode, encoding: str) -> MessageReader:
    """Detection3DArray."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        head = header(message, encoding)
        return _part_2d_or_3d(detections3d(message), head, frame_of(message, head, encoding), origin)

    return MessageReader(("truth",), probe_header("truth", decode, encoding), truth=truth)


def detections2d_reader(decode: Decode, encoding: str) -> MessageReader:
    """Detection2DArray; the coordinate frame is that of the camera."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        head = header(message, encoding)
        frame_id = frame_of(message, head, encoding)
        return _part_2d_or_3d(detections2d(message, frame_id), head, frame_id, origin)

    return MessageReader(("truth",), probe_header("truth", decode, encoding), truth=truth)


def radar_tracks_reader(decode: Decode, encoding: str) -> MessageReader:
    """RadarTracks."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        head = header(message, encoding)
        return _part_2d_or_3d(radar_tracks(message), head, head.frame_id, origin)

    return MessageReader(("truth",), probe_header("truth", decode, encoding), truth=truth)


_AUTOWARE = ("unknown", "car", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian", "animal", "hazard",
             "over_drivable", "under_drivable")  # fmt: skip
"""Labels of `ObjectClassification` by number."""


_POLYGON = 2  # Of Autoware's `Shape.type`; cylinders have their diameter for length and width


_DERIVED = ("unknown", "unknown_small", "unknown_medium", "unknown_big", "pedestrian", "bike", "car", "truck",
            "motorcycle", "other_vehicle", "barrier", "sign")  # fmt: skip
"""Classifications of `derived_object_msgs/Object` by number."""


_SOLIDS: Mapping[tuple[int, int], tuple[tuple[int, float], ...]] = {
    (1, 3): ((0, 1.0), (1, 1.0), (2, 1.0)), (2, 1): ((0, 2.0),) * 3, (3, 2): ((1, 2.0), (1, 2.0), (0, 1.0)),
}  # fmt: skip
"""Box, sphere and cylinder of `shape_msgs/SolidPrimitive`, by type and number of its dimensions: which of these, times
what, are length, width and height. A radius counts twice.
"""


_CUBE, _ADD = 1, 0  # Of `visualization_msgs/Marker`


def autoware_objects(message: Any) -> Boxes3D:
    """Return the boxes of DetectedObjects, TrackedObjects or PredictedObjects (where they are now, not their paths).

    The class is the most probable one, the score the probability that the object exists; velocities are those of the
    twist, which is given in the object's own axes; of a polygon it is the rectangle around it along the object's axes.
    Raises DecodeError where a box isn't finite.
    """
    parts = get(message, "objects")
    motions = [get(part, "kinematics") for part in parts]
    poses = [get(get(m, "initial_pose_with_covariance", "pose_with_covariance"), "pose") for m in motions]
    xyzw = matrix([get(pose, "orientation") for pose in poses], "xyzw")
    shift, size = _extents([get(part, "shape") for part in parts])
    return check_boxes(
        Boxes3D(
            matrix([get(pose, "position") for pose in poses], "xyz") + rotate(xyzw, shift), size, **orientation(xyzw),
            velocity_mps=rotate(xyzw, np.array([_twist(motion) for motion in motions], np.float64).reshape(-1, 3)),
            **labels([_class(get(part, "classification")) for part in parts]),
            score=np.array([get(part, "existence_probability") for part in parts], np.float64),
            track_id=track_ids([_uuid(part) for part in parts]),
        )
    )  # fmt: skip


def derived_objects(message: Any) -> Boxes3D:
    """Return the boxes of an ObjectArray; its twist is in the axes of the header. Raises DecodeError where a box isn't
    finite, or a shape isn't a box, sphere or cylinder.
    """
    parts = get(message, "objects")
    poses = [get(part, "pose") for part in parts]
    return check_boxes(
        Boxes3D(
            matrix([get(pose, "position") for pose in poses], "xyz"),
            np.array([_solid(get(part, "shape")) for part in parts], np.float64).reshape(-1, 3),
            **orientation(matrix([get(pose, "orientation") for pose in poses], "xyzw")),
            velocity_mps=matrix([get(get(part, "twist"), "linear") for part in parts], "xyz"),
            **labels([_name(_DERIVED, get(part, "classification")) for part in parts]),
            score=np.array([get(part, "classification_certainty") for part in parts], np.float64) / 255,
            track_id=track_ids([get(part, "id") for part in parts]),
        )
    )


def select_cubes(message: Any) -> list[Any]:
    """Markers of a MarkerArray that add a cube."""
    return [m for m in get(message, "markers") if get(m, "type") == _CUBE and get(m, "action") == _ADD]


def marker_boxes(markers: Sequence[Any]) -> Boxes3D:
    """Return cubes as boxes; their class is what the text says, else the namespace, their track the marker's id. Raises
    DecodeError where a box isn't finite.
    """
    poses = [get(marker, "pose") for marker in markers]
    ids = [get(marker, "id") for marker in markers]
    return check_boxes(
        Boxes3D(
            matrix([get(pose, "position") for pose in poses], "xyz"),
            matrix([get(marker, "scale") for marker in markers], "xyz"),
            **orientation(matrix([get(pose, "orientation") for pose in poses], "xyzw")),
            **labels([str(get(marker, "text") or get(marker, "ns")) for marker in markers]),
            track_id=track_ids(ids) if len(set(ids)) == len(ids) else None,
        )
    )


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


def autoware_objects_reader(decode: Decode, encoding: str) -> MessageReader:
    """DetectedObjects, TrackedObjects, PredictedObjects."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        head = header(message, encoding)
        return _part(autoware_objects(message), (), head, origin)

    return MessageReader(("truth",), _nowhere("truth"), truth=truth)


def derived_objects_reader(decode: Decode, encoding: str) -> MessageReader:
    """ObjectArray of derived_object_msgs; objects may have coordinate frames of their own."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        frames = [header(part, encoding).frame_id for part in get(message, "objects")]
        return _part(derived_objects(message), frames, header(message, encoding), origin)

    return MessageReader(("truth",), _nowhere("truth"), truth=truth)


def marker_reader(decode: Decode, encoding: str) -> MessageReader:
    """MarkerArray: never ground truth unless the user says so, since it only shows what other topics hold."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        markers = select_cubes(decode(data))
        heads = [header(marker, encoding) for marker in markers]
        stamp_ns = max((head.stamp_ns for head in heads), default=0)
        return _part(marker_boxes(markers), [head.frame_id for head in heads], Header(stamp_ns, ""), origin)

    return MessageReader(("detections",), _nowhere("detections"), truth=truth)


def scene_update_reader(decode: Decode, encoding: str) -> MessageReader:
    """SceneUpdate of foxglove_msgs."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        entities = get(message, "entities")
        stamps = [_time_ns(get(part, "timestamp"), encoding) for part in entities or get(message, "deletions")]
        boxes, frames = scene_boxes(entities)
        return _part(boxes, frames, Header(max(stamps, default=0), ""), origin)

    return MessageReader(("truth",), _nowhere("truth"), truth=truth)


def _nowhere(kind: str) -> Callable[[memoryview], Probe]:
    return lambda data: Probe(kind, "")


def _time_ns(time: Any, encoding: str) -> int:
    sec = get(time, "sec") & 0xFFFFFFFF if encoding == ROS1 else get(time, "sec")
    return nanoseconds(sec, get(time, "nanosec"))


def _part(boxes: Boxes3D, frames: Sequence[str], head: Header, origin: Origin) -> TruthPart:
    truth = Truth(head.stamp_ns, origin.log_ns, boxes, frame_number=origin.frame_number)
    return part_of(truth, tuple(frames), head.frame_id)
