"""Inspection of a log for its configuration: topics, a few messages of each, and the draft of values with reasons."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.arrays import Int64
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.logs.codecs.codec import SENSORS, Origin, TruthPart
from fbench.replay.logs.codecs.foxglove.proto import parse, split
from fbench.replay.logs.codecs.points import DOPPLER_FIELDS, VECTOR_FIELDS
from fbench.replay.logs.codecs.ros.cursor import read_cloud
from fbench.replay.logs.codecs.ros.definitions import full_name
from fbench.replay.logs.container import Channel, Container, Entry
from fbench.replay.logs.containers.limits import Seekable
from fbench.replay.logs.open import span_ns
from fbench.replay.logs.roles import Codecs, Role, roles

Value = str | bool | int | float | tuple[str, ...]


@dataclass(frozen=True)
class Line:
    """One key of a table."""

    key: str
    value: Value
    why: str = ""
    is_guess: bool = False  # Whether somebody should look at it
    is_active: bool = True  # Else it is only suggested, as a comment


@dataclass(frozen=True)
class Table:
    """One table."""

    path: tuple[str, ...]  # `("sensors", "front")` is `[sensors.front]`
    lines: tuple[Line, ...]
    why: str = ""
    notes: tuple[str, ...] = ()  # Comments above it
    is_active: bool = True
    is_guess: bool = False


@dataclass(frozen=True)
class LeftOut:
    """A topic that isn't used."""

    topic: str
    why: str


@dataclass(frozen=True)
class Draft:
    """A whole configuration."""

    log: str  # Name of the log
    tables: tuple[Table, ...]
    left_out: tuple[LeftOut, ...] = ()


NUM_WINDOWS = 4
MAX_ENTRIES = 800  # Messages of a window
MAX_BYTES = 128 * 1024 * 1024  # Payload of a window
_STORED_BYTES = 100_000  # What a message counts that the container gives decoded, without telling its size


@dataclass(frozen=True, eq=False)
class Sampled:
    """One message, and in which window it is: messages of one window follow each other without a gap."""

    window: int
    entry: Entry


def sampled(
    container: Container, channels: frozenset[int], times: Mapping[int, Int64] | None, max_entries: int = MAX_ENTRIES
) -> Iterator[Sampled]:
    """Yield the messages of these channels from a few windows of time that are spread over the log.

    Args:
        container: The log.
        channels: Those that are wanted.
        times: Log times of all channels, where the index tells them.
        max_entries: Messages of a window.
    """
    starts = _starts(container, channels, times) if channels else []
    for window, start_ns in enumerate(starts):
        end_ns = starts[window + 1] if window + 1 < len(starts) else None
        for entry in _window(container, channels, start_ns, end_ns, max_entries):
            yield Sampled(window, entry)


