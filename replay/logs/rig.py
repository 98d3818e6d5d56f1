"""The rig of a log, from its transforms and calibrations, and how it changes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import DecodeError, LogError
from fbench.replay.data.rig import KINDS, CameraModel, Kind, Mount, Rig, RigChange
from fbench.replay.logs.container import Container, Entry
from fbench.replay.logs.coordinate_frames import BODIES, BODY, TransformTree
from fbench.replay.logs.rig_patch import FittedPatch, find_sensors, require_use
from fbench.replay.logs.roles import Role, sensor_roles
from fbench.replay.logs.setup import Setup

_MAX_MOVING = 2000  # So many messages of moving transforms are searched for the way from a sensor to the body


@dataclass
class RigState:
    """What is known of the coordinate frames and cameras of a log at some point of it."""

    container: Container
    roles: Mapping[int, Role]
    left_out: frozenset[str] = frozenset()  # Sensors that weren't selected
    setup: Setup = field(default_factory=Setup)
    patch: FittedPatch = field(default_factory=FittedPatch)  # Calibration that goes before the log's
    logged: TransformTree = field(default_factory=TransformTree)  # Transforms of the log
    cameras: dict[str, CameraModel] = field(default_factory=dict)
    """By sensor as the channel's metadata say, else by coordinate frame."""
    neighbors: dict[str, CameraModel] = field(default_factory=dict)
    """By the part of the topic before the last slash, which camera drivers share between image and calibration."""
    by_topic: dict[str, CameraModel] = field(default_factory=dict)  # By topic of the calibration
    calibrated: set[int] = field(default_factory=set)  # Channels that gave a calibration

    @property
    def tree(self) -> TransformTree:
        """All transforms that count: the log's, and those that replace them."""
        if not self.patch.edges:
            return self.logged
        # Replaced transforms begin where the log itself has the body.
        return self.patch.tree(self.logged, self.setup.body or self._find_body())

    def take(self, entry: Entry) -> bool:
        """Take a transform or calibration, and tell whether it says anything new; damaged ones are counted."""
        role = self.roles[entry.channel]
        if role.codec is None or not isinstance(entry.data, memoryview):
            return False
        try:
            if role.kind == "transform":
                news = [self.logged.put(child, edge) for child, edge in role.codec.transforms(entry.data)]
                return any(news)
            frame, camera = role.codec.calibration(entry.data)
        except DecodeError as error:
            where = f"{entry.topic} at {entry.publish_ns}: {error}"
            self.container.once("DEC001", (entry.part, entry.block, entry.offset), where)
            return False
        old = self.cameras.get(key := role.frame_id or frame)
        self.cameras[key] = self.neighbors[_folder(entry.topic)] = self.by_topic[entry.topic] = camera
        self.calibrated.add(entry.channel)
        return old is None or not old.equals(camera)

    def later_trees(self) -> Iterator[tuple[int, TransformTree, str]]:
        """Read all static transforms, and yield log time, transforms, and name of the body where one changes."""
        state = self.copy()
        static = frozenset(id_ for id_, r in self.roles.items() if r.kind == "transform" and r.is_static)
        for log_ns, group in groupby(self.container.entries(static) if static else (), key=lambda entry: entry.log_ns):
            news = [state.take(entry) for entry in group]
            if any(news):
                with suppress(LogError):  # what was broken in the middle of a log doesn't count
                    yield log_ns, TransformTree(dict(state.tree.edges)), state.body()

    def copy(self) -> "RigState":
        """Return an independent copy."""
        names = ("cameras", "neighbors", "by_topic", "calibrated")
        tables: dict[str, Any] = {name: copy(getattr(self, name)) for name in names}
        return replace(self, logged=TransformTree(dict(self.logged.edges)), **tables)

    def rig(self, is_strict: bool = False) -> Rig:
        """Return the rig. Of cameras without transform or calibration only the images can be used, unless all must be
        there: `is_strict`. Raises LogError naming the sensor without transform, or the camera that isn't calibrated.
        """
        sensors, body = self._sensors(), self.body()
        placed = {name: self._mount(name, kind, frame, body) for name, (kind, frame) in sorted(sensors.items())}
        mounts = {name: mount for name, mount in placed.items() if isinstance(mount, Mount)}
        for name, place in placed.items():
            if isinstance(place, LogError) and (is_strict or sensors[name][0] != "camera"):
                raise place
        # Own logs may hold calibrations of cameras that have neither mount nor images.
        heard = sorted(self.roles.items())
        frames = {r.sensor: r.frame_id for _, r in heard if r.kind == "calibration" and r.frame_id}
        frames |= {r.sensor: r.frame_id for _, r in heard if r.kind == "camera"}
        silent = {name: frame for name, (kind, frame) in sensors.items() if kind == "camera" and name not in frames}
        frames = {name: frame for name, frame in {**frames, **silent}.items() if name not in self.left_out}
        folders = {r.sensor: _folder(r.topic) for _, r in heard}
        found = {name: self._camera(name, frame, folders.get(name, "")) for name, frame in sorted(frames.items())}
        told = {r.sensor for _, r in heard if r.kind == "calibration" and r.is_own}  # what fbench wrote must be right
        for name, camera in found.items():
            if isinstance(camera, LogError) and (is_strict or name in told):
                raise camera
        bare = frozenset(placed) - frozenset(mounts)
        cameras = {name: m for name, m in found.items() if isinstance(m, CameraModel) and name not in bare}
        return Rig(mounts, cameras, bare)

    def body(self) -> str:
        """Name of the coordinate frame of the body. Raises LogError where the sensors but cameras aren't linked."""
        if self.setup.body:
            return self.setup.body
        try:
            return self.tree.body(self.frames()) or self._find_body()
        except DecodeError as error:
            others = [frame for kind, frame in self._sensors().values() if kind != "camera"]
            with suppress(DecodeError):
                return self.tree.body(others) or self._find_body()
            advice = "repair /tf_static, or leave sensors out with --topics '!NAME'"
            raise LogError(f"{self.container.path}: {error}; {advice}", "CAL001") from error

    def _find_body(self) -> str:
        """The first name of a body that the log's transforms have, whether or not sensors are linked to it."""
        names = {name for child, edge in self.logged.edges.items() for name in (child, edge.parent)}
        return next((name for name in BODIES if name in names), BODY)

    def frames(self) -> list[str]:
        """Coordinate frames of all sensors."""
        return [frame for _, frame in self._sensors().values()]

    def _sensors(self) -> dict[str, tuple[Kind, str]]:
        sensors = {r.sensor: (KINDS[r.kind], r.frame_id) for r in sensor_roles(self.roles)}
        header, own = self.container.header, self.patch.frames
        known = header.kinds if header is not None and not self.setup.sensors else {}
        named = {**{name: (kind, name) for name, kind in known.items()}, **sensors}
        return {
            name: (kind, own.get(name, frame)) for name, (kind, frame) in named.items() if name not in self.left_out
        }

    def _mount(self, name: str, kind: Kind, frame: str, body: str) -> Mount | LogError:
        """Where a sensor is, or what to raise where nothing says it. Raises LogError where its transforms are wrong."""
        where, leave_out = f"{self.container.path}: sensor '{name}'", _leave_out(name)
        try:
            is_body = bool(frame) and frame == self.setup.body  # the user says so, even without any transform
            pose = (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])) if is_body else self.tree.pose(frame, body)
        except DecodeError as error:
            raise LogError(f"{where}: {error}; repair its transforms, {leave_out}", "CAL001") from error
        if pose is None:
            to = "" if body == frame else f" to '{body}'"
            why = f"'{frame}'{to} on /tf or /tf_static" if frame else "its messages name no frame_id"
            moving = self.setup.rig.moving  # what a file with calibration says, where it can't tell the pose
            steps = [moving[step] for step in self.tree.trace(frame) if step in moving]
            why += f"; {steps[0]} has no fixed pose" if steps else ""
            return LogError(
                f"{where} has no transform to the body ({why}); add it with fbench init or --rig, {leave_out}", "CAL001"
            )
        return Mount(kind, *pose)

    def _camera(self, name: str, frame: str, folder: str) -> CameraModel | LogError:
        """Intrinsics of a camera, or what to raise where it has none."""
        setup = self.setup.sensors.get(name)
        if setup is not None and setup.calibration:
            camera = self.by_topic.get(setup.calibration)
        else:
            camera = self.cameras.get(frame, self.neighbors.get(folder))
        camera = self.patch.cameras.get(name, camera)
        if camera is None:
            what = f"has no calibration (CameraCalibration or CameraInfo for '{frame}')"
            add = f"add it with --rig, {_leave_out(name)}"
            return LogError(f"{self.container.path}: camera '{name}' {what}; {add}", "CAL001")
        return camera


