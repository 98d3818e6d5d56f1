"""Writing of MCAP files: chunked, checksummed and indexed."""

from collections.abc import Hashable, Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple, Self, cast

from google.protobuf.message import Message as Proto
from mcap.writer import CompressionType, Writer

from fbench.replay.contracts.errors import ConfigError, LogError, output_error
from fbench.replay.data.files import Draft
from fbench.replay.data.messages import Message, Truth
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.logs import container as header
from fbench.replay.logs.codecs.foxglove.proto import descriptor_set
from fbench.replay.logs.codecs.foxglove.topics import Record, message_records, rig_records
from fbench.replay.logs.container import Channel, LogHeader, Schema, header_of
from fbench.replay.logs.containers.limits import check_storable

COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
CHUNK_SIZE = 1024 * 1024
_MAX_CHANNELS = 2**16 - 1


class RawMcapWriter:
    """Writes one file; nothing appears under its name before it is closed without an error.

    The same messages in the same order give the same bytes. An existing file is replaced. Raises ConfigError where the
    file can't be written, or the compression isn't zstd, lz4 or none. Raises LogError where the metadata aren't
    Unicode.
    """

    def __init__(
        self,
        path: Path,
        about: LogHeader,
        compression: str = "zstd",
        chunk_size: int = CHUNK_SIZE,
        is_chunked: bool = True,
    ) -> None:
        if compression not in COMPRESSIONS:
            raise ConfigError(f"compression '{compression}': choose one of {', '.join(COMPRESSIONS)}")
        self.path = path
        self._schemas: dict[Schema, int] = {}
        self._channels: dict[tuple[object, ...], int] = {}
        self._draft = Draft(path)
        self._file = self._draft.path.open("wb")
        self._writer = Writer(
            self._file, chunk_size, COMPRESSIONS[compression], use_chunking=is_chunked, enable_data_crcs=True
        )
        try:
            self._writer.start(profile="", library="fbench")
            self._writer.add_metadata(header.NAME, header.header_record(about))
        except (ValueError, OSError) as error:
            self.discard()
            if isinstance(error, OSError):
                raise output_error(path, error) from error
            raise LogError(f"{path}: metadata can't be stored ({error})") from error

    @property
    def is_open(self) -> bool:
        """Whether messages can be added."""
        return not self._file.closed

    @property
    def num_bytes(self) -> int:
        """Bytes written to the file so far, without the chunk that is being filled."""
        return self._file.tell()

    def add(self, channel: Channel, log_ns: int, publish_ns: int, sequence: int, data: bytes | memoryview) -> None:
        """Append one message. Raises ConfigError where the disk is full. Raises LogError where the file has too many
        channels.
        """
        try:
            self._writer.add_message(self._id(channel), log_ns, bytes(data), publish_ns, sequence)
        except OSError as error:
            raise output_error(self.path, error) from error

    def close(self) -> None:
        """Finish the file and give it its name; does nothing the second time."""
        if not self.is_open:
            return
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.flush()
            self._draft.publish()
        except OSError as error:
            raise output_error(self.path, error) from error
        finally:
            self.discard()

    def discard(self) -> None:
        """Leave nothing behind."""
        with suppress(OSError):  # on a full disk, what is still buffered has no place
            self._file.close()
        self._draft.discard()

    def _id(self, channel: Channel) -> int:
        schema, schema_id = channel.schema, 0
        if schema is not None and (schema_id := self._schemas.get(schema, 0)) == 0:
            schema_id = self._writer.register_schema(schema.name, schema.encoding, schema.data)
            self._schemas[schema] = schema_id
        metadata = dict(channel.metadata)
        key = (channel.topic, channel.encoding, schema_id, *sorted(metadata.items()))
        if key not in self._channels:
            if len(self._channels) == _MAX_CHANNELS:
                raise LogError(f"{self.path}: more than {_MAX_CHANNELS} channels")
            self._channels[key] = self._writer.register_channel(channel.topic, channel.encoding, schema_id, metadata)
        return self._channels[key]


class Encoded(NamedTuple):
    """One message as a container of bytes holds it."""

    channel: Channel
    publish_ns: int
    sequence: int
    data: bytes


def encode(record: Record, stamp_ns: int, frame_number: int | None = None) -> Encoded:
    """Encode a record: equal ones give equal bytes."""
    channel = Channel(record.topic, "protobuf", _schema(cast(Hashable, type(record.proto))), record.metadata)
    return Encoded(channel, stamp_ns, frame_number or 0, record.proto.SerializeToString(deterministic=True))


@cache
def _schema(kind: type[Proto]) -> Schema:
    return Schema(kind.DESCRIPTOR.full_name, "protobuf", descriptor_set(kind))


class McapWriter:
    """Writes one log; nothing appears under its name before it is closed without an error.

    The same messages in the same order give the same bytes. An existing file is replaced. Truth has one stamp each: 3D
    and 2D boxes of one instant belong into one `Truth`. Raises ConfigError where the file can't be written, or the
    compression isn't zstd, lz4 or none. Raises LogError where the metadata aren't Unicode.
    """

    def __init__(
        self, path: Path, info: LogInfo, rig: Rig, compression: str = "zstd", chunk_size: int = CHUNK_SIZE
    ) -> None:
        self.path, self._rig = path, rig
        self._raw = RawMcapWriter(path, header_of(info, rig), compression, chunk_size)
        self._topics: dict[str, str] = {}
        self._rig_written = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self._raw.discard()

    def write(self, message: Message | Truth) -> None:
        """Append one message, or the truth of one stamp; in any order, though readers like the order of `log_ns`.
        Raises LogError where a stamp, frame number, size or text can't be stored.
        """
        where = check_storable(self.path, message)
        try:
            if not self._rig_written:
                # Viewers need transforms and calibrations by the time of the first message.
                self._write_rig(message.stamp_ns, message.log_ns)
            self._add(message_records(message), message.log_ns, message.stamp_ns, message.frame_number)
        except ValueError as error:
            raise LogError(f"{where} can't be stored ({error})") from error

    def write_rig(self, log_ns: int, rig: Rig) -> None:
        """From `log_ns` on another rig holds; write it before the messages that it holds for. Raises LogError where the
        rig can't be stored.
        """
        self._rig = rig
        try:
            self._write_rig(log_ns, log_ns)
        except ValueError as error:
            raise LogError(f"{self.path}: the rig at {log_ns} can't be stored ({error})") from error

    def close(self) -> None:
        """Finish the file and give it its name; does nothing the second time."""
        if not self._raw.is_open:
            return
        try:
            if not self._rig_written:
                self._write_rig(0, 0)
            self._raw.close()
        except ValueError as error:
            raise LogError(f"{self.path}: the rig can't be stored ({error})") from error
        finally:
            self._raw.discard()

    def _write_rig(self, stamp_ns: int, log_ns: int) -> None:
        self._add(rig_records(stamp_ns, self._rig), log_ns, stamp_ns)
        self._rig_written = True

    def _add(self, records: Iterable[Record], log_ns: int, stamp_ns: int, frame_number: int | None = None) -> None:
        encoded: list[Encoded] = []  # All, before the first is written: a message goes in whole or not at all
        for record in records:
            name = record.proto.DESCRIPTOR.full_name
            known = self._topics.setdefault(record.topic, name)
            if known != name:
                raise LogError(f"{self.path}: topic '{record.topic}' can't hold {known} and {name}")
            encoded.append(encode(record, stamp_ns, frame_number))
        for channel, publish_ns, sequence, data in encoded:
            self._raw.add(channel, log_ns, publish_ns, sequence, data)
