"""Messages that rosbag2 compressed one by one."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import zstandard

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Int64
from fbench.replay.data.rig import Rig
from fbench.replay.logs.container import Channel, Container, Entry, LogHeader
from fbench.replay.logs.containers.limits import entries_from
from fbench.replay.logs.containers.mcap.records import MAX_RECORD, RecordError

_PIECE = 1024 * 1024
_MAX_WINDOW = 128 * 1024 * 1024


def check_format(path: Path, compression: str) -> None:
    """Refuse a compression of messages that can't be undone. Raises LogError naming file and compression."""
    if compression not in ("", "zstd"):
        raise LogError(f"{path}: unknown message compression '{compression}'; fbench reads zstd and none", "LOG007")


def unpack_message(data: memoryview, limit: int = MAX_RECORD) -> memoryview:
    """Decompress a message; never allocates much more than `limit`.

    Raises RecordError where it is damaged or larger.
    """
    try:
        size = zstandard.frame_content_size(data)
        if size > limit:
            raise RecordError(f"message has {size} unpacked bytes, more than the limit of {limit}")
        if size >= 0:
            return memoryview(zstandard.ZstdDecompressor().decompress(data))
        return _unpack_unknown(data, limit)
    except (zstandard.ZstdError, MemoryError) as error:
        raise RecordError(f"zstd data are damaged ({error})") from error


def _unpack_unknown(data: memoryview, limit: int) -> memoryview:
    """Decompress a message that doesn't tell its size."""
    buffer = bytearray()
    with zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW).stream_reader(data) as reader:
        while piece := reader.read(_PIECE):
            if len(buffer) + len(piece) > limit:
                raise RecordError(f"message has more than {limit} unpacked bytes")
            buffer += piece
    return memoryview(buffer)


class UnpackedMessages:
    """A container whose messages were compressed one by one with zstd; damaged ones are skipped and counted."""

    def __init__(self, packed: Container) -> None:
        self._packed = packed

    @property
    def path(self) -> Path:
        """What was opened."""
        return self._packed.path

    @property
    def channels(self) -> Mapping[int, Channel]:
        """All channels by id."""
        return self._packed.channels

    @property
    def counts(self) -> Mapping[int, int]:
        """Messages of each channel, by its id."""
        return self._packed.counts

    @property
    def header(self) -> LogHeader | None:
        """What fbench wrote about the log."""
        return self._packed.header

    @property
    def rigs(self) -> Sequence[tuple[int, Rig]]:
        """Rigs and the `log_ns` from which each holds."""
        return self._packed.rigs

    def entries(self, channels: frozenset[int]) -> Iterator[Entry]:
        """All messages of these channels in canonical order, unpacked."""
        return self._unpack(self._packed.entries(channels))

    def entries_from(self, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
        """All messages of these channels from a log time on, unpacked."""
        return self._unpack(entries_from(self._packed, channels, start_ns))

    def _unpack(self, entries: Iterator[Entry]) -> Iterator[Entry]:
        for entry in entries:
            try:
                unpacked = entry._replace(data=_unpacked(entry))
            except RecordError as error:
                where = f"'{entry.topic}' at {entry.log_ns}: {error}"
                self.once("LOG004", (entry.part, entry.block, entry.offset), where)
            else:
                yield unpacked

    def log_times(self) -> Mapping[int, Int64] | None:
        """`log_ns` of each channel's messages, ascending."""
        return self._packed.log_times()

    def verify(self) -> None:
        """Check the container of the packed messages."""
        self._packed.verify()

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""
        self._packed.once(code, key, where)


def _unpacked(entry: Entry) -> memoryview:
    if not isinstance(entry.data, memoryview):
        raise RecordError("message isn't stored as bytes")
    return unpack_message(entry.data)