def _starts(container: Container, channels: frozenset[int], times: Mapping[int, Int64] | None) -> list[int | None]:
    """Log times at which windows begin; `None`: where the log does."""
    if not isinstance(container, Seekable):
        return [None]
    if times is None:
        first, last = span_ns(container, None) or (0, 0)
        return [None, *(first + (last - first) * i // NUM_WINDOWS for i in range(1, NUM_WINDOWS))]
    known = [np.zeros(0, np.int64), *(times[id_] for id_ in sorted(channels & times.keys()))]
    merged = np.sort(np.concatenate(known), kind="stable")
    # Shares of messages, not of time: there may be hours without any.
    later = sorted({int(merged[len(merged) * i // NUM_WINDOWS]) for i in range(1, NUM_WINDOWS)} if len(merged) else [])
    return [None, *(start for start in later if start > merged[0])]


def _window(
    container: Container, channels: frozenset[int], start_ns: int | None, end_ns: int | None, max_entries: int
) -> Iterator[Entry]:
    num_bytes = 0
    if start_ns is None or not isinstance(container, Seekable):
        entries = container.entries(channels)
    else:
        entries = container.entries_from(channels, start_ns)
    for entry in islice(entries, max_entries):
        if end_ns is not None and entry.log_ns >= end_ns:
            return
        yield entry
        num_bytes += len(entry.data) if isinstance(entry.data, memoryview) else _STORED_BYTES
        if num_bytes > MAX_BYTES:
            return


def cloud_fields(channel: Channel, entry: Entry) -> tuple[str, ...]:
    """Return the names of a cloud's fields, none where the message isn't a cloud or can't be read."""
    if not isinstance(entry.data, memoryview):
        return ()
    try:
        if channel.schema_name == "foxglove.PointCloud":
            proto = parse(CloudProto, split(entry.data, CloudProto.DATA_FIELD_NUMBER)[0])
            return tuple(field.name for field in proto.fields)
        if channel.encoding in ("cdr", "ros1") and full_name(channel.schema_name) == "sensor_msgs/msg/PointCloud2":
            return tuple(field.name for field in read_cloud(entry.data, channel.encoding).fields)
    except DecodeError:
        pass
    return ()


def doppler_field(fields: tuple[str, ...]) -> str:
    """Return which field gives the radial velocity that fbench reads, empty where none does."""
    lower = {name.lower(): name for name in fields}
    found = next((lower[name] for name in DOPPLER_FIELDS if name in lower), "")
    if not found and all(name in lower for name in VECTOR_FIELDS):
        return " and ".join(lower[name] for name in VECTOR_FIELDS)
    return found


def compensated_field(fields: tuple[str, ...]) -> str:
    """Return a field with velocities that are free of the vehicle's own motion, which fbench doesn't read."""
    words = ("comp", "compensated", "corrected", "ego")
    speeds = ("v", "vr", "vx", "doppler", "velocity", "speed", "radial")
    for name in fields:
        parts = name.lower().split("_")
        if any(part in words for part in parts) and any(part in speeds for part in parts):
            return name
    return ""


MEASURED = (*SENSORS, "pose", "odometry")
_MAX_SCANS = 12  # Radar scans of a window that are kept


@dataclass(frozen=True, eq=False)
class Seen:
    """One message of a sample."""

    window: int
    stamp_ns: int  # As recorded, 0 where it has none
    log_ns: int
    num_points: int | None = None
    scan: RadarScan | None = None
    pose: Pose | None = None


@dataclass(frozen=True, eq=False)
class Heard:
    """One topic with measurements."""

    role: Role
    schema: str
    num_messages: int
    fields: tuple[str, ...] = ()  # Of the points of a cloud
    log_ns: Int64 | None = None  # Of all messages, ascending, where the index tells them
    seen: tuple[Seen, ...] = ()
    size_wh: tuple[int, int] | None = None  # Of the first image [px]

    @property
    def topic(self) -> str:
        """Its name."""
        return self.role.topic

    @property
    def period_ns(self) -> int | None:
        """Median time between messages, by their log times."""
        times = np.array([s.log_ns for s in self.seen], np.int64) if self.log_ns is None else self.log_ns
        steps = np.sort(np.diff(times), kind="stable")
        return int(steps[len(steps) // 2]) or None if len(steps) else None

    @property
    def median_points(self) -> int | None:
        """Points of a cloud."""
        nums = sorted(s.num_points for s in self.seen if s.num_points is not None)
        return nums[len(nums) // 2] if nums else None


@dataclass(frozen=True, eq=False)
class Unread:
    """A topic that fbench doesn't read."""

    topic: str
    schema: str
    why: str


@dataclass(frozen=True, eq=False)
class Look:
    """What was seen of a log."""

    container: Container
    roles: Mapping[int, Role]
    times: Mapping[int, Int64] | None
    heard: tuple[Heard, ...]  # By topic
    unread: tuple[Unread, ...]

    @property
    def metadata(self) -> Mapping[str, str]:
        """What the log says about itself."""
        header = self.container.header
        return {} if header is None else header.metadata


@dataclass
class _Topic:
    role: Role
    schema: str
    num: int = 0
    fields: tuple[str, ...] = ()
    size_wh: tuple[int, int] | None = None
    times: list[Int64] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    num_scans: dict[int, int] = field(default_factory=dict)


def look_at(container: Container) -> Look:
    """Look at a log; what can't be decoded is passed over. Raises LogError where it can't be read."""
    found, times = roles(container), container.log_times()
    topics: dict[str, _Topic] = {}
    for id_, role in sorted(found.items()):
        if role.kind in MEASURED:
            topic = topics.setdefault(role.topic, _Topic(role, container.channels[id_].schema_name))
            topic.num += container.counts.get(id_, 0)
            topic.times += [] if times is None or id_ not in times else [times[id_]]
    wanted = frozenset(id_ for id_, role in found.items() if role.kind in MEASURED)
    for sample in sampled(container, wanted, times):
        _take(topics[found[sample.entry.channel].topic], sample.window, sample.entry, container)
    heard = tuple(_heard(topic, times is not None) for _, topic in sorted(topics.items()))
    return Look(container, found, times, heard, tuple(_unread(container, found)))


def _heard(topic: _Topic, has_times: bool) -> Heard:
    log_ns = np.sort(np.concatenate([np.zeros(0, np.int64), *topic.times]), kind="stable") if has_times else None
    return Heard(topic.role, topic.schema, topic.num, topic.fields, log_ns, tuple(topic.seen), topic.size_wh)


def _take(topic: _Topic, window: int, entry: Entry, container: Container) -> None:
    if not topic.fields:
        topic.fields = cloud_fields(container.channels[entry.channel], entry)
    try:
        message = _decoded(topic.role, entry)
    except (DecodeError, DataError):
        return
    if isinstance(message, Image):
        topic.size_wh = topic.size_wh or message.size_wh
    num_points = len(message.xyz) if isinstance(message, (PointCloud, RadarScan)) else None
    scan = message if isinstance(message, RadarScan) else None
    if scan is not None:
        topic.num_scans[window] = topic.num_scans.get(window, 0) + 1
        scan = scan if topic.num_scans[window] <= _MAX_SCANS else None
    pose = message if isinstance(message, Pose) else None
    topic.seen.append(Seen(window, message.stamp_ns, entry.log_ns, num_points, scan, pose))


def _decoded(role: Role, entry: Entry) -> Message:
    if not isinstance(entry.data, memoryview):
        message = entry.data.read()
        if isinstance(message, TruthPart):
            raise DecodeError("truth in the place of a measurement")
        return message
    if role.codec is None:
        raise DecodeError("no codec")
    kind = "pose" if role.kind == "odometry" else role.kind
    return role.codec.message(kind, entry.data, Origin(role.sensor, entry.log_ns, entry.publish_ns, None, role.size_wh))


def _unread(container: Container, found: Mapping[int, Role]) -> Iterator[Unread]:
    """Topics without a use, once each, with the reason."""
    used = {role.topic for role in found.values()}
    topics = {c.topic: id_ for id_, c in sorted(container.channels.items(), reverse=True) if c.topic not in used}
    codecs = Codecs()
    for topic, id_ in sorted(topics.items()):
        channel = container.channels[id_]
        yield Unread(topic, channel.schema_name, _why(codecs, container, id_))


def _why(codecs: Codecs, container: Container, id_: int) -> str:
    channel = container.channels[id_]
    if not container.counts.get(id_, 1):
        return "no messages"
    try:
        codec = codecs.of(channel)
        entry = next(islice(container.entries(frozenset([id_])), 1), None) if codec is not None else None
        if codec is not None and entry is not None and isinstance(entry.data, memoryview):
            codec.probe(entry.data)
    except DecodeError as error:
        return str(error).partition(", only ")[0]
    return f"fbench reads no '{channel.schema_name or channel.encoding or 'unknown type'}'"
