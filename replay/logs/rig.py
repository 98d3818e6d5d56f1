"""The rig of a log, from its transforms and calibrations, and how it changes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np

from fbench.replay.contracts.errors import DecodeError, LogError
from fbench.replay.data.rig import KINDS, CameraModel, Kind, Mount, Rig, RigChange
from fbench.replay.logs.codecs.codec import SENSORS
from fbench.replay.logs.container import Container, Entry
from fbench.replay.logs.coordinate_frames import BODIES, BODY, TransformTree
from fbench.replay.logs.rig_patch import FittedPatch, find_sensors, require_use
from fbench.replay.logs.roles import Role
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
        return self.patch.tree(self.logged, self.setup.body or self._logged_body())

    def take(self, entry: Entry) -> bool:
        """Take a transform or calibration, replacing what was known; tells whether anything is new.

        A damaged message is counted.
        """
        role = self.roles[entry.channel]
        if role.codec is None or not isinstance(entry.data, memoryview):
            return False
        try:
            if role.kind == "transform":
                news = [self.logged.put(child, edge) for child, edge in role.codec.transforms(entry.data)]
                return any(news)
            return self._take_camera(entry, role, *role.codec.calibration(entry.data))
        except DecodeError as error:
            where = f"{entry.topic} at {entry.publish_ns}: {error}"
            self.container.once("DEC001", (entry.part, entry.block, entry.offset), where)
            return False

    def copy(self) -> "RigState":
        """Return an independent copy."""
        return replace(
            self, logged=TransformTree(dict(self.logged.edges)), cameras=dict(self.cameras),
            neighbors=dict(self.neighbors), by_topic=dict(self.by_topic), calibrated=set(self.calibrated),
        )  # fmt: skip

    def rig(self) -> Rig:
        """Return the rig.

        Raises LogError naming the sensor that has no transform, or the camera that isn't calibrated.
        """
        sensors = self._sensors()
        body = self.body()
        mounts = {name: self._mount(name, kind, frame, body) for name, (kind, frame) in sorted(sensors.items())}
        # Own logs may hold calibrations of cameras that have neither mount nor images.
        heard = sorted(self.roles.items())
        frames = {r.sensor: r.frame_id for _, r in heard if r.kind == "calibration" and r.frame_id}
        frames |= {r.sensor: r.frame_id for _, r in heard if r.kind == "camera"}
        silent = {name: frame for name, (kind, frame) in sensors.items() if kind == "camera" and name not in frames}
        frames = {name: frame for name, frame in {**frames, **silent}.items() if name not in self.left_out}
        folders = {r.sensor: _folder(r.topic) for _, r in heard}
        return Rig(
            mounts, {name: self._camera(name, frame, folders.get(name, "")) for name, frame in sorted(frames.items())}
        )

    def body(self) -> str:
        """Name of the coordinate frame of the body. Raises LogError where the sensors aren't linked."""
        if self.setup.body:
            return self.setup.body
        try:
            return self.tree.body(self.frames()) or BODY
        except DecodeError as error:
            raise LogError(
                f"{self.container.path}: {error}; repair /tf_static, or leave sensors out with --topics '!NAME'",
                "CAL001",
            ) from error

    def frames(self) -> list[str]:
        """Coordinate frames of all sensors."""
        return [frame for _, frame in self._sensors().values()]

    def _sensors(self) -> dict[str, tuple[Kind, str]]:
        sensors = {r.sensor: (KINDS[r.kind], r.frame_id) for _, r in sorted(self.roles.items()) if r.kind in SENSORS}
        header = self.container.header
        is_told = header is not None and not self.setup.sensors
        silent = {name: (kind, name) for name, kind in header.kinds.items()} if header is not None and is_told else {}
        named = {**silent, **sensors}
        own = self.patch.frames
        return {
            name: (kind, own.get(name, frame)) for name, (kind, frame) in named.items() if name not in self.left_out
        }

    def _logged_body(self) -> str:
        """What the log itself calls the body, where replaced transforms are to begin."""
        names = {name for child, edge in self.logged.edges.items() for name in (child, edge.parent)}
        return next((name for name in BODIES if name in names), BODY)

    def _take_camera(self, entry: Entry, role: Role, frame: str, camera: CameraModel) -> bool:
        key = role.frame_id or frame
        old = self.cameras.get(key)
        self.cameras[key] = self.neighbors[_folder(entry.topic)] = self.by_topic[entry.topic] = camera
        self.calibrated.add(entry.channel)
        return old is None or not old.equals(camera)

    def _mount(self, name: str, kind: Kind, frame: str, body: str) -> Mount:
        path = self.container.path
        try:
            is_body = bool(frame) and frame == self.setup.body  # the user says so, even without any transform
            pose = (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])) if is_body else self.tree.pose(frame, body)
        except DecodeError as error:
            raise LogError(
                f"{path}: sensor '{name}': {error}; repair its transforms, {_leave_out(name)}", "CAL001"
            ) from error
        if pose is None:
            to = "" if body == frame else f" to '{body}'"
            why = f"'{frame}'{to} on /tf or /tf_static" if frame else "its messages name no frame_id"
            why += self._moves(frame)
            raise LogError(
                f"{path}: sensor '{name}' has no transform to the body ({why}); add it, {_leave_out(name)}", "CAL001"
            )
        return Mount(kind, *pose)

    def _moves(self, frame: str) -> str:
        """What a file with calibration says of the way to the body, where it can't tell the pose."""
        moving = self.setup.rig.moving
        return next((f"; {moving[step]} has no fixed pose" for step in self.tree.trace(frame) if step in moving), "")

    def _camera(self, name: str, frame: str, folder: str) -> CameraModel:
        setup = self.setup.sensors.get(name)
        if setup is not None and setup.calibration:
            camera = self.by_topic.get(setup.calibration)
        else:
            camera = self.cameras.get(frame, self.neighbors.get(folder))
        camera = self.patch.cameras.get(name, camera)
        if camera is not None:
            return camera
        raise LogError(
            f"{self.container.path}: camera '{name}' has no calibration (CameraCalibration or CameraInfo for "
            f"'{frame}'); add it, {_leave_out(name)}",
            "CAL001",
        )


