"""ASAM OpenLABEL 1.0: read cuboids and bounding boxes of objects by frame."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes3D, concatenate
from fbench.replay.data.messages import Truth
from fbench.replay.formats.documents import items, mapping, member, read_json, scalar, text, vector
from fbench.replay.formats.objects import (
    Flat,
    LabeledObject,
    Solid,
    angles,
    body_T,
    default_camera,
    find_camera,
    place,
    to_boxes2d,
    to_boxes3d,
)
from fbench.replay.formats.text import frame_number, stamp_of_time, track_number
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import inverse, pose_matrix
from fbench.replay.logs.coordinate_frames import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

WORLD = "world"


_Edge = tuple[str, Float64]  # The parent of a coordinate system, and its pose (4, 4) there: parent_T_child
_NUMBERS = {
    "score": "score", "confidence": "score", "occlusion": "occlusion", "truncation": "truncation",
    "visibility": "visibility", "num_points": "num_lidar_pts", "num_lidar_pts": "num_lidar_pts",
}  # fmt: skip
"""Fields of fbench by the names of numbers among an object's attributes."""
_UNUSED = ("poly2d", "poly3d", "point2d", "point3d", "rbbox", "mat", "binary", "image", "mesh", "area_reference")


class CoordinateSystems:
    """Finds the way from a coordinate system to the body, or to the world.

    A name that the log knows means what it means there. Others are followed through `transforms` of the frame, then
    `pose_wrt_parent`, until the log knows one, or one is of a type `local...`, which is the body (`scene...` and
    `geo...`: the world). What leads nowhere is taken for the coordinate frame that the user names.
    """

    def __init__(self, root: Mapping[str, Any], coordinates: CoordinateFrames, source: BoxSource) -> None:
        where = str(source.path)
        self._coordinates, self._default = coordinates, source.frame
        self._types: dict[str, str] = {}
        self._edges: dict[str, _Edge] = {}
        for name, value in member(root, "coordinate_systems", where).items():
            at = f"{where}: coordinate system '{name[:60]}'"
            system = mapping(value, at)
            self._types[name] = text(system.get("type"), f"{at}: type").lower()
            parent = text(system.get("parent"), f"{at}: parent")
            if parent and system.get("pose_wrt_parent") is not None:
                self._edges[name] = parent, _matrix(system["pose_wrt_parent"], at)

    def of_frame(self, properties: Mapping[str, Any], where: str) -> dict[str, _Edge]:
        """Read the transforms of one frame, by the coordinate system that they start from."""
        found: dict[str, _Edge] = {}
        for name, value in member(properties, "transforms", where).items():
            at = f"{where}: transform '{name[:60]}'"
            given = mapping(value, at)
            source, destination = text(given.get("src"), f"{at}: src"), text(given.get("dst"), f"{at}: dst")
            found[source] = destination, _matrix(given.get("transform_src_to_dst"), at)
        return found

    def target(self, name: str, moving: Mapping[str, _Edge], where: str) -> tuple[str, Float64]:
        """Return `body` or `world`, and the matrix (4, 4) to it. LogError: a loop. ConfigError: nothing leads there."""
        matrix, met, at = np.eye(4), {name: None}, name
        while True:
            if self._is_world(at):
                return self._from_world(at, matrix, moving, where)
            if self._is_known(at):
                return "body", body_T(at, self._coordinates, where) @ matrix
            if self._types.get(at, "").startswith("local"):
                return "body", matrix
            edge = moving.get(at, self._edges.get(at))
            if edge is None and self._default and at != self._default:
                edge = self._default, np.eye(4)
            if edge is None:
                return "body", body_T(at, self._coordinates, where) @ matrix
            at, matrix = edge[0], edge[1] @ matrix
            if at in met:
                raise LogError(f"{where}: coordinate systems form a loop at '{at[:60]}'")
            met[at] = None

    def _is_known(self, name: str) -> bool:
        known = self._coordinates
        return name in ("", "body", known.body) or name in known.rig.mounts or name in known.tree.edges

    def _is_world(self, name: str) -> bool:
        return self._coordinates.is_world(name) or self._types.get(name, "").startswith(("scene", "geo"))

    def _from_world(self, world: str, matrix: Float64, moving: Mapping[str, _Edge], where: str) -> tuple[str, Float64]:
        """The file's own pose of the body at this frame goes before the log's."""
        for name, (parent, parent_T_child) in moving.items():
            if parent == world and not self._is_world(name):
                if self._is_known(name):
                    return "body", body_T(name, self._coordinates, where) @ inverse(parent_T_child) @ matrix
                if self._types.get(name, "").startswith("local"):
                    return "body", inverse(parent_T_child) @ matrix
        return WORLD, matrix


