"""Items of a conversion, encoded for the level of the container, and the sinks that they go to."""

from pathlib import Path
from typing import NamedTuple

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.messages import Message
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.codecs.foxglove.topics import message_records, part_record, rig_records
from fbench.replay.logs.container import Channel, Entry, LogHeader
from fbench.replay.logs.containers.mcap.write import CHUNK_SIZE, Encoded, RawMcapWriter, encode
from fbench.replay.logs.containers.parquet.write import ParquetWriter
from fbench.replay.logs.convert.target import PartsWriter, Target
from fbench.replay.runs.secrets import readable


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


def encode_message(topic: str, content: Message | TruthPart) -> Encoded:
    """Encode a measurement or pose, or a part of truth under its own topic. Raises ValueError where Protobuf can't hold
    a value.
    """
    if isinstance(content, TruthPart):
        return encode(part_record(content), content.truth.stamp_ns, content.truth.frame_number)
    record = next(message_records(content))
    return encode(record._replace(topic=topic), content.stamp_ns, content.frame_number)


def encode_result(part: TruthPart) -> Encoded:
    """Encode the boxes that another system found. Raises ValueError where Protobuf can't hold a value."""
    return encode(part_record(part, "detections"), part.truth.stamp_ns, part.truth.frame_number)


def encode_rig(stamp_ns: int, rig: Rig) -> list[Encoded]:
    """Encode a rig: a transform a sensor and a calibration a camera. Raises ValueError where Protobuf can't hold a
    value.
    """
    return [encode(record, stamp_ns) for record in rig_records(stamp_ns, rig)]


class McapSink:
    """Writes one log as MCAP: bytes as they are, messages in fbench's own encoding. Nothing appears under its name
    before `close`.
    """

    def __init__(self, writer: RawMcapWriter | PartsWriter) -> None:
        self._writer = writer
        self._schemas: dict[str, str] = {}
        self._waiting: Rig | None = None
        """A rig without times of its own: viewers need it by the time of the first message."""

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the files of a log in parts."""
        return tuple(self._writer.names) if isinstance(self._writer, PartsWriter) else ()

    def put(self, item: Item) -> None:
        """Append an item; they come in canonical order. Raises LogError where a message can't be encoded."""
        if isinstance(item, RigAt):
            self._waiting = item.rig
            if item.stamp_ns is not None or item.log_ns != 0:
                self._add_rig(item.log_ns if item.stamp_ns is None else item.stamp_ns, item.log_ns)
        elif isinstance(item, Copied):
            entry = item.entry
            self._add_rig(entry.publish_ns, entry.log_ns)
            if isinstance(entry.data, memoryview):
                self._writer.add(item.channel, entry.log_ns, entry.publish_ns, entry.sequence, entry.data)
        else:
            message = item.content.truth if isinstance(item.content, TruthPart) else item.content
            try:
                encoded = encode_message(item.topic, item.content)
            except ValueError as error:
                where = f"{self._writer.path}: {item.topic} at {message.stamp_ns}"
                raise LogError(f"{where} can't be stored ({error})") from error
            self._add_rig(message.stamp_ns, item.log_ns)
            self._add(encoded, item.log_ns)

    def close(self) -> None:
        """Finish the log and give it its name."""
        self._add_rig(0, 0)
        self._writer.close()

    def discard(self) -> None:
        """Leave nothing behind; does nothing after `close`."""
        self._writer.discard()

    def _add_rig(self, stamp_ns: int, log_ns: int) -> None:
        """Append the rig that waits, if any."""
        rig, self._waiting = self._waiting, None
        try:
            encoded = [] if rig is None else encode_rig(stamp_ns, rig)
        except ValueError as error:
            raise LogError(f"{self._writer.path}: the rig at {log_ns} can't be stored ({error})") from error
        for message in encoded:
            self._add(message, log_ns)

    def _add(self, message: Encoded, log_ns: int) -> None:
        topic, schema = message.channel.topic, message.channel.schema_name
        known = self._schemas.setdefault(topic, schema)
        if known != schema:
            raise LogError(f"{self._writer.path}: topic '{topic}' can't hold {known} and {schema}", "LOG009")
        self._writer.add(message.channel, log_ns, message.publish_ns, message.sequence, message.data)


class ParquetSink(ParquetWriter):
    """Writes Parquet: messages in fbench's own types as columns, others as bytes."""

    parts: tuple[str, ...] = ()

    def put(self, item: Item) -> None:
        """Append an item; they come in canonical order. Raises LogError where a message can't be stored."""
        if isinstance(item, RigAt):
            self.write_rig(item.log_ns, item.rig, item.stamp_ns)
        elif isinstance(item, Copied):
            self.write_raw(item.channel, item.entry)
        elif isinstance(item.content, TruthPart):
            self.write_part(item.content, item.topic)
        else:
            self.write(item.content, item.topic)


Sink = McapSink | ParquetSink


def open_sink(target: Target, about: LogHeader) -> Sink:
    """Begin to write a log. Raises ConfigError where it can't be written, or not with this compression. Raises LogError
    where its metadata aren't Unicode.
    """
    compression = target.compression or "zstd"
    if target.form == "parquet":
        info = LogInfo(readable(target.path.stem), about.log_id, about.metadata)
        return ParquetSink(target.path, info, None, compression, target.rows_per_group, about.kinds)

    def open_file(path: Path) -> RawMcapWriter:
        return RawMcapWriter(path, about, compression, target.chunk_size or CHUNK_SIZE)

    if target.split is None:
        return McapSink(open_file(target.path))
    return McapSink(PartsWriter(target.path, target.split, open_file))
