"""Calibration from elsewhere, fitted to the sensors of one log."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.data.rig import CameraModel, Kind, Mount, Rig
from fbench.replay.logs.coordinate_frames import BODY, Edge, TransformTree, tree_of
from fbench.replay.logs.roles import Role, sensor_roles


@dataclass(frozen=True, eq=False)
class RigPatch:
    """Transforms and intrinsics by name: that of a sensor, or of a coordinate frame."""

    edges: Mapping[str, Edge] = field(default_factory=dict)
    """Pose of each named child in its parent; parents are named likewise, `body` being the body."""
    cameras: Mapping[str, CameraModel] = field(default_factory=dict)
    topics: Mapping[str, str] = field(default_factory=dict)
    """Topic of the messages of a name, where the file tells it (`rostopic` of Kalibr): another way to find a sensor."""
    places: Mapping[str, str] = field(default_factory=dict)  # For errors: which file each name comes from
    moving: Mapping[str, str] = field(default_factory=dict)
    """Children whose pose a file can't tell, and why: `joint 'pan' (revolute)`. The log may."""

    def over(self, other: "RigPatch") -> "RigPatch":
        """Return both, this one going first where they name the same."""
        return RigPatch(
            {**other.edges, **self.edges}, {**other.cameras, **self.cameras}, {**other.topics, **self.topics},
            {**other.places, **self.places}, {**other.moving, **self.moving},
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class FittedPatch:
    """A `RigPatch` whose names are those of one log."""

    edges: Mapping[str, Edge] = field(default_factory=dict)
    """By coordinate frame; the parent `body` is the body, whatever the log calls it."""
    cameras: Mapping[str, CameraModel] = field(default_factory=dict)  # By sensor
    frames: Mapping[str, str] = field(default_factory=dict)
    """Coordinate frame of each sensor that the patch gives one of its own."""

    def tree(self, logged: TransformTree, body: str) -> TransformTree:
        """Return the log's transforms, replaced where the patch has others; `body` is what they call the body."""
        own = {
            child: replace(edge, parent=body) if edge.parent == BODY else edge
            for child, edge in self.edges.items()
            if child != body
        }
        return TransformTree({**logged.edges, **own})

    def on(self, rig: Rig, kinds: Mapping[str, Kind]) -> Rig:
        """Return a rig with the patch's mounts and cameras; what it doesn't change stays bit for bit. `kinds` has
        all sensors by name, those too that the rig lacks.
        """
        tree = self.tree(tree_of(rig), BODY)
        mounts = dict(rig.mounts)
        for name, kind in kinds.items():
            pose = tree.pose(self.frames.get(name, name), BODY)
            if pose is not None:
                mounts[name] = Mount(kind, *pose)
        return Rig(mounts, {**rig.cameras, **self.cameras})


def find_sensors(patch: RigPatch, roles: Mapping[int, Role]) -> FittedPatch:
    """Find a patch's sensors by name, topic or coordinate frame. Raises ConfigError where the log lacks a camera."""
    sensors = {role.sensor: role for role in sensor_roles(roles)}
    all_cameras = [name for name, role in sensors.items() if role.kind == "camera"]
    by_topic = {role.topic: role.sensor for role in sensors.values()}
    by_key = {key: by_topic[topic] for key, topic in patch.topics.items() if topic in by_topic}
    own = {name: name for name in sensors if name in patch.edges}
    own |= {sensor: key for key, sensor in by_key.items() if key in patch.edges and sensor not in own}
    cameras: dict[str, CameraModel] = {}
    for key, model in patch.cameras.items():
        named = [name for name in all_cameras if sensors[name].frame_id == key]
        if key in sensors or key in by_key:
            named = [key if key in sensors else by_key[key]]
        elif not named and len(all_cameras) == len(patch.cameras) == 1:
            named = all_cameras  # a file about one camera means the only one of the log, whatever it calls it
        if not named:
            hint = did_you_mean(key, all_cameras)
            raise ConfigError(f"{patch.places.get(key, 'rig')}: the log has no camera '{key}'{hint}", "CFG001")
        cameras |= dict.fromkeys(named, model)
    # Where a parent of the patch is, when only the log knows: the first camera of a chain.
    parents = {edge.parent for edge in patch.edges.values()} - set(patch.edges)
    known = {key: sensors[by_key[key]].frame_id for key in parents if key in by_key and by_key[key] not in own}
    known |= {name: sensors[name].frame_id for name in parents if name in sensors}
    same_place = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
    aliases = {key: Edge(frame, *same_place) for key, frame in sorted(known.items()) if frame and frame != key}
    return FittedPatch({**aliases, **patch.edges}, cameras, own)


def require_use(patch: RigPatch, fit: FittedPatch, roles: Mapping[int, Role], tree: TransformTree) -> None:
    """Refuse transforms that no sensor stands on: names must be wrong. Raises ConfigError naming file and sensors."""
    sensors = {role.sensor: role for role in sensor_roles(roles)}
    frames = {fit.frames.get(name, role.frame_id) for name, role in sensors.items()}
    used = {step for frame in frames for step in tree.trace(frame)}
    if not fit.edges or used & {*fit.edges, *patch.moving}:
        return
    place = next(iter(patch.places.values()), "rig")
    there = ", ".join(f"{name} (frame '{role.frame_id}')" for name, role in sensors.items())
    raise ConfigError(f"{place}: names none of the log's sensors: {there}", "CFG001")


def rename_sensors(rig: Rig, names: Mapping[str, str]) -> Rig:
    """Return a rig of these sensors alone: new names by those that it has."""
    return Rig(
        {new: rig.mounts[old] for old, new in names.items() if old in rig.mounts},
        {new: rig.cameras[old] for old, new in names.items() if old in rig.cameras},
    )