def first_state(
    container: Container, roles: Mapping[int, Role], left_out: frozenset[str] = frozenset(), setup: Setup | None = None
) -> RigState:
    """Read what is needed and no more: the first transform of each sensor, the first calibration of each camera. Raises
    ConfigError where calibration from elsewhere fits none of the sensors.
    """
    said = setup or Setup()
    state = RigState(container, roles, left_out, said, find_sensors(said.rig, roles))
    transforms = _channels(container, roles, "transform")
    _search(state, frozenset(i for i in transforms if roles[i].is_static))
    _search_calibrations(state, _channels(container, roles, "calibration"))
    if not _is_linked(state):
        _search(state, frozenset(i for i in transforms if not roles[i].is_static), _MAX_MOVING)
    require_use(said.rig, state.patch, roles, state.tree)
    return state


def _channels(container: Container, roles: Mapping[int, Role], kind: str) -> frozenset[int]:
    return frozenset(i for i, role in roles.items() if role.kind == kind and container.counts.get(i, 1))


def _search(state: RigState, channels: frozenset[int], limit: int | None = None) -> None:
    """Take transforms until all sensors are linked; of several transforms of one child the first one counts."""
    for num, entry in enumerate(state.container.entries(channels) if channels else ()):
        known = dict(state.logged.edges)
        state.take(entry)
        state.logged.edges |= known
        if num == limit or _is_linked(state):
            break


def _is_linked(state: RigState) -> bool:
    tree, body = state.tree, state.setup.body
    return all(_reaches(tree, frame, body) if body else tree.has_body(frame) for frame in state.frames())


def _reaches(tree: TransformTree, frame: str, body: str) -> bool:
    try:
        return frame == body or tree.pose(frame, body) is not None
    except DecodeError:
        return False


def _search_calibrations(state: RigState, channels: frozenset[int]) -> None:
    for id_ in sorted(channels):
        for entry in state.container.entries(frozenset([id_])):
            state.take(entry)
            if id_ in state.calibrated:
                break


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
        self.channels = frozenset() if self._state is None else _telling(self._state.roles)

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

    def until(self, log_ns: int) -> Iterator[RigChange]:
        """Yield the change of the rig before a message of log time `log_ns`, where there is one."""
        rig = None
        while self._stored and self._stored[0][0] <= log_ns:
            _, rig = self._stored.pop(0)
        if rig is not None:
            yield from self._change_rig(log_ns, rig)
        if self._is_new and self._state is not None:
            self._is_new = False
            try:
                rig = self._state.rig()
            except LogError:  # what was broken in the middle of a log doesn't end it: the old rig stays
                return
            yield from self._change_rig(log_ns, rig)

    def _change_rig(self, log_ns: int, rig: Rig) -> Iterator[RigChange]:
        sensors = () if self._rig is None else rig.changed_since(self._rig)
        if sensors:
            self._rig = rig
            yield RigChange(log_ns, rig, sensors)


def _telling(roles: Mapping[int, Role]) -> frozenset[int]:
    """Channels whose messages tell the rig."""
    return frozenset(
        id_
        for id_, role in roles.items()
        if role.kind == "calibration" or (role.kind == "transform" and role.is_static)
    )
