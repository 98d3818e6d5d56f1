"""ASAM OpenLABEL 1.0: cuboids and bounding boxes of objects by frame (https://www.asam.net/standards/detail/openlabel)."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from fbench.replay.boxes import concatenate
from fbench.replay.boxfiles.json_file import items, mapping, member, read_json, scalar, text
from fbench.replay.boxfiles.openlabel_frames import WORLD, CoordinateSystems
from fbench.replay.boxfiles.openlabel_rows import flat, labelled, solid
from fbench.replay.boxfiles.parse import stamp_of_time
from fbench.replay.boxfiles.placing import camera_of, default_camera, placed
from fbench.replay.boxfiles.rows import Labelled, flats, solids
from fbench.replay.boxfiles.text import frame_number
from fbench.replay.data import Boxes3D, Truth
from fbench.replay.errors import LogError
from fbench.replay.faults import FaultLog
from fbench.replay.geometry.boxes import moved
from fbench.replay.logs.coordinates import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

_UNUSED = ("poly2d", "poly3d", "point2d", "point3d", "rbbox", "mat", "binary", "image", "mesh", "area_reference")


def open_openlabel(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read the frames of a file. A frame's `timestamp` says when it was; where none has one, keys count frames.

    Raises:
        ConfigError: where a coordinate system or camera isn't known.
        LogError: where the form isn't that of OpenLABEL.
    """
    where = str(source.path)
    root = member(read_json(source.path), "openlabel", where)
    frames = member(root, "frames", where)
    if not frames:
        raise LogError(f"{where}: no frames; boxes that belong to no frame can't be scored")
    reader = _Reader(root, source, coordinates, faults)
    instants = sorted(_instant(key, value, where) for key, value in frames.items())
    if len({stamp_ns >= 0 for stamp_ns, _, _ in instants}) > 1:
        raise LogError(f"{where}: some frames have a timestamp and some don't")
    for stamp_ns, number, key in instants:
        boxes3d, boxes2d, in_world = reader.boxes(key, frames[key])
        if stamp_ns >= 0:
            yield Truth(stamp_ns, stamp_ns, boxes3d, boxes2d, in_world=in_world)
        else:
            yield Truth(0, 0, boxes3d, boxes2d, number, number, in_world)


def _instant(key: str, value: object, where: str) -> tuple[int, int, str]:
    """Stamp (-1: none), number and key of a frame."""
    at = f"{where}: frame '{key[:40]}'"
    told = member(value, "frame_properties", at).get("timestamp")
    if told is None:
        return -1, frame_number(key, at), key
    try:
        return stamp_of_time(told if isinstance(told, str) else repr(scalar(told, f"{at}: timestamp"))), 0, key
    except ValueError as error:
        raise LogError(f"{at}: timestamp {error}") from error


@dataclass
class _Found:
    """What one frame holds."""

    objects: list[Labelled] = field(default_factory=list)
    systems: list[str] = field(default_factory=list)
    """Coordinate system of each 3D box."""


class _Reader:
    """Reads single frames."""

    def __init__(
        self, root: Mapping[str, Any], source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog
    ) -> None:
        self._where, self._source, self._coordinates, self._faults = str(source.path), source, coordinates, faults
        self._camera_option = default_camera(source, coordinates)
        self._objects = member(root, "objects", self._where)
        self._streams = member(root, "streams", self._where)
        self._systems = CoordinateSystems(root, coordinates, source)
        frames = mapping(root["frames"], self._where).items()
        kinds = {kind for key, frame in frames for data in self._datas(key, frame) for kind in data}
        self._is_solid, self._is_flat = "cuboid" in kinds, "bbox" in kinds

    def boxes(self, key: str, frame: object) -> tuple[Any, Any, bool]:
        """Return 3D boxes, 2D boxes, and whether the former are in the world."""
        at = f"{self._where}: frame '{key[:40]}'"
        found = _Found()
        for uid, value in member(frame, "objects", at).items():
            self._take(found, uid, value, f"{at} object '{uid[:60]}'")
        moving = self._systems.of_frame(member(frame, "frame_properties", at), at)
        boxes3d, in_world = self._placed(found, moving, at)
        return boxes3d if self._is_solid else None, flats(found.objects) if self._is_flat else None, in_world

    def _datas(self, key: str, frame: object) -> Iterator[Mapping[str, Any]]:
        at = f"{self._where}: frame '{key[:40]}'"
        for uid, value in member(frame, "objects", at).items():
            yield member(value, "object_data", f"{at} object '{uid[:60]}'")

    def _take(self, found: _Found, uid: str, value: object, where: str) -> None:
        known = member(self._objects, uid, where)
        own = mapping(value, where)
        data = member(own, "object_data", where)
        name = text(own.get("type", known.get("type")), f"{where}: type")
        system = text(own.get("coordinate_system", known.get("coordinate_system")), f"{where}: coordinate_system")
        for i, item in enumerate(items(data.get("cuboid", []), f"{where}: cuboid")):
            at = f"{where} cuboid {i}"
            box = mapping(item, at)
            found.systems.append(text(box.get("coordinate_system"), f"{at}: coordinate_system") or system)
            found.objects.append(labelled(name, uid, solid(box, at), None, (data, member(box, "attributes", at)), at))
        for i, item in enumerate(items(data.get("bbox", []), f"{where}: bbox")):
            at = f"{where} bbox {i}"
            box = mapping(item, at)
            stream = text(box.get("coordinate_system", box.get("stream")), f"{at}: coordinate_system") or system
            if (camera := self._camera(stream, at)) is not None:
                told = (data, member(box, "attributes", at))
                found.objects.append(labelled(name, uid, None, flat(camera, box, at), told, at))
        for kind in _UNUSED:
            if kind in data:
                self._unused(kind, f"{where}: {kind}")

    def _camera(self, stream: str, where: str) -> str | None:
        """Name of the camera of a box in an image; `None` where its stream isn't one."""
        declared = member(self._streams, stream, where)
        if declared and text(declared.get("type"), f"{where}: type") not in ("", "camera"):
            self._unused(f"stream {stream[:60]}", f"{where} of '{stream[:60]}'")
            return None
        if self._coordinates.camera(stream) is None:
            uri = text(declared.get("uri"), f"{where}: uri") if declared else ""
            stream = uri if self._coordinates.camera(uri) is not None else self._camera_option or stream
        return camera_of(stream, self._coordinates, where)

    def _placed(self, found: _Found, moving: Mapping[str, Any], where: str) -> tuple[Boxes3D, bool]:
        boxes = solids(found.objects)
        if not any(found.systems):
            return placed(boxes, [self._source.frame] * max(len(boxes), 1), self._coordinates, where)
        targets = {name: self._systems.target(name, moving, where) for name in dict.fromkeys(found.systems)}
        kinds = {kind for kind, _ in targets.values()}
        if len(kinds) > 1:
            raise LogError(f"{where}: boxes in the world and on the body at one instant; use one of them")
        names = list(targets)
        if len(names) == 1:
            return moved(boxes, targets[names[0]][1]), WORLD in kinds
        parts = [moved(boxes[i : i + 1], targets[name][1]) for i, name in enumerate(found.systems)]
        return concatenate(parts), WORLD in kinds

    def _unused(self, kind: str, where: str) -> None:
        self._faults.once("GT005", (self._where, kind), where)
