"""The rig of an MCAP log, from its transforms and calibrations."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from fbench.replay.data import CameraModel, Kind, Mount, Rig
from fbench.replay.errors import DecodeError, LogError
from fbench.replay.logs.channels import Role
from fbench.replay.logs.header import LogHeader
from fbench.replay.logs.mcap_file import McapFile
from fbench.replay.logs.mcap_merge import Entry
from fbench.replay.logs.proto import parse
from fbench.replay.logs.rig import TransformTree, read_calibration, read_transform

_KINDS: Mapping[str, Kind] = {"camera": "camera", "lidar": "lidar", "radar": "radar"}


@dataclass
class _Found:
    tree: TransformTree = field(default_factory=TransformTree)
    cameras: dict[str, CameraModel] = field(default_factory=dict)
    """By sensor as the channel's metadata say, else by coordinate frame."""
    neighbours: dict[str, CameraModel] = field(default_factory=dict)
    """By the part of the topic before the last slash, which camera drivers share between image and calibration."""
    calibrated: set[int] = field(default_factory=set)
    """Channels that gave a calibration."""


def read_rig(file: McapFile, roles: Mapping[int, Role], header: LogHeader | None) -> Rig:
    """Read what is needed and no more: the first transform of each sensor, the first calibration of each camera.

    Raises:
        LogError: naming the sensor that has no transform, or the camera that isn't calibrated.
    """
    sensors = {r.sensor: (_KINDS[r.kind], r.frame_id) for _, r in sorted(roles.items()) if r.kind in _KINDS}
    sensors |= {} if header is None else {name: (kind, name) for name, kind in header.kinds.items()}
    found = _search(file, roles, [frame for _, frame in sensors.values()])
    mounts = {name: _mount(file, found.tree, name, kind, frame) for name, (kind, frame) in sorted(sensors.items())}
    # Own logs may hold calibrations of cameras that have neither mount nor images.
    frames = {r.sensor: r.sensor for _, r in sorted(roles.items()) if r.kind == "calibration" and r.frame_id}
    frames |= {name: frame for name, (kind, frame) in sensors.items() if kind == "camera"}
    folders = {r.sensor: _folder(file.index.channels[id_].topic) for id_, r in sorted(roles.items())}
    return Rig(
        mounts,
        {name: _camera(file, found, name, frame, folders.get(name, "")) for name, frame in sorted(frames.items())},
    )


def _folder(topic: str) -> str:
    return topic.rpartition("/")[0]


def _search(file: McapFile, roles: Mapping[int, Role], frames: list[str]) -> _Found:
    """Stop as soon as all calibrated cameras and the mounts of all sensors are known."""
    found = _Found()
    calibrations = {id_ for id_, role in roles.items() if role.kind == "calibration"}
    transforms = {id_ for id_, role in roles.items() if role.kind == "transform"}
    for entry in file.entries(frozenset(calibrations | transforms)):
        try:
            _take(entry, roles[entry.channel], found)
        except DecodeError as error:
            where = f"{entry.topic} at {entry.publish_ns}: {error}"
            file.once("DEC001", (entry.block, entry.offset), where)
        if calibrations <= found.calibrated and all(found.tree.known(frame) for frame in frames):
            break
    return found


def _take(entry: Entry, role: Role, found: _Found) -> None:
    data = bytes(entry.data)
    if role.kind == "transform":
        for transform in _transforms(data, role.schema):
            found.tree.add(*read_transform(transform))
        return
    frame, camera = read_calibration(data)
    found.cameras.setdefault(role.frame_id or frame, camera)
    found.neighbours.setdefault(_folder(entry.topic), camera)
    found.calibrated.add(entry.channel)


def _transforms(data: bytes, schema: str) -> Iterator[FrameTransform]:
    if schema == "foxglove.FrameTransforms":
        yield from parse(FrameTransforms, data).transforms
    else:
        yield parse(FrameTransform, data)


def _mount(file: McapFile, tree: TransformTree, name: str, kind: Kind, frame: str) -> Mount:
    try:
        pose = tree.pose(frame)
    except DecodeError as error:
        raise LogError(f"{file.path}: sensor '{name}': {error}") from error
    if pose is None:
        raise LogError(f"{file.path}: sensor '{name}' has no transform to the body (coordinate frame '{frame}' on /tf)")
    if not (np.isfinite(pose[0]).all() and np.isfinite(pose[1]).all() and np.any(pose[1])):
        raise LogError(f"{file.path}: sensor '{name}' has no valid pose (position {pose[0]}, rotation {pose[1]})")
    return Mount(kind, *pose)


def _camera(file: McapFile, found: _Found, name: str, frame: str, folder: str) -> CameraModel:
    camera = found.cameras.get(frame, found.neighbours.get(folder))
    if camera is not None:
        return camera
    raise LogError(f"{file.path}: camera '{name}' has no calibration (foxglove.CameraCalibration for '{frame}')")