def _matrix(value: object, where: str) -> Float64:
    """A transform: 16 numbers (rows), or x, y, z, w, or angles about x, y, z, R = Rz Ry Rx if no `sequence` differs."""
    from scipy.spatial.transform import Rotation  # takes a while to import

    given = mapping(value, where)
    if "matrix4x4" in given:
        matrix = np.array(vector(given["matrix4x4"], (16,), f"{where}: matrix4x4")).reshape(4, 4)
        _require_rigid(matrix, where)
        return matrix
    translation = vector(given.get("translation"), (3,), f"{where}: translation")
    try:
        if "quaternion" in given:
            rotation = Rotation.from_quat(vector(given["quaternion"], (4,), f"{where}: quaternion"))
        else:
            sequence = text(given.get("sequence"), f"{where}: sequence") or "zyx"
            xyz = vector(given.get("euler_angles"), (3,), f"{where}: euler_angles")
            axes = sequence.upper()  # From left to right in the product of matrices
            if sorted(axes) != ["X", "Y", "Z"]:
                raise ValueError(f"sequence is '{sequence[:20]}', expected zyx or another order of x, y, z")
            rotation = Rotation.from_euler(axes, [xyz["XYZ".index(axis)] for axis in axes])
        matrix = pose_matrix(translation, rotation.as_quat())
    except ValueError as error:
        raise LogError(f"{where}: no valid rotation ({error})") from error
    _require_rigid(matrix, where)
    return matrix


def _require_rigid(matrix: Float64, where: str) -> None:
    rotation = matrix[:3, :3]
    good = np.isfinite(matrix).all() and np.array_equal(matrix[3], [0, 0, 0, 1])
    if not good or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise LogError(f"{where}: is no rigid transform", "CAL001")


def _make_object(
    name: str, uid: str, solid: Solid | None, flat: Flat | None, given: Sequence[Mapping[str, Any]], where: str
) -> LabeledObject:
    """Make an object with what the numbers among its data say."""
    values: dict[str, float] = {}
    for source in given:
        for item in items(source.get("num", []), f"{where}: num"):
            entry = mapping(item, f"{where}: num")
            if (key := _NUMBERS.get(str(entry.get("name", "")).lower())) is not None:
                values[key] = scalar(entry.get("val"), f"{where}: {key}")
    points = values.get("num_lidar_pts", np.nan)
    return LabeledObject(
        name, solid, flat, track_id=track_number(uid), score=values.get("score"),
        visibility=values.get("visibility"), occlusion=values.get("occlusion"), truncation=values.get("truncation"),
        num_lidar_pts=int(points) if 0 <= points < 2**31 else None,
    )  # fmt: skip


