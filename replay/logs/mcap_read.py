"""Reading MCAP logs as messages, truth and rig."""

from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cached_property
from hashlib import blake2b
from pathlib import Path

from fbench.replay.data import LogInfo, Message, Rig, Truth
from fbench.replay.errors import DataError, DecodeError
from fbench.replay.faults import FaultLog
from fbench.replay.logs import header
from fbench.replay.logs.channels import Role, roles
from fbench.replay.logs.foxglove import (
    Origin,
    read_cloud,
    read_compressed_image,
    read_pose,
    read_radar,
    read_raw_image,
)  # fmt: skip
from fbench.replay.logs.header import LogHeader
from fbench.replay.logs.mcap_file import McapFile
from fbench.replay.logs.mcap_merge import Entry
from fbench.replay.logs.mcap_rig import read_rig
from fbench.replay.logs.proto import MAX_STAMP_NS
from fbench.replay.logs.truth_stream import TruthPart, joined, read_part

_MESSAGES = ("camera", "lidar", "radar", "pose")


class McapReader:
    """One MCAP log; implements `fbench.replay.protocols.Reader`.

    Holds only chunks that overlap in time. Faults are counted once, however many passes are made.
    """

    def __init__(self, path: Path, faults: FaultLog) -> None:
        self._file = McapFile(path, faults)
        self._roles = roles(self._file)
        self._header = self._read_header()

    @cached_property
    def info(self) -> LogInfo:
        """Name, id and metadata; a log without an id gets one from its topics, schemas and first messages."""
        log_id = self._digest() if self._header is None else self._header.log_id
        metadata = {} if self._header is None else self._header.metadata
        return LogInfo(self._file.path.stem, log_id, metadata)

    @cached_property
    def rig(self) -> Rig:
        """Sensors and their calibration.

        Raises:
            LogError: naming the sensor that has no transform, or the camera that isn't calibrated.
        """
        return read_rig(self._file, self._roles, self._header)

    @cached_property
    def num_messages(self) -> Mapping[str, int]:
        """Messages of each sensor and stream of poses, by name, as the index says."""
        counts: Counter[str] = Counter()
        for id_, role in sorted(self._roles.items()):
            if role.kind in _MESSAGES:
                counts[role.sensor] += self._file.index.counts.get(id_, 0)
        return counts

    @cached_property
    def poses(self) -> tuple[str, ...]:
        """Names of the streams of poses."""
        return tuple(sorted({role.sensor for role in self._roles.values() if role.kind == "pose"}))

    def messages(self) -> Iterator[Message]:
        """All measurements and poses in canonical order."""
        for entry in self._file.entries(self._channels(*_MESSAGES)):
            message = self._decoded(entry)
            if message is not None:
                yield message

    def truths(self) -> Iterator[Truth]:
        """Ground truth, 3D and 2D of one stamp together, in the order of stamps; see `joined`."""
        return joined(part for entry in self._file.entries(self._channels("truth")) for part in self._part(entry))

    def _channels(self, *kinds: str) -> frozenset[int]:
        return frozenset(id_ for id_, role in self._roles.items() if role.kind in kinds)

    def _decoded(self, entry: Entry) -> Message | None:
        role = self._roles[entry.channel]
        number = entry.sequence if role.numbered else None
        origin = Origin(role.sensor, entry.log_ns, entry.publish_ns, number, role.size_wh)
        try:
            _check(entry)
            return _decode(role, bytes(entry.data), origin)
        except (DecodeError, DataError) as error:
            self._count(entry, error)
            return None

    def _part(self, entry: Entry) -> Iterator[TruthPart]:
        number = entry.sequence if self._roles[entry.channel].numbered else None
        try:
            _check(entry)
            yield read_part(entry.topic, bytes(entry.data), entry.publish_ns, entry.log_ns, number)
        except DecodeError as error:
            self._count(entry, error)

    def _count(self, entry: Entry, error: Exception) -> None:
        self._file.once("DEC001", (entry.block, entry.offset), f"{entry.topic} at {entry.publish_ns}: {error}")

    def _read_header(self) -> LogHeader | None:
        record = self._file.index.metadata.get(header.NAME)
        if record is None:
            return None
        try:
            return header.read_header(record.metadata)
        except DecodeError as error:
            self._file.once("LOG004", (0,), f"metadata record '{header.NAME}': {error}")
            return None

    def _digest(self) -> str:
        """Digest of all topics with their schemas and first messages, whatever the ids of their channels."""
        digest = blake2b(digest_size=16)
        channels = self._file.index.channels
        topics = sorted({channel.topic for channel in channels.values()})
        for topic in topics:
            ids = frozenset(id_ for id_, channel in channels.items() if channel.topic == topic)
            schema = self._file.schema(min(ids))
            entry = self._file.first(ids)
            parts = [topic.encode()]
            parts += [] if schema is None else [schema.name.encode(), schema.data]
            parts += [] if entry is None else [entry.log_ns.to_bytes(8, "little"), bytes(entry.data)]
            for part in parts:
                digest.update(len(part).to_bytes(8, "little") + part)
        return digest.hexdigest()


def _check(entry: Entry) -> None:
    if max(entry.log_ns, entry.publish_ns) > MAX_STAMP_NS:
        raise DecodeError("stamp doesn't fit an int64")


def _decode(role: Role, data: bytes, origin: Origin) -> Message:
    if role.schema == "foxglove.RawImage":
        return read_raw_image(data, origin)
    match role.kind:
        case "camera":
            return read_compressed_image(data, origin)
        case "lidar":
            return read_cloud(data, origin)
        case "radar":
            return read_radar(data, origin)
        case _:
            return read_pose(data, origin)
