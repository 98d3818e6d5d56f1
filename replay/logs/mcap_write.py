"""Writing MCAP logs: Foxglove schemas in Protobuf, chunked, checksummed and indexed."""

import os
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.writer import CompressionType, Writer

from fbench.replay.data import LogInfo, Message, Rig, Truth
from fbench.replay.errors import ConfigError, LogError
from fbench.replay.logs import header
from fbench.replay.logs.proto import MAX_STAMP_NS, descriptor_set
from fbench.replay.logs.topics import Record, message_records, rig_records

COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
_MAX_FRAME_NUMBER = 2**32 - 1
_MAX_CHANNELS = 2**16 - 1


class McapWriter:
    """Writes one log; nothing appears under its name before it is closed without an error.

    The same messages in the same order give the same bytes. An existing file is replaced. Truth has one stamp each:
    3D and 2D boxes of one instant belong into one `Truth`.

    Raises:
        ConfigError: where the file can't be written, or the compression isn't zstd, lz4 or none.
        LogError: where the metadata aren't Unicode.
    """

    def __init__(
        self, path: Path, info: LogInfo, rig: Rig, compression: str = "zstd", chunk_size: int = 1024 * 1024
    ) -> None:
        if compression not in COMPRESSIONS:
            raise ConfigError(f"compression '{compression}': choose one of {', '.join(COMPRESSIONS)}")
        self.path, self._rig = path, rig
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, ...], int] = {}
        self._topics: dict[str, str] = {}
        self._rig_written = False
        self._partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
        try:
            self._file = self._partial.open("wb")
        except OSError as error:
            raise ConfigError(f"{path}: can't be written ({error.strerror})") from error
        self._writer = Writer(
            self._file, chunk_size=chunk_size, compression=COMPRESSIONS[compression], enable_data_crcs=True
        )
        self._start(info)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self._discard()

    def write(self, message: Message | Truth) -> None:
        """Append one message, or the truth of one stamp; in any order, though readers like the order of `log_ns`.

        Raises:
            LogError: where a stamp, frame number, size or text can't be stored.
        """
        where = f"{self.path}: {type(message).__name__} at {message.stamp_ns}"
        _check(where, "stamp_ns", message.stamp_ns, MAX_STAMP_NS)
        _check(where, "log_ns", message.log_ns, MAX_STAMP_NS)
        _check(where, "frame_number", message.frame_number or 0, _MAX_FRAME_NUMBER)
        try:
            if not self._rig_written:
                # Viewers need transforms and calibrations by the time of the first message.
                self._add(rig_records(message.stamp_ns, self._rig), message.log_ns, message.stamp_ns)
                self._rig_written = True
            self._add(message_records(message), message.log_ns, message.stamp_ns, message.frame_number)
        except ValueError as error:
            raise LogError(f"{where} can't be stored ({error})") from error

    def close(self) -> None:
        """Finish the file and give it its name; does nothing the second time."""
        if self._file.closed:
            return
        try:
            if not self._rig_written:
                self._add(rig_records(0, self._rig), 0, 0)
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.flush()
            os.fsync(self._file.fileno())
            self._partial.replace(self.path)
        except ValueError as error:
            raise LogError(f"{self.path}: the rig can't be stored ({error})") from error
        except OSError as error:
            raise ConfigError(f"{self.path}: can't be written ({error.strerror})") from error
        finally:
            self._discard()

    def _start(self, info: LogInfo) -> None:
        try:
            self._writer.start(profile="", library="fbench")
            self._writer.add_metadata(header.NAME, header.header_record(info, self._rig))
        except ValueError as error:
            self._discard()
            raise LogError(f"{self.path}: metadata can't be stored ({error})") from error

    def _discard(self) -> None:
        self._file.close()
        self._partial.unlink(missing_ok=True)

    def _add(self, records: Iterable[Record], log_ns: int, stamp_ns: int, frame_number: int | None = None) -> None:
        # All are encoded before the first is written: a message goes in whole or not at all.
        encoded = [(self._channel(record), record.proto.SerializeToString(deterministic=True)) for record in records]
        for channel, data in encoded:
            self._writer.add_message(channel, log_ns, data, stamp_ns, frame_number or 0)

    def _channel(self, record: Record) -> int:
        schema = record.proto.DESCRIPTOR.full_name
        key = (record.topic, *(text for item in sorted(record.metadata.items()) for text in item))
        if key in self._channels and self._topics[record.topic] == schema:
            return self._channels[key]
        if self._topics.setdefault(record.topic, schema) != schema:
            raise LogError(f"{self.path}: topic '{record.topic}' can't hold {self._topics[record.topic]} and {schema}")
        if len(self._channels) == _MAX_CHANNELS:
            raise LogError(f"{self.path}: more than {_MAX_CHANNELS} channels")
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(schema, "protobuf", descriptor_set(type(record.proto)))
        metadata = dict(record.metadata)
        self._channels[key] = self._writer.register_channel(record.topic, "protobuf", self._schemas[schema], metadata)
        return self._channels[key]


def _check(where: str, field: str, value: int, limit: int) -> None:
    if not 0 <= value <= limit:
        raise LogError(f"{where}: {field} {value} is outside 0 to {limit}")
