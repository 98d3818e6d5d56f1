"""Sinks of a conversion: MCAP or Parquet."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.container import Channel
from fbench.replay.logs.containers.mcap.write import RawMcapWriter
from fbench.replay.logs.containers.parquet.write import ParquetWriter
from fbench.replay.logs.convert.items import Copied, Decoded, Encoded, Encoder, Item, RigAt
from fbench.replay.logs.convert.target import PartsWriter, Target
from fbench.replay.logs.header import LogHeader


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
        """Append an item.

        Raises:
            LogError: where a message can't be encoded.
        """
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
        """Append an item.

        Raises:
            LogError: where a message can't be stored.
        """
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
    """Begin to write a log.

    Raises:
        ConfigError: where it can't be written, or not with this compression.
        LogError: where its metadata aren't Unicode.
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
