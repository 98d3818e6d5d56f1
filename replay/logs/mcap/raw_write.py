"""Writing MCAP files message by message, whatever their encoding: chunked, checksummed and indexed."""

import os
from contextlib import suppress
from pathlib import Path

from mcap.writer import CompressionType, Writer

from fbench.replay.errors import ConfigError, LogError
from fbench.replay.logs import header
from fbench.replay.logs.container import Channel
from fbench.replay.logs.header import LogHeader

COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
_MAX_CHANNELS = 2**16 - 1


class RawMcapWriter:
    """Writes one file; nothing appears under its name before it is closed without an error.

    The same messages in the same order give the same bytes. An existing file is replaced.

    Raises:
        ConfigError: where the file can't be written, or the compression isn't zstd, lz4 or none.
        LogError: where the metadata aren't Unicode.
    """

    def __init__(
        self,
        path: Path,
        about: LogHeader,
        compression: str = "zstd",
        chunk_size: int = 1024 * 1024,
        is_chunked: bool = True,
    ) -> None:
        if compression not in COMPRESSIONS:
            raise ConfigError(f"compression '{compression}': choose one of {', '.join(COMPRESSIONS)}")
        self.path = path
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[tuple[object, ...], int] = {}
        self._partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
        try:
            self._file = self._partial.open("wb")
        except OSError as error:
            raise ConfigError(f"{path}: can't be written ({error.strerror})") from error
        self._writer = Writer(
            self._file, chunk_size=chunk_size, compression=COMPRESSIONS[compression], use_chunking=is_chunked,
            enable_data_crcs=True,
        )  # fmt: skip
        self._start(about)

    @property
    def is_open(self) -> bool:
        """Whether messages can be added."""
        return not self._file.closed

    @property
    def num_bytes(self) -> int:
        """Bytes written to the file so far, without the chunk that is being filled."""
        return self._file.tell()

    def add(self, channel: Channel, log_ns: int, publish_ns: int, sequence: int, data: bytes | memoryview) -> None:
        """Append one message.

        Raises:
            ConfigError: where the disk is full.
            LogError: where the file has too many channels.
        """
        try:
            self._writer.add_message(self._id(channel), log_ns, bytes(data), publish_ns, sequence)
        except OSError as error:
            raise ConfigError(f"{self.path}: can't be written ({error.strerror})") from error

    def close(self) -> None:
        """Finish the file and give it its name; does nothing the second time."""
        if not self.is_open:
            return
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.flush()
            os.fsync(self._file.fileno())
            self._partial.replace(self.path)
        except OSError as error:
            raise ConfigError(f"{self.path}: can't be written ({error.strerror})") from error
        finally:
            self.discard()

    def discard(self) -> None:
        """Leave nothing behind."""
        with suppress(OSError):  # on a full disk, what is still buffered has no place
            self._file.close()
        self._partial.unlink(missing_ok=True)

    def _start(self, about: LogHeader) -> None:
        try:
            self._writer.start(profile="", library="fbench")
            self._writer.add_metadata(header.NAME, header.header_record(about))
        except ValueError as error:
            self.discard()
            raise LogError(f"{self.path}: metadata can't be stored ({error})") from error

    def _id(self, channel: Channel) -> int:
        schema_id = self._schema_id(channel)
        metadata = dict(channel.metadata)
        key = (
            channel.topic,
            channel.encoding,
            schema_id,
            *(text for item in sorted(metadata.items()) for text in item),
        )
        if key not in self._channels:
            if len(self._channels) == _MAX_CHANNELS:
                raise LogError(f"{self.path}: more than {_MAX_CHANNELS} channels")
            id_ = self._writer.register_channel(channel.topic, channel.encoding, schema_id, metadata)
            self._channels[key] = id_
        return self._channels[key]

    def _schema_id(self, channel: Channel) -> int:
        schema = channel.schema
        if schema is None:
            return 0
        key = (schema.name, schema.encoding, schema.data)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(*key)
        return self._schemas[key]
