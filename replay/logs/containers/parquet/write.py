"""Writing of Parquet logs: a folder with one file a stream, and `log.json` with checksums of all."""

import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import pyarrow as pa

from fbench.replay.contracts.errors import ConfigError, DataError, LogError
from fbench.replay.data.files import swap, sync
from fbench.replay.data.messages import Message, Truth
from fbench.replay.data.rig import Kind, LogInfo, Rig
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.container import Channel, Entry
from fbench.replay.logs.containers.parquet import log_json
from fbench.replay.logs.containers.parquet.columns import StreamKind, default_topic, file_name
from fbench.replay.logs.containers.parquet.footer import reason_of
from fbench.replay.logs.containers.parquet.log_json import ChannelEntry, LogJson, RigEntry, StreamEntry
from fbench.replay.logs.containers.parquet.stream_write import (
    Encoded,
    StreamWriter,
    message_kind,
    message_row,
    part_kind,
    part_row,
    raw_row,
)


def require_replaceable(path: Path) -> None:
    """Let only a Parquet log be replaced. Raises ConfigError where there is something else."""
    if path.is_symlink() or (path.exists() and not _is_log(path)):
        raise ConfigError(f"{path}: exists and isn't a Parquet log, so it isn't replaced; choose another name")


def _is_log(path: Path) -> bool:
    if not (path / log_json.NAME).is_file():
        return False
    return all(file.name == log_json.NAME or file.suffix == ".parquet" for file in path.iterdir())


COMPRESSIONS = ("zstd", "snappy", "none")
GROUP_SIZE = 8 * 1024 * 1024  # Row groups are closed when they hold so much [byte] ...
_MAX_GROUP_SIZE = 64 * 1024 * 1024  # ... and where their number of rows is given, at the latest at this.
_MAX_PENDING = 128 * 1024 * 1024  # All streams together gather no more [byte]
MAX_MESSAGE = 112 * 1024 * 1024  # Readers unpack a row group within 256 MiB, pages and values together [byte]
_MAX_STAMP_NS = 2**63 - 1
_MAX_FRAME_NUMBER = 2**32 - 1


class _Place(NamedTuple):
    """What has a file of its own."""

    kind: StreamKind
    sensor: str
    topic: str
    channel: tuple[object, ...] = ()  # All that its program said about it