def first_state(
    container: Container, roles: Mapping[int, Role], left_out: frozenset[str] = frozenset(), setup: Setup | None = None
) -> RigState:
    """Read what is needed and no more: the first transform of each sensor, the first calibration of each camera. Raises
    ConfigError where calibration from elsewhere fits none of the sensors.
    """
    said = setup or Setup()
    state = RigState(container, roles, left_out, said, find_sensors(said.rig, roles))
    full = {id_: role for id_, role in sorted(roles.items()) if container.counts.get(id_, 1)}

    def is_linked() -> bool:
        tree, frames = state.tree, state.frames()
        return bool(frames) and all(tree.has_body(frame, said.body) for frame in frames)

    def search(is_static: bool, limit: int | None = None) -> None:
        """Take transforms until all sensors are linked; of several transforms of one child the first one counts."""
        found = frozenset(i for i, role in full.items() if role.kind == "transform" and role.is_static == is_static)
        for num, entry in enumerate(container.entries(found) if found else ()):
            known = dict(state.logged.edges)
            state.take(entry)
            state.logged.edges |= known
            if num == limit or is_linked():
                break

    search(is_static=True)
    for id_ in (i for i, role in full.items() if role.kind == "calibration"):
        for entry in container.entries(frozenset([id_])):
            state.take(entry)
            if id_ in state.calibrated:
                break
    if state.frames() and not is_linked():
        search(is_static=False, limit=_MAX_MOVING)
    require_use(said.rig, state.patch, roles, state.tree)
    return state


