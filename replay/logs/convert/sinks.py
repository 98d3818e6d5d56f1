"""Items of a conversion, encoded for the level of the container, and the sinks that they go to."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from google.protobuf.message import Message as Proto

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.messages import Message
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.codecs.foxglove.proto import descriptor_set
from fbench.replay.logs.codecs.foxglove.topics import Record, message_records, part_record, rig_records
from fbench.replay.logs.container import Channel, Entry, LogHeader, Schema
from fbench.replay.logs.containers.mcap.write import RawMcapWriter
from fbench.replay.logs.containers.parquet.write import ParquetWriter
from fbench.replay.logs.convert.target import PartsWriter, Target


class Copied(NamedTuple):
    """A message as the source has it, byte for byte."""

    channel: Channel
    entry: Entry


class Decoded(NamedTuple):
    """A message in fbench's own types."""

    topic: str
    log_ns: int
    content: Message | TruthPart


class RigAt(NamedTuple):
    """From `log_ns` on this rig holds."""

    log_ns: int
    rig: Rig
    stamp_ns: int | None = None  # Of the messages that told it; `None`: no messages did


Item = Copied | Decoded | RigAt


def log_ns_of(item: Item) -> int:
    """Return the log time of an item."""
    return item.entry.log_ns if isinstance(item, Copied) else item.log_ns


class Encoded(NamedTuple):
    """One message as a container of bytes holds it."""

    channel: Channel
    publish_ns: int
    sequence: int
    data: bytes


class Encoder:
    """Encodes messages; keeps the schemas that it met."""

    def __init__(self) -> None:
        self._schemas: dict[str, Schema] = {}

    def message(self, topic: str, content: Message | TruthPart) -> Encoded:
        """Encode a measurement, pose or part of truth, under its own topic. Raises ValueError where Protobuf can't hold
        a value.
        """
        if isinstance(content, TruthPart):
            truth = content.truth
            return self._encode(part_record(content), truth.stamp_ns, truth.frame_number)
        record = next(message_records(content))
        return self._encode(record._replace(topic=topic), content.stamp_ns, content.frame_number)

    def result(self, part: TruthPart) -> Encoded:
        """Encode the boxes that another system found. Raises ValueError where Protobuf can't hold a value."""
        return self._encode(part_record(part, "detections"), part.truth.stamp_ns, part.truth.frame_number)

    def rig(self, stamp_ns: int, rig: Rig) -> list[Encoded]:
        """Encode a rig: a transform a sensor and a calibration a camera. Raises ValueError where Protobuf can't hold a
        value.
        """
        return [self._encode(record, stamp_ns, None) for record in rig_records(stamp_ns, rig)]

    def _encode(self, record: Record, stamp_ns: int, frame_number: int | None) -> Encoded:
        channel = Channel(record.topic, "protobuf", self._schema(record.proto), record.metadata)
        return Encoded(channel, stamp_ns, frame_number or 0, record.proto.SerializeToString(deterministic=True))

    def _schema(self, proto: Proto) -> Schema:
        name = proto.DESCRIPTOR.full_name
        if name not in self._schemas:
            self._schemas[name] = Schema(name, "protobuf", descriptor_set(type(proto)))
        return self._schemas[name]