def open_openlabel(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read the frames of a file. A frame's `timestamp` says when it was; where none has one, keys count frames. Raises
    ConfigError where a coordinate system or camera isn't known, LogError where the form isn't that of OpenLABEL.
    """
    where = str(source.path)
    root = member(read_json(source.path), "openlabel", where)
    frames = member(root, "frames", where)
    if not frames:
        raise LogError(f"{where}: no frames; boxes that belong to no frame can't be scored")
    reader = _Reader(root, source, coordinates, faults)
    instants: list[tuple[int, int, str]] = []  # Stamp (-1: none), number and key
    for key, value in frames.items():
        at = f"{where}: frame '{key[:40]}'"
        given = member(value, "frame_properties", at).get("timestamp")
        try:
            stamp = given if isinstance(given, str) or given is None else repr(scalar(given, f"{at}: timestamp"))
            instants.append((-1, frame_number(key, at), key) if stamp is None else (stamp_of_time(stamp), 0, key))
        except ValueError as error:
            raise LogError(f"{at}: timestamp {error}") from error
    if len({stamp_ns >= 0 for stamp_ns, _, _ in instants}) > 1:
        raise LogError(f"{where}: some frames have a timestamp and some don't")
    for stamp_ns, number, key in sorted(instants):
        boxes3d, boxes2d, in_world = reader.boxes(key, frames[key])
        if stamp_ns >= 0:
            yield Truth(stamp_ns, stamp_ns, boxes3d, boxes2d, in_world=in_world)
        else:
            yield Truth(0, 0, boxes3d, boxes2d, number, number, in_world)


class _Reader:
    """Reads single frames."""

    def __init__(self, root: Mapping[str, Any], source: BoxSource, known: CoordinateFrames, faults: FaultLog) -> None:
        self._where, self._source, self._coordinates, self._faults = str(source.path), source, known, faults
        self._camera_option = default_camera(source, known)
        self._objects = member(root, "objects", self._where)
        self._streams = member(root, "streams", self._where)
        self._systems = CoordinateSystems(root, known, source)
        kinds: set[str] = set()
        for key, frame in mapping(root["frames"], self._where).items():
            at = f"{self._where}: frame '{key[:40]}'"
            for uid, value in member(frame, "objects", at).items():
                kinds.update(member(value, "object_data", f"{at} object '{uid[:60]}'"))
        self._is_solid, self._is_flat = "cuboid" in kinds, "bbox" in kinds

    def boxes(self, key: str, frame: object) -> tuple[Any, Any, bool]:
        """Return 3D boxes, 2D boxes, and whether the former are in the world."""
        at = f"{self._where}: frame '{key[:40]}'"
        objects: list[LabeledObject] = []
        systems: list[str] = []  # of each 3D box
        for uid, value in member(frame, "objects", at).items():
            self._add(objects, systems, uid, value, f"{at} object '{uid[:60]}'")
        moving = self._systems.of_frame(member(frame, "frame_properties", at), at)
        boxes3d, in_world = self._place(objects, systems, moving, at)
        return boxes3d if self._is_solid else None, to_boxes2d(objects) if self._is_flat else None, in_world

    def _add(self, objects: list[LabeledObject], systems: list[str], uid: str, value: object, where: str) -> None:
        known = member(self._objects, uid, where)
        own = mapping(value, where)
        data = member(own, "object_data", where)
        name = text(own.get("type", known.get("type")), f"{where}: type")
        system = text(own.get("coordinate_system", known.get("coordinate_system")), f"{where}: coordinate_system")
        for i, item in enumerate(items(data.get("cuboid", []), f"{where}: cuboid")):
            at = f"{where} cuboid {i}"
            box = mapping(item, at)
            systems.append(text(box.get("coordinate_system"), f"{at}: coordinate_system") or system)
            # Position, then x, y, z, w, or angles about x, y, z with R = Rz Ry Rx, then size.
            x, y, z, *turn, length, width, height = vector(box.get("val"), (9, 10), f"{at}: val")
            yaw_pitch_roll = (
                angles(turn[0], turn[1], turn[2], turn[3], at) if len(turn) == 4 else (turn[2], turn[1], turn[0])
            )
            solid = Solid((x, y, z), (length, width, height), yaw_pitch_roll)
            objects.append(_make_object(name, uid, solid, None, (data, member(box, "attributes", at)), at))
        for i, item in enumerate(items(data.get("bbox", []), f"{where}: bbox")):
            at = f"{where} bbox {i}"
            box = mapping(item, at)
            stream = text(box.get("coordinate_system", box.get("stream")), f"{at}: coordinate_system") or system
            if (camera := self._camera(stream, at)) is not None:
                given = (data, member(box, "attributes", at))
                x, y, width, height = vector(box.get("val"), (4,), f"{at}: val")  # The middle, width and height
                flat = Flat(camera, (x - width / 2, y - height / 2, x + width / 2, y + height / 2))
                objects.append(_make_object(name, uid, None, flat, given, at))
        for kind in _UNUSED:
            if kind in data:
                self._faults.once("GT005", (self._where, kind), f"{where}: {kind}")

    def _camera(self, stream: str, where: str) -> str | None:
        """Name of the camera of a box in an image; `None` where its stream isn't one."""
        declared = member(self._streams, stream, where)
        if declared and text(declared.get("type"), f"{where}: type") not in ("", "camera"):
            self._faults.once("GT005", (self._where, f"stream {stream[:60]}"), f"{where} of '{stream[:60]}'")
            return None
        if self._coordinates.camera(stream) is None:
            uri = text(declared.get("uri"), f"{where}: uri") if declared else ""
            stream = uri if self._coordinates.camera(uri) is not None else self._camera_option or stream
        return find_camera(stream, self._coordinates, where)

    def _place(
        self, objects: Sequence[LabeledObject], systems: Sequence[str], moving: Mapping[str, Any], where: str
    ) -> tuple[Boxes3D, bool]:
        boxes = to_boxes3d(objects)
        if not any(systems):
            return place(boxes, [self._source.frame] * max(len(boxes), 1), self._coordinates, where)
        targets = {name: self._systems.target(name, moving, where) for name in dict.fromkeys(systems)}
        kinds = {kind for kind, _ in targets.values()}
        if len(kinds) > 1:
            raise LogError(f"{where}: boxes in the world and on the body at one instant; use one of them")
        if len(targets) == 1:
            return move_boxes(boxes, targets[systems[0]][1]), WORLD in kinds
        parts = [move_boxes(boxes[i : i + 1], targets[name][1]) for i, name in enumerate(systems)]
        return concatenate(parts), WORLD in kinds
