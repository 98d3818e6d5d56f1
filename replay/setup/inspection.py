"""Inspection of a log for its configuration: topics, a few messages of each, and the draft of values with reasons."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise

import numpy as np
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.arrays import Int64
from fbench.replay.data.messages import Image, Message, Pose, RadarScan
from fbench.replay.logs.assembly import Assembly
from fbench.replay.logs.bursts import is_repeat
from fbench.replay.logs.codecs.codec import SENSORS, Origin, TruthPart
from fbench.replay.logs.codecs.foxglove.codec import JSON
from fbench.replay.logs.codecs.foxglove.json_messages import to_protobuf
from fbench.replay.logs.codecs.foxglove.proto import parse, split
from fbench.replay.logs.codecs.plugin import NamedDecoder
from fbench.replay.logs.codecs.ros.clouds import read_cloud
from fbench.replay.logs.codecs.ros.definitions import full_name
from fbench.replay.logs.container import Channel, Container, Entry
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
    notes: tuple[str, ...] = ()  # Comments above it
    is_active: bool = True


@dataclass(frozen=True)
class LeftOut:
    """A topic that isn't used."""

    topic: str
    why: str
    schema: str = ""


@dataclass(frozen=True)
class Draft:
    """A whole configuration."""

    log: str  # Name of the log
    tables: tuple[Table, ...]
    left_out: tuple[LeftOut, ...] = ()
    lines: tuple[Line, ...] = ()  # Above all tables
    notes: tuple[str, ...] = ()  # Comments at its end

    def table(self, path: tuple[str, ...]) -> Table:
        """Return a table; an empty one where there is none."""
        return next((table for table in self.tables if table.path == path), Table(path, ()))

    def value(self, path: tuple[str, ...], key: str) -> Value | None:
        """Return the value of a key; `None` where it isn't there, or only suggested."""
        table = self.table(path)
        lines = table.lines if table.is_active else ()
        return next((line.value for line in lines if line.key == key and line.is_active), None)

    def with_table(self, table: Table) -> "Draft":
        """Return the draft with another table in the place of that with its path."""
        return replace(self, tables=tuple(table if old.path == table.path else old for old in self.tables))

    def with_line(self, path: tuple[str, ...], line: Line) -> "Draft":
        """Return the draft with a line in the place of the active one with its key, else at the end of the table."""
        table = self.table(path)
        is_there = any(old.key == line.key and old.is_active for old in table.lines)
        lines = tuple(line if old.key == line.key and old.is_active else old for old in table.lines)
        return self.with_table(replace(table, lines=lines if is_there else (*lines, line)))

    def without_table(self, path: tuple[str, ...], note: str) -> "Draft":
        """Return the draft with a table as a comment, and a note above it."""
        table = self.table(path)
        return self.with_table(replace(table, is_active=False, notes=(note, *table.notes)))


NUM_WINDOWS = 4
MAX_ENTRIES = 800  # Messages of a window
_MAX_BYTES = 128 * 1024 * 1024  # Payload of a window
_STORED_BYTES = 100_000  # What a message counts that the container gives decoded, without telling its size
_MAX_SCANS = 12  # Radar scans of a window that are kept
_MEASURED = (*SENSORS, "pose", "odometry")


def sample_messages(
    container: Container, channels: frozenset[int], times: Mapping[int, Int64] | None, max_entries: int = MAX_ENTRIES
) -> Iterator[tuple[int, Entry]]:
    """Yield at most `max_entries` messages of these channels from each of a few windows of time, spread over the log.
    Each comes with the number of its window: messages of one window follow each other without a gap. `times` are the
    log times of all channels, where the index tells them.
    """
    starts = _window_starts(container, channels, times) if channels else []
    for window, start_ns in enumerate(starts):
        end_ns = starts[window + 1] if window + 1 < len(starts) else None
        num_bytes = 0
        for entry in islice(container.entries(channels, start_ns), max_entries):
            if end_ns is not None and entry.log_ns >= end_ns:
                break
            yield window, entry
            num_bytes += len(entry.data) if isinstance(entry.data, memoryview) else _STORED_BYTES
            if num_bytes > _MAX_BYTES:
                break