class ParquetWriter:
    """Writes one log; nothing appears under its name before it is closed without an error.

    The same messages in the same order give the same bytes with the same version of pyarrow. A log that is there
    already is replaced, anything else isn't. `rig` is `None` where messages tell the rig; `kinds` are then those of the
    sensors, also of silent ones. Raises ConfigError where the folder can't be written, or the compression isn't zstd,
    snappy or none.
    """

    def __init__(
        self,
        path: Path,
        info: LogInfo,
        rig: Rig | None,
        compression: str = "zstd",
        rows_per_group: int | None = None,
        kinds: Mapping[str, Kind] | None = None,
    ) -> None:
        if compression not in COMPRESSIONS:
            raise ConfigError(f"compression '{compression}': choose one of {', '.join(COMPRESSIONS)}")
        if rows_per_group is not None and rows_per_group < 1:
            raise ConfigError(f"rows_per_group {rows_per_group}: must be at least 1")
        self.path = path
        self._info, self._compression, self._rows_per_group = info, compression, rows_per_group
        self._rigs: list[tuple[int, Rig, int | None]] = [] if rig is None else [(0, rig, None)]
        self._kinds = dict(sorted((kinds or {}).items()))
        self._writers: dict[_Place, StreamWriter] = {}
        self._entries: dict[_Place, StreamEntry] = {}
        self._num_messages = self._pending_size = 0
        self._partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
        self._is_open = True
        require_replaceable(path)
        try:
            self._partial.mkdir()
        except OSError as error:
            raise ConfigError(f"{path}: can't be written ({error.strerror})") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def write(self, message: Message | Truth, topic: str | None = None) -> None:
        """Append one message, or the truth of one stamp; in any order, though readers like the order of `log_ns`.

        `topic` is where it came from, if that isn't the one that fbench names after the sensor. Raises LogError where a
        stamp, frame number or text can't be stored, or the message is too large.
        """
        if isinstance(message, Truth):
            self._write_truth(message)
            return
        kind, sensor = message_kind(message), message.sensor
        where = self._check(message)
        topic = default_topic(kind, sensor) if topic is None else topic
        self._add(_Place(kind, sensor, topic), where, lambda n: message_row(message, n))

    def write_part(self, part: TruthPart, topic: str | None = None) -> None:
        """Append 3D or 2D truth as one message, as the log had it. Raises LogError as for messages."""
        kind = part_kind(part)
        where = self._check(part.truth)
        topic = default_topic(kind, "") if topic is None else topic
        self._add(_Place(kind, "", topic), where, lambda n: part_row(part, n))

    def write_raw(self, channel: Channel, entry: Entry) -> None:
        """Append a message of another program as it is. Raises LogError where a text of its channel isn't Unicode, or
        it is too large.
        """
        where = f"{self.path}: {channel.topic} at {entry.log_ns}"
        schema = () if channel.schema is None else tuple(vars(channel.schema).values())
        key = (channel.topic, channel.encoding, schema, *sorted(channel.metadata.items()))
        self._add(_Place("raw", "", channel.topic, key), where, lambda n: raw_row(entry, n), channel)

    def write_rig(self, log_ns: int, rig: Rig, stamp_ns: int | None = None) -> None:
        """Say that `rig` holds from `log_ns` on; `stamp_ns` is that of the messages that told it."""
        self._rigs.append((log_ns, rig, stamp_ns))

    def close(self) -> None:
        """Finish the log and give it its name; does nothing the second time."""
        if not self._is_open:
            return
        try:
            (self._partial / log_json.NAME).write_bytes(self._description())
            sync(self._partial / log_json.NAME)
            sync(self._partial)
            swap(self._partial, self.path)
        except ValueError as error:
            raise LogError(f"{self.path}: its description can't be stored ({reason_of(error)})") from error
        except (OSError, pa.ArrowException) as error:
            raise ConfigError(f"{self.path}: can't be written ({reason_of(error)})") from error
        finally:
            self.discard()

    def discard(self) -> None:
        """Leave nothing behind; does nothing after `close`."""
        self._is_open = False
        for writer in self._writers.values():
            writer.discard()
        shutil.rmtree(self._partial, ignore_errors=True)

    def _write_truth(self, truth: Truth) -> None:
        has_2d = truth.boxes2d is not None
        part3d, part2d = replace(truth, boxes2d=None), replace(truth, boxes3d=None)
        self.write_part(TruthPart(part3d, is_2d=False, expects_2d=has_2d))
        if has_2d:
            self.write_part(TruthPart(part2d, is_2d=True))

    def _check(self, message: Message | Truth) -> str:
        where = f"{self.path}: {type(message).__name__} at {message.stamp_ns}"
        limits = {"stamp_ns": _MAX_STAMP_NS, "log_ns": _MAX_STAMP_NS, "frame_number": _MAX_FRAME_NUMBER}
        for name, limit in limits.items():
            value = getattr(message, name) or 0
            if not 0 <= value <= limit:
                raise LogError(f"{where}: {name} {value} is outside 0 to {limit}")
        return where

    def _add(
        self, place: "_Place", where: str, encode: Callable[[int], Encoded], channel: Channel | None = None
    ) -> None:
        try:
            row = encode(self._num_messages)
            if row.size > MAX_MESSAGE:
                raise LogError(f"{where} has {row.size} bytes, the limit is {MAX_MESSAGE}")
            writer = self._writer(place, channel)
            if writer.pending_size + row.size > _MAX_GROUP_SIZE:
                self._flush(writer)
            writer.add(row)
            self._pending_size += row.size
            self._num_messages += 1
            self._flush_full(writer)
        except (ValueError, DataError) as error:
            raise LogError(f"{where} can't be stored ({reason_of(error)})") from error
        except (OSError, pa.ArrowException) as error:
            raise ConfigError(f"{self.path}: can't be written ({reason_of(error)})") from error

    def _flush_full(self, writer: StreamWriter) -> None:
        full = writer.pending_size >= GROUP_SIZE
        if self._rows_per_group is not None:
            full = writer.num_pending >= self._rows_per_group
        if full:
            self._flush(writer)
        while self._pending_size > _MAX_PENDING:
            self._flush(max(self._writers.values(), key=lambda w: w.pending_size))

    def _flush(self, writer: StreamWriter) -> None:
        self._pending_size -= writer.pending_size
        writer.flush()

    def _writer(self, place: "_Place", channel: Channel | None) -> StreamWriter:
        if place not in self._writers:
            name = file_name(place.topic, {entry.file.lower() for entry in self._entries.values()})
            described = None if channel is None else ChannelEntry.of(channel)
            entry = StreamEntry(file=name, kind=place.kind, sensor=place.sensor, topic=place.topic, channel=described)
            entry.model_dump_json()  # refuses what isn't Unicode
            self._writers[place] = StreamWriter(self._partial / name, place.kind, self._compression)
            self._entries[place] = entry
        return self._writers[place]

    def _description(self) -> bytes:
        streams = [self._finish(self._entries[key], writer) for key, writer in self._writers.items()]
        rigs = [RigEntry.of(*item) for item in sorted(self._rigs, key=lambda item: item[0])]
        content = LogJson(
            log_id=self._info.log_id, metadata=dict(self._info.metadata), rigs=rigs, sensors=self._kinds,
            streams=streams,
        )  # fmt: skip
        return log_json.dump(content)

    def _finish(self, entry: StreamEntry, writer: StreamWriter) -> StreamEntry:
        sums, num_rows = writer.close()
        sync(self._partial)
        ends = {"first_log_ns": min(sums.row_groups.min_log_ns), "last_log_ns": max(sums.row_groups.max_log_ns)}
        return entry.model_copy(update={"num_rows": num_rows, "checksums": sums, **ends})
