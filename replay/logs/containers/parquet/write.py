"""Writing of Parquet logs: a folder with one file a stream, and `log.json` with checksums of all."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple, Self

import pyarrow as pa

from fbench.replay.contracts.errors import ConfigError, DataError, LogError, output_error
from fbench.replay.data.files import Draft, sync
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import Kind, LogInfo, Rig
from fbench.replay.logs.codecs.codec import TruthPart, split_truth
from fbench.replay.logs.container import Channel, Entry
from fbench.replay.logs.containers.limits import check_storable
from fbench.replay.logs.containers.parquet import log_json, stream_write
from fbench.replay.logs.containers.parquet.columns import StreamKind, default_topic, file_name
from fbench.replay.logs.containers.parquet.footer import reason_of
from fbench.replay.logs.containers.parquet.log_json import ChannelEntry, LogJson, RigEntry, StreamEntry
from fbench.replay.logs.containers.parquet.stream_write import StreamWriter

COMPRESSIONS = ("zstd", "snappy", "none")
GROUP_SIZE = 8 * 1024 * 1024  # Row groups are closed when they hold so much [byte] ...
_MAX_GROUP_SIZE = 64 * 1024 * 1024  # ... and where their number of rows is given, at the latest at this.
_MAX_PENDING = 128 * 1024 * 1024  # All streams together gather no more [byte]
MAX_MESSAGE = 112 * 1024 * 1024  # Readers unpack a row group within 256 MiB, pages and values together [byte]
_KINDS: Mapping[type[Message], StreamKind] = {Image: "camera", PointCloud: "lidar", RadarScan: "radar", Pose: "pose"}


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
        self._files: set[str] = set()  # Names of the files, in lower case
        self._num_messages = self._pending_size = 0
        self._is_open = True
        if path.is_symlink() or (path.exists() and not _is_log(path)):
            raise ConfigError(f"{path}: exists and isn't a Parquet log, so it isn't replaced; choose another name")
        self._draft = Draft(path, is_folder=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
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
            for part in split_truth(message):
                self.write_part(part)
            return
        where = check_storable(self.path, message)
        kind, sensor = _KINDS[type(message)], message.sensor
        place = _Place(kind, sensor, default_topic(kind, sensor) if topic is None else topic)
        self._add(place, where, lambda position: stream_write.message_row(message, position))

    def write_part(self, part: TruthPart, topic: str | None = None) -> None:
        """Append 3D or 2D truth as one message, as the log had it. Raises LogError as for messages."""
        where, kind = check_storable(self.path, part.truth), stream_write.part_kind(part)
        place = _Place(kind, "", default_topic(kind, "") if topic is None else topic)
        self._add(place, where, lambda position: stream_write.part_row(part, position))

    def write_raw(self, channel: Channel, entry: Entry) -> None:
        """Append a message of another program as it is. Raises LogError where a text of its channel isn't Unicode, or
        it is too large.
        """
        where = f"{self.path}: {channel.topic} at {entry.log_ns}"
        key = (channel.topic, channel.encoding, channel.schema, *sorted(channel.metadata.items()))
        place = _Place("raw", "", channel.topic, key)
        self._add(place, where, lambda position: stream_write.raw_row(entry, position), channel)

    def write_rig(self, log_ns: int, rig: Rig, stamp_ns: int | None = None) -> None:
        """Say that `rig` holds from `log_ns` on; `stamp_ns` is that of the messages that told it."""
        self._rigs.append((log_ns, rig, stamp_ns))

    def close(self) -> None:
        """Finish the log and give it its name; does nothing the second time."""
        if not self._is_open:
            return
        try:
            (self._draft.path / log_json.NAME).write_bytes(self._description())
            sync(self._draft.path / log_json.NAME)
            self._draft.publish()
        except ValueError as error:
            raise LogError(f"{self.path}: its description can't be stored ({reason_of(error)})") from error
        except (OSError, pa.ArrowException) as error:
            raise output_error(self.path, error) from error
        finally:
            self.discard()

    def discard(self) -> None:
        """Leave nothing behind; does nothing after `close`."""
        self._is_open = False
        for writer in self._writers.values():
            writer.discard()
        self._draft.discard()

    def _add(
        self, place: _Place, where: str, encode: Callable[[int], stream_write.RowValues], channel: Channel | None = None
    ) -> None:
        try:
            row = encode(self._num_messages)
            size = stream_write.row_size(row)
            if size > MAX_MESSAGE:
                raise LogError(f"{where} has {size} bytes, the limit is {MAX_MESSAGE}")
            writer = self._writers.get(place) or self._open_stream(place, channel)
            if writer.pending_size + size > _MAX_GROUP_SIZE:
                self._flush(writer)
            writer.add(row, size)
            self._pending_size += size
            self._num_messages += 1
            is_full = writer.pending_size >= GROUP_SIZE
            if self._rows_per_group is not None:
                is_full = writer.num_pending >= self._rows_per_group
            if is_full:
                self._flush(writer)
            while self._pending_size > _MAX_PENDING:
                self._flush(max(self._writers.values(), key=lambda w: w.pending_size))
        except (ValueError, DataError) as error:
            raise LogError(f"{where} can't be stored ({reason_of(error)})") from error
        except (OSError, pa.ArrowException) as error:
            raise output_error(self.path, error) from error

    def _flush(self, writer: StreamWriter) -> None:
        self._pending_size -= writer.pending_size
        writer.flush()

    def _open_stream(self, place: _Place, channel: Channel | None) -> StreamWriter:
        name = file_name(place.topic, self._files)
        described = None if channel is None else ChannelEntry.of(channel)
        entry = StreamEntry(file=name, kind=place.kind, sensor=place.sensor, topic=place.topic, channel=described)
        entry.model_dump_json()  # refuses what isn't Unicode
        writer = self._writers[place] = StreamWriter(self._draft.path, entry, self._compression)
        self._files.add(name.lower())
        return writer

    def _description(self) -> bytes:
        streams: list[StreamEntry] = []
        for writer in self._writers.values():
            streams.append(writer.close())
            sync(self._draft.path)
        rigs = [RigEntry.of(*item) for item in sorted(self._rigs, key=lambda item: item[0])]
        content = LogJson(
            log_id=self._info.log_id, metadata=dict(self._info.metadata), rigs=rigs, sensors=self._kinds,
            streams=streams,
        )  # fmt: skip
        return log_json.dump(content)


def _is_log(path: Path) -> bool:
    if not (path / log_json.NAME).is_file():
        return False
    return all(file.name == log_json.NAME or file.suffix == ".parquet" for file in path.iterdir())