class Sink(Protocol):
    """Writes one log; nothing appears under its name before `close`."""

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the files of a log in parts."""
        ...

    def put(self, item: Item) -> None:
        """Append an item; they come in canonical order."""
        ...

    def close(self) -> None:
        """Finish the log and give it its name."""
        ...

    def discard(self) -> None:
        """Leave nothing behind; does nothing after `close`."""
        ...


class MessageWriter(Protocol):
    """A file, or several, that take messages as bytes."""

    def add(self, channel: Channel, log_ns: int, publish_ns: int, sequence: int, data: bytes | memoryview) -> None:
        """Append one message."""
        ...

    def close(self) -> None:
        """Finish."""
        ...

    def discard(self) -> None:
        """Leave nothing behind."""
        ...


class McapSink:
    """Writes MCAP: bytes as they are, messages in fbench's own encoding."""

    def __init__(self, writer: MessageWriter, name: str, names: Sequence[str] = ()) -> None:
        self._writer, self._name, self._names = writer, name, names
        self._encoder = Encoder()
        self._schemas: dict[str, str] = {}
        self._waiting: Rig | None = None
        """A rig without times of its own: viewers need it by the time of the first message."""

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the files of a log in parts."""
        return tuple(self._names)

    def put(self, item: Item) -> None:
        """Append an item. Raises LogError where a message can't be encoded."""
        if isinstance(item, RigAt):
            self._put_rig(item)
        elif isinstance(item, Copied):
            entry = item.entry
            self._tell_rig(entry.publish_ns, entry.log_ns)
            if isinstance(entry.data, memoryview):
                self._writer.add(item.channel, entry.log_ns, entry.publish_ns, entry.sequence, entry.data)
        else:
            self._put_decoded(item)

    def close(self) -> None:
        """Finish the log."""
        self._tell_rig(0, 0)
        self._writer.close()

    def discard(self) -> None:
        """Leave nothing behind."""
        self._writer.discard()

    def _put_rig(self, item: RigAt) -> None:
        if item.stamp_ns is None and item.log_ns == 0:
            self._waiting = item.rig
        else:
            self._waiting = None
            self._add_rig(item.rig, item.log_ns if item.stamp_ns is None else item.stamp_ns, item.log_ns)

    def _tell_rig(self, stamp_ns: int, log_ns: int) -> None:
        if self._waiting is not None:
            rig, self._waiting = self._waiting, None
            self._add_rig(rig, stamp_ns, log_ns)

    def _add_rig(self, rig: Rig, stamp_ns: int, log_ns: int) -> None:
        try:
            encoded = self._encoder.rig(stamp_ns, rig)
        except ValueError as error:
            raise LogError(f"{self._name}: the rig at {log_ns} can't be stored ({error})") from error
        for message in encoded:
            self._add(message, log_ns)

    def _put_decoded(self, item: Decoded) -> None:
        content = item.content
        stamp_ns = content.truth.stamp_ns if isinstance(content, TruthPart) else content.stamp_ns
        try:
            encoded = self._encoder.message(item.topic, content)
        except ValueError as error:
            raise LogError(f"{self._name}: {item.topic} at {stamp_ns} can't be stored ({error})") from error
        self._tell_rig(stamp_ns, item.log_ns)
        self._add(encoded, item.log_ns)

    def _add(self, message: Encoded, log_ns: int) -> None:
        channel = message.channel
        known = self._schemas.setdefault(channel.topic, channel.schema_name)
        if known != channel.schema_name:
            raise LogError(
                f"{self._name}: topic '{channel.topic}' can't hold {known} and {channel.schema_name}", "LOG009"
            )
        self._writer.add(channel, log_ns, message.publish_ns, message.sequence, message.data)


class ParquetSink:
    """Writes Parquet: messages in fbench's own types as columns, others as bytes."""

    parts: tuple[str, ...] = ()

    def __init__(self, writer: ParquetWriter) -> None:
        self._writer = writer

    def put(self, item: Item) -> None:
        """Append an item. Raises LogError where a message can't be stored."""
        if isinstance(item, RigAt):
            self._writer.write_rig(item.log_ns, item.rig, item.stamp_ns)
        elif isinstance(item, Copied):
            self._writer.write_raw(item.channel, item.entry)
        elif isinstance(item.content, TruthPart):
            self._writer.write_part(item.content, item.topic)
        else:
            self._writer.write(item.content, item.topic)

    def close(self) -> None:
        """Finish the log."""
        self._writer.close()

    def discard(self) -> None:
        """Leave nothing behind."""
        self._writer.discard()


_CHUNK = 1024 * 1024


def open_sink(target: Target, about: LogHeader) -> Sink:
    """Begin to write a log. Raises ConfigError where it can't be written, or not with this compression. Raises LogError
    where its metadata aren't Unicode.
    """
    compression = target.compression or "zstd"
    if target.form == "parquet":
        info = LogInfo(target.path.stem, about.log_id, about.metadata)
        return ParquetSink(ParquetWriter(target.path, info, None, compression, target.rows_per_group, about.kinds))

    def open_file(path: Path) -> RawMcapWriter:
        return RawMcapWriter(path, about, compression, target.chunk_size or _CHUNK)

    if target.split is None:
        return McapSink(open_file(target.path), str(target.path))
    parts = PartsWriter(target.path, target.split, open_file)
    return McapSink(parts, str(target.path), parts.names)