def _window_starts(
    container: Container, channels: frozenset[int], times: Mapping[int, Int64] | None
) -> list[int | None]:
    """Log times at which windows begin; `None`: where the log does."""
    if times is None:
        first, last = span_ns(container, None) or (0, 0)
        return [None, *(first + (last - first) * i // NUM_WINDOWS for i in range(1, NUM_WINDOWS))]
    known = [np.zeros(0, np.int64), *(times[id_] for id_ in sorted(channels & times.keys()))]
    merged = np.sort(np.concatenate(known), kind="stable")
    # Shares of messages, not of time: there may be hours without any.
    later = sorted({int(merged[len(merged) * i // NUM_WINDOWS]) for i in range(1, NUM_WINDOWS)} if len(merged) else [])
    return [None, *(start for start in later if start > merged[0])]


@dataclass(eq=False)
class SampledMessage:
    """One message of a sample."""

    window: int
    stamp_ns: int  # As recorded, 0 where it has none
    log_ns: int
    num_points: int | None = None
    scan: RadarScan | None = None
    pose: Pose | None = None


@dataclass(eq=False)
class SampledTopic:
    """One topic with measurements."""

    role: Role
    schema: str
    num_messages: int = 0
    is_estimate: bool = False  # Whether a sample says how many messages a measurement has
    fields: tuple[str, ...] = ()  # Of the points of a cloud
    log_ns: Int64 | None = None  # Of all messages, ascending, where the index tells them
    samples: list[SampledMessage] = field(default_factory=list)
    size_wh: tuple[int, int] | None = None  # Of the first image [px]

    @property
    def topic(self) -> str:
        """Its name."""
        return self.role.topic

    @property
    def period_ns(self) -> int | None:
        """Median time between messages, by their log times."""
        times = np.array([s.log_ns for s in self.samples], np.int64) if self.log_ns is None else self.log_ns
        return median_step(times)

    @property
    def rate_text(self) -> str:
        """Its rate as users read it, empty where it isn't known."""
        return "" if self.period_ns is None else f"{1e9 / self.period_ns:.1f} Hz"

    @property
    def median_points(self) -> int | None:
        """Points of a cloud."""
        nums = sorted(s.num_points for s in self.samples if s.num_points is not None)
        return nums[len(nums) // 2] if nums else None


def median_step(times: Int64) -> int | None:
    """Median difference between ascending times (N,), `None` where it is 0 or there are none."""
    steps = np.sort(np.diff(times), kind="stable")
    return int(steps[len(steps) // 2]) or None if len(steps) else None


@dataclass(frozen=True, eq=False)
class Inspection:
    """What was seen of a log."""

    container: Container
    roles: Mapping[int, Role]
    times: Mapping[int, Int64] | None
    topics: tuple[SampledTopic, ...]  # By name
    unread: tuple[LeftOut, ...]
    decoders: Sequence[NamedDecoder] = ()


def inspect_log(container: Container, decoders: Sequence[NamedDecoder] = ()) -> Inspection:
    """Sample a log; what can't be decoded is passed over. Raises LogError where it can't be read."""
    found, times = roles(container, decoders), container.log_times()
    measured = {id_: role for id_, role in sorted(found.items()) if role.kind in _MEASURED}
    topics: dict[str, SampledTopic] = {}
    for id_, role in measured.items():
        topic = topics.setdefault(role.topic, SampledTopic(role, container.channels[id_].schema_name))
        topic.num_messages += container.counts.get(id_, 0)
        if times is not None:
            known = [part for part in (topic.log_ns, times.get(id_)) if part is not None]
            topic.log_ns = np.sort(np.concatenate([np.zeros(0, np.int64), *known]), kind="stable")
    assemblies: defaultdict[int, Assembly] = defaultdict(Assembly)  # By window
    num_scans: Counter[tuple[str, int]] = Counter()
    num_taken: Counter[str] = Counter()
    for window, entry in sample_messages(container, frozenset(measured), times):
        topic = topics[found[entry.channel].topic]
        num_taken[topic.topic] += 1
        if not topic.fields:
            topic.fields = _cloud_fields(container.channels[entry.channel], entry)
        with suppress(DecodeError, DataError):
            message = _decode(topic.role, entry, assemblies[window])
            if message is None:
                continue
            sample = SampledMessage(window, message.stamp_ns, entry.log_ns)
            if isinstance(message, Image):
                topic.size_wh = topic.size_wh or (message.size_wh if all(message.size_wh) else None)
            elif isinstance(message, Pose):
                sample.pose = message
            else:
                sample.num_points = len(message.xyz)
            if isinstance(message, RadarScan) and num_scans[topic.topic, window] < _MAX_SCANS:
                num_scans[topic.topic, window] += 1
                sample.scan = message
            topic.samples.append(sample)
    for topic in topics.values():
        _count_measurements(topic, num_taken[topic.topic])
    by_name = tuple(topic for _, topic in sorted(topics.items()))
    return Inspection(container, found, times, by_name, _unread_topics(container, found), decoders)


def _count_measurements(topic: SampledTopic, num_taken: int) -> None:
    """Take the parts of a burst, or of a scan in packets, for one message, by what is sampled."""
    if topic.role.codec is not None and topic.role.codec.assembler() is not None:
        if topic.samples:
            _divide(topic, round(num_taken / len(topic.samples)), num_taken)
        else:
            topic.log_ns = None  # no scan is whole, and the rate of packets isn't that of scans
        return
    repeats = [
        a.window == b.window and b.num_points is not None and is_repeat(a.stamp_ns, b.stamp_ns, b.log_ns - a.log_ns)
        for a, b in pairwise(topic.samples)
    ]
    if 2 * sum(repeats) >= len(repeats) > 0:
        num_parts = round(len(topic.samples) / (len(topic.samples) - sum(repeats)))
        topic.samples = [
            *topic.samples[:1],
            *(s for s, again in zip(topic.samples[1:], repeats, strict=True) if not again),
        ]
        _divide(topic, num_parts, num_taken)


def _divide(topic: SampledTopic, num_parts: int, num_taken: int) -> None:
    topic.is_estimate = num_taken < topic.num_messages or topic.num_messages % num_parts != 0
    topic.num_messages = round(topic.num_messages / num_parts)
    topic.log_ns = None if topic.log_ns is None else topic.log_ns[::num_parts]


def _cloud_fields(channel: Channel, entry: Entry) -> tuple[str, ...]:
    """Names of a cloud's fields, none where the message isn't a cloud or can't be read."""
    if not isinstance(entry.data, memoryview):
        return ()
    with suppress(DecodeError):
        if channel.schema_name == "foxglove.PointCloud":
            data = to_protobuf(channel.schema_name, entry.data) if channel.encoding == JSON else entry.data
            proto = parse(CloudProto, split(data, CloudProto.DATA_FIELD_NUMBER)[0])
            return tuple(field.name for field in proto.fields)
        if channel.encoding in ("cdr", "ros1") and full_name(channel.schema_name) == "sensor_msgs/msg/PointCloud2":
            return tuple(field.name for field in read_cloud(entry.data, channel.encoding).fields)
    return ()


def _decode(role: Role, entry: Entry, assembly: Assembly) -> Message | None:
    """Decode a message; `None` where it is a part of a measurement that isn't whole yet."""
    if not isinstance(entry.data, memoryview):
        message = entry.data.read()
        if isinstance(message, TruthPart):
            raise DecodeError("truth in the place of a measurement")
        return message
    if role.codec is None:
        raise DecodeError("no codec")
    kind = "pose" if role.kind == "odometry" else role.kind
    origin = Origin(role.sensor, entry.log_ns, entry.publish_ns, None, role.size_wh)
    return assembly.message(entry.channel, role.codec, kind, entry.data, origin)


def _unread_topics(container: Container, found: Mapping[int, Role]) -> tuple[LeftOut, ...]:
    used, codecs = {role.topic for role in found.values()}, Codecs(container)
    topics = {c.topic: id_ for id_, c in sorted(container.channels.items(), reverse=True) if c.topic not in used}
    result = []
    for topic, id_ in sorted(topics.items()):
        channel = container.channels[id_]
        if container.counts.get(id_, 1):
            why = f"fbench reads no '{channel.schema_name or channel.encoding or 'unknown type'}'"
            try:
                codec = codecs.of(channel)
                why = codecs.metadata.get(id_, why)
                entry = None if codec is None else next(container.entries(frozenset([id_])), None)
                if codec is not None and entry is not None and isinstance(entry.data, memoryview):
                    codec.probe(entry.data)
            except DecodeError as error:
                why = str(error).partition(", only ")[0]
        else:
            why = "no messages"
        result.append(LeftOut(topic, why, channel.schema_name))
    return tuple(result)