def _leave_out(sensor: str) -> str:
    return f"or leave the sensor out with --topics '!{sensor}'"


def _folder(topic: str) -> str:
    return topic.rpartition("/")[0]


class RigChanges:
    """Follows transforms and calibrations, to tell where the rig changes."""

    def __init__(self, rig: Rig | None, stored: Sequence[tuple[int, Rig]], state: RigState | None) -> None:
        """Start with the rig of the log's beginning (`None` where it isn't whole: then no change is told), the rigs
        that the container itself knows of, or what its messages told so far.
        """
        self._rig, self._stored = rig, list(stored)
        self._state = None if state is None or rig is None else state.copy()
        self._is_new = False
        roles = {} if self._state is None else self._state.roles
        self.channels = frozenset(
            id_ for id_, r in roles.items() if r.kind == "calibration" or (r.kind == "transform" and r.is_static)
        )

    def follow(self, entries: Iterable[Entry]) -> Iterator[Entry]:
        """Pass all entries on, taking the transforms and calibrations of one log time before its other messages: which
        topic comes first in the alphabet must not decide what they are seen with.
        """
        if not self.channels:
            yield from entries
            return
        for _, group in groupby(entries, key=lambda entry: entry.log_ns):
            together = list(group)
            for entry in together:
                if entry.channel in self.channels and self._state is not None:
                    self._is_new = self._state.take(entry) or self._is_new
            yield from together

    def all(self, container: Container) -> Iterator[RigChange]:
        """Yield all changes of a log, for which its transforms and calibrations alone are read."""
        for log_ns, _ in list(self._stored):
            yield from self.until(log_ns)
        for entry in self.follow(container.entries(self.channels) if self.channels else ()):
            yield from self.until(entry.log_ns)

    def until(self, log_ns: int) -> Iterator[RigChange]:
        """Yield the change of the rig before a message of log time `log_ns`, where there is one."""
        rig = None
        while self._stored and self._stored[0][0] <= log_ns:
            _, rig = self._stored.pop(0)
        if self._is_new and self._state is not None:
            self._is_new = False
            with suppress(LogError):  # what was broken in the middle of a log doesn't end it: the old rig stays
                rig = self._state.rig()
        if rig is not None and self._rig is not None and (sensors := rig.list_changes(self._rig)):
            self._rig = rig
            yield RigChange(log_ns, rig, sensors)
