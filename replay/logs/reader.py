"""Reading a log as messages, truth and rig, whatever its container and encoding."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from hashlib import blake2b
from typing import TypeVar

import numpy as np

from fbench.replay.contracts.errors import ConfigError, DataError, DecodeError, LogError, PointsError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.classes import ClassMap
from fbench.replay.data.messages import BOXES, Message, Pose, Tick, Truth
from fbench.replay.data.metadata import CAMERA0
from fbench.replay.data.rig import KINDS, LogInfo, Rig, RigChange
from fbench.replay.logs.arrange import arranged, as_set_up, box_channels, facts, with_names
from fbench.replay.logs.codecs.codec import MESSAGES, SENSORS, Codec, Origin, TruthPart
from fbench.replay.logs.container import Container, Entry
from fbench.replay.logs.coordinate_frames import BODIES, BODY, CoordinateFrames, invalid, tree_of
from fbench.replay.logs.poses import TfPoses, TfSource, of_body
from fbench.replay.logs.rig import RigChanges, RigState, first_state
from fbench.replay.logs.rig_patch import fitted, renamed, require_use
from fbench.replay.logs.roles import Role, roles, selected
from fbench.replay.logs.setup import BoxSource, Setup
from fbench.replay.logs.truth import PosesIn, in_body, joined, paired
from fbench.replay.runs.secrets import clean_mapping, without_secrets

T = TypeVar("T", bound=Message | Truth)

_MAX_STAMP_NS = 2**63 - 1


class LogReader:
    """One log; implements `fbench.replay.contracts.protocols.Reader`.

    Holds only blocks that overlap in time. Faults are counted once, however many passes are made. Raises ConfigError
    where a pattern in `topics` fits nothing.
    """

    def __init__(
        self, container: Container, topics: Sequence[str] = (), setup: Setup | None = None,
        faults: FaultLog | None = None,
    ) -> None:  # fmt: skip
        """Open a log.

        Args:
            container: Its messages.
            topics: Patterns of those that are read; all where there are none.
            setup: What the user says about the log.
            faults: Where faults of files beside the log are counted; the container counts its own.
        """
        self.container = container
        self.setup = setup or Setup()
        self.faults = faults or FaultLog()
        if container.header is not None and self.setup.body not in ("", BODY):
            raise ConfigError(f"{self.setup.source}: body.frame: in a log that fbench wrote it is '{BODY}'")
        every = arranged(roles(container), container, self.setup)
        self.roles = selected(every, topics)
        kept = {role.sensor for role in self.roles.values()}
        self.left_out = frozenset(role.sensor for role in every.values()) - kept

    @cached_property
    def info(self) -> LogInfo:
        """Name, id and metadata, without credentials; a log without an id gets one from its topics, schemas and first
        messages.
        """
        header = self.container.header
        log_id = self._digest() if header is None else header.log_id
        metadata = {} if header is None else with_names(header.metadata, self._names if self.setup.sensors else {})
        name = without_secrets(self.container.path.stem)
        return LogInfo(name, without_secrets(log_id), clean_mapping({**metadata, **facts(self.setup)}))

    @cached_property
    def rig(self) -> Rig:
        """Sensors and their calibration, as the log begins. Raises LogError naming the sensor that has no transform, or
        the camera that isn't calibrated.
        """
        return self._stored_rigs[0][1] if self.container.rigs else self._state.rig()

    @cached_property
    def coordinate_frames(self) -> CoordinateFrames:
        """What names of coordinate frames and cameras mean here. Raises LogError where the rig is incomplete."""
        heard = [role for _, role in sorted(self.roles.items()) if role.kind in SENSORS]
        names = {role.frame_id: role.sensor for role in heard} | {role.topic: role.sensor for role in heard}
        world, is_camera0 = self._poses_in.world, self.info.metadata.get(CAMERA0) == BODY
        if self.container.rigs:
            return CoordinateFrames(self.rig, tree_of(self.rig), BODY, names, world, is_camera0)
        return CoordinateFrames(self.rig, self._state.tree, self._state.body(), names, world, is_camera0)

    @cached_property
    def _stored_rigs(self) -> list[tuple[int, Rig]]:
        """Rigs that the container itself holds, as the setup wants them."""
        return [(log_ns, self._arranged_rig(rig)) for log_ns, rig in self.container.rigs]

    def _arranged_rig(self, rig: Rig) -> Rig:
        rig = renamed(rig, self._names) if self.setup.sensors else rig
        heard = {role.sensor: KINDS[role.kind] for _, role in sorted(self.roles.items()) if role.kind in SENSORS}
        patch = fitted(self.setup.rig, self.roles)
        require_use(self.setup.rig, patch, self.roles, patch.tree(tree_of(rig), BODY))
        return patch.on(rig, heard).without(self.left_out)

    @property
    def _names(self) -> dict[str, str]:
        """Sensors by what a log of fbench itself calls them."""
        return {role.frame_id: role.sensor for _, role in sorted(self.roles.items()) if role.kind in SENSORS}

    @cached_property
    def num_messages(self) -> Mapping[str, int]:
        """Messages of each sensor and stream of poses, by name, as the index says."""
        counts: Counter[str] = Counter()
        for id_, role in sorted(self.roles.items()):
            if role.kind in MESSAGES:
                counts[role.sensor] += self.container.counts.get(id_, 0)
        for id_ in sorted(self._tf.channels):
            counts[self._tf.name] += self.container.counts.get(id_, 0)
        if num := sum(self.container.counts.get(id_, 0) for id_ in self.tick_channels):
            counts[BOXES] = num
        return counts

    @cached_property
    def tick_channels(self) -> frozenset[int]:
        """Channels whose messages give the instants: of a topic with truth, else with results; none where a sensor has
        a message.
        """
        heard = self._channels(*SENSORS)
        if not heard.isdisjoint(id_ for id_, num in self.container.counts.items() if num):
            return frozenset()
        by_kind = [sorted(self.roles[id_].topic for id_ in self._channels(kind)) for kind in ("truth", "detections")]
        topic = next((topics[0] for topics in by_kind if topics), None)
        return frozenset(id_ for id_, role in self.roles.items() if role.topic == topic)

    def tick(self, entry: Entry) -> Tick | None:
        """The instant of a message of these channels; `None` where it can't be read."""
        part = next(self.truth_parts(entry), None)
        return None if part is None else Tick(BOXES, part.truth.stamp_ns, entry.log_ns, part.truth.frame_number)

    @cached_property
    def poses(self) -> tuple[str, ...]:
        """Names of the streams of poses."""
        moving = {self._tf.name} if self._tf.channels else set()
        return tuple(sorted({role.sensor for role in self.roles.values() if role.kind == "pose"} | moving))

    @cached_property
    def _tf(self) -> TfSource:
        return TfSource(self.container, self.roles, self.setup.pose, lambda: self._state, self.setup.world)

    @cached_property
    def _poses_in(self) -> PosesIn:
        if self._tf.channels:
            return PosesIn(are_there=True, world=self._tf.world)
        worlds = [role.world for _, role in sorted(self.roles.items()) if role.kind == "pose"]
        return PosesIn(bool(worlds), next(iter(worlds), ""))

    def messages(self) -> Iterator[Message | RigChange]:
        """All measurements and poses in canonical order, and between them where the rig changes."""
        return (message for message in self._read(frozenset()) if not isinstance(message, Tick))

    def ticked(self) -> Iterator[Message | RigChange | Tick]:
        """The same with the instants of boxes, in a log without measurements."""
        return self._read(self.tick_channels)

    def _read(self, ticks: frozenset[int]) -> Iterator[Message | RigChange | Tick]:
        changes, moving = self._changes(), self._tf.poses() if self._tf.channels else None
        channels = self._channels(*MESSAGES) | changes.channels | self._tf.channels | ticks
        for entry in changes.followed(self.container.entries(channels)):
            if entry.channel in changes.channels:
                continue
            yield from changes.until(entry.log_ns)
            message = self.tick(entry) if entry.channel in ticks else self._decoded(entry, moving)
            if message is not None:
                yield message

    def everything(self) -> Iterator[tuple[Entry, Message | RigChange | TruthPart | None]]:
        """All entries of all channels in canonical order, with what each holds: `None` where fbench has no use for it,
        it can't be decoded, or it tells the rig. A change of the rig comes with the entry that it precedes.
        """
        changes, moving = self._changes(), self._tf.poses() if self._tf.channels else None
        for entry in changes.followed(self.container.entries(frozenset(self.container.channels))):
            kind = self.roles[entry.channel].kind if entry.channel in self.roles else ""
            if kind in MESSAGES or entry.channel in self._tf.channels:
                for change in changes.until(entry.log_ns):
                    yield entry, change
                yield entry, self._decoded(entry, moving)
            elif kind in ("truth", "detections"):
                yield entry, next(self.truth_parts(entry), None)
            else:
                if entry.channel not in changes.channels:
                    self._try(entry, kind)
                yield entry, None

    def truths(self) -> Iterator[Truth]:
        """Ground truth, 3D and 2D of one stamp together, in the order of stamps (see `joined`); from a file beside the
        log where the setup names one.
        """
        if self.setup.truth is not None:
            return self._filed(self.setup.truth)
        return joined(
            part for entry in self.container.entries(self._channels("truth")) for part in self.truth_parts(entry)
        )

    def body_poses(self) -> Iterator[Pose]:
        """Poses of the body alone, in canonical order."""
        moving = self._tf.poses() if self._tf.channels else None
        for entry in self.container.entries(self._channels("pose") | self._tf.channels):
            pose = self._decoded(entry, moving)
            if isinstance(pose, Pose):
                yield pose

    def detections(self, topic: str) -> Iterator[Truth]:
        """Results of another system; see `fbench.replay.contracts.protocols.BoxReader`. Raises LogError where there is
        no such topic.
        """
        if not topic and self.setup.results is not None:
            return self._filed(self.setup.results)
        wanted = box_channels(self.roles, topic or next(iter(self.setup.result_topics), ""), self.container.path)
        return paired(part for entry in self.container.entries(wanted) for part in self.truth_parts(entry))

    def _filed(self, source: BoxSource) -> Iterator[Truth]:
        """Boxes of a file, with the labels that the setup gives them."""
        from fbench.replay.formats.open import open_boxes  # most logs have no such file, and tables need pyarrow

        unknown = self._unknown(source.path.name)
        for truth in open_boxes(source, self.coordinate_frames, self.faults).truths():
            yield self._classed(truth, unknown)

    def truth_parts(self, entry: Entry) -> Iterator[TruthPart]:
        """Decode one message of truth, into body coordinates; nothing where it can't be read."""
        role = self.roles[entry.channel]
        try:
            _check(entry)
            if isinstance(entry.data, memoryview):
                part = _codec(role).truth(entry.data, _origin(role, entry))
                part = self._placed(replace(part, truth=self._stamped(entry, part.truth)))
            else:
                part = self._placed(_truth(entry.data.read()))
            yield replace(part, truth=self._classed(part.truth, self._unknown("" if role.is_own else entry.topic)))
        except (DecodeError, DataError) as error:
            self._count(entry, error)

    def _changes(self) -> RigChanges:
        """Messages can be read even where the rig can't."""
        stored = self._stored_rigs[1:]
        try:
            rig: Rig | None = self.rig
        except LogError:
            rig = None
        return RigChanges(rig, stored, None if self.container.rigs else self._state)

    @cached_property
    def _state(self) -> RigState:
        return first_state(self.container, self.roles, self.left_out, self.setup)

    def _channels(self, *kinds: str) -> frozenset[int]:
        return frozenset(id_ for id_, role in self.roles.items() if role.kind in kinds)

    def _placed(self, part: TruthPart) -> TruthPart:
        if not part.frame_id:
            return part
        cameras = {role.frame_id: role.sensor for _, role in sorted(self.roles.items()) if role.kind == "camera"}
        if self.container.rigs:
            return in_body(part, tree_of(self.rig), BODY, cameras, self._poses_in)
        return in_body(part, self._state.tree, self._state.body(), cameras, self._poses_in)

    def _classed(self, truth: Truth, unknown: Callable[[str], None]) -> Truth:
        classes = ClassMap(self.setup.classes)
        boxes3d = None if truth.boxes3d is None else classes.applied(truth.boxes3d, unknown)
        boxes2d = None if truth.boxes2d is None else classes.applied(truth.boxes2d, unknown)
        return replace(truth, boxes3d=boxes3d, boxes2d=boxes2d)

    def _unknown(self, where: str) -> Callable[[str], None]:
        """Return what counts the name of a class that means nothing, once each; importers of fbench know theirs."""
        if not where:
            return lambda name: None
        return lambda name: self.container.once("GT007", (where, name), f"{where}: '{name}'")

    def _decoded(self, entry: Entry, moving: TfPoses | None = None) -> Message | None:
        role = self.roles[entry.channel]
        try:
            _check(entry)
            if isinstance(entry.data, memoryview):
                if moving is not None and entry.channel in self._tf.channels:
                    return moving.decoded(_codec(role), entry.data, entry.log_ns)
                message = _codec(role).message(role.kind, entry.data, _origin(role, entry))
                if isinstance(message, Pose) and not role.is_own:
                    message = self._of_body(message, role.frame_id)
                return as_set_up(self._stamped(entry, message), self.setup)
            return as_set_up(replace(_message(entry.data.read()), sensor=role.sensor), self.setup)
        except (DecodeError, DataError) as error:
            self._count(entry, error)
            return None

    def _of_body(self, pose: Pose, child: str) -> Pose:
        """Where the body is, from the pose of a coordinate frame that is fixed to it."""
        if (why := invalid(pose.translation_m, pose.rotation_xyzw)) is not None:
            raise DecodeError(f"pose {why}")
        try:
            body_T_child = self.coordinate_frames.body_T(child)
        except LogError:  # messages can be read even where the rig can't
            return pose
        if body_T_child is None and child not in BODIES:
            raise DecodeError(f"pose of '{child}', which no fixed transform links to the body")
        return pose if body_T_child is None or np.array_equal(body_T_child, np.eye(4)) else of_body(pose, body_T_child)

    def _stamped(self, entry: Entry, item: T) -> T:
        """Give what another program left without a stamp the time of its recording; counted once a topic."""
        if item.stamp_ns or not entry.log_ns or self.roles[entry.channel].is_own:
            return item
        self.container.once("TIM011", (entry.topic,), f"{entry.topic} at {entry.log_ns}")
        stamped: T = replace(item, stamp_ns=entry.log_ns)
        return stamped

    def _try(self, entry: Entry, kind: str) -> None:
        """Count what can't be decoded of a transform or calibration that isn't followed."""
        try:
            if kind == "transform" and isinstance(entry.data, memoryview):
                _codec(self.roles[entry.channel]).transforms(entry.data)
            elif kind == "calibration" and isinstance(entry.data, memoryview):
                _codec(self.roles[entry.channel]).calibration(entry.data)
        except DecodeError as error:
            self._count(entry, error)

    def _count(self, entry: Entry, error: Exception) -> None:
        where = f"{entry.topic} at {entry.publish_ns}: {error}"
        code = "DEC003" if isinstance(error, PointsError) else "DEC001"
        self.container.once(code, (entry.part, entry.block, entry.offset), where)

    def _digest(self) -> str:
        """Digest of all topics with their schemas and first messages, whatever the ids of their channels."""
        digest = blake2b(digest_size=16)
        channels = self.container.channels
        by_topic: dict[str, list[int]] = {}
        for id_, channel in sorted(channels.items()):
            by_topic.setdefault(channel.topic, []).append(id_)
        for topic, ids_ in sorted(by_topic.items()):
            ids = frozenset(ids_)
            schema = channels[min(ids)].schema
            entry = next(self.container.entries(ids), None)
            parts = [topic.encode()]
            parts += [] if schema is None else [schema.name.encode(), schema.data]
            parts += [] if entry is None else [entry.log_ns.to_bytes(8, "little")]
            parts += [bytes(entry.data)] if entry is not None and isinstance(entry.data, memoryview) else []
            for part in parts:
                digest.update(len(part).to_bytes(8, "little") + part)
        return digest.hexdigest()


def _codec(role: Role) -> Codec:
    if role.codec is None:
        raise DecodeError(f"topic '{role.topic}' can't be decoded")
    return role.codec


def _origin(role: Role, entry: Entry) -> Origin:
    number = entry.sequence if role.numbered else None
    return Origin(role.sensor, entry.log_ns, entry.publish_ns, number, role.size_wh)


def _check(entry: Entry) -> None:
    if max(entry.log_ns, entry.publish_ns) > _MAX_STAMP_NS:
        raise DecodeError("stamp doesn't fit an int64")


def _message(stored: Message | TruthPart) -> Message:
    if isinstance(stored, TruthPart):
        raise DecodeError("truth in the place of a measurement")
    return stored


def _truth(stored: Message | TruthPart) -> TruthPart:
    if not isinstance(stored, TruthPart):
        raise DecodeError("a measurement in the place of truth")
    return stored
