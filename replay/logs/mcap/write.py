"""Writing MCAP logs of fbench's own messages: Foxglove schemas in Protobuf."""

from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

from fbench.replay.data import LogInfo, Message, Rig, Truth
from fbench.replay.errors import LogError
from fbench.replay.logs.container import Channel, Schema
from fbench.replay.logs.foxglove.proto import MAX_STAMP_NS, descriptor_set
from fbench.replay.logs.foxglove.topics import Record, message_records, rig_records
from fbench.replay.logs.header import header_of
from fbench.replay.logs.mcap.raw_write import RawMcapWriter

_MAX_FRAME_NUMBER = 2**32 - 1


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
        self.path, self._rig = path, rig
        self._raw = RawMcapWriter(path, header_of(info, rig), compression, chunk_size)
        self._schemas: dict[str, Schema] = {}
        self._topics: dict[str, str] = {}
        self._rig_written = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self._raw.discard()

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
                self._write_rig(message.stamp_ns, message.log_ns)
            self._add(message_records(message), message.log_ns, message.stamp_ns, message.frame_number)
        except ValueError as error:
            raise LogError(f"{where} can't be stored ({error})") from error

    def write_rig(self, log_ns: int, rig: Rig) -> None:
        """From `log_ns` on another rig holds; write it before the messages that it holds for.

        Raises:
            LogError: where the rig can't be stored.
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
        # All are encoded before the first is written: a message goes in whole or not at all.
        encoded = [(self._channel(record), record.proto.SerializeToString(deterministic=True)) for record in records]
        for channel, data in encoded:
            self._raw.add(channel, log_ns, stamp_ns, frame_number or 0, data)

    def _channel(self, record: Record) -> Channel:
        name = record.proto.DESCRIPTOR.full_name
        if self._topics.setdefault(record.topic, name) != name:
            raise LogError(f"{self.path}: topic '{record.topic}' can't hold {self._topics[record.topic]} and {name}")
        if name not in self._schemas:
            self._schemas[name] = Schema(name, "protobuf", descriptor_set(type(record.proto)))
        return Channel(record.topic, "protobuf", self._schemas[name], record.metadata)


def _check(where: str, field: str, value: int, limit: int) -> None:
    if not 0 <= value <= limit:
        raise LogError(f"{where}: {field} {value} is outside 0 to {limit}")
