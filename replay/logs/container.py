"""The interface of containers: channels, the log's header, and messages in canonical order.

MCAP protects no metadata record by a checksum, so the record carries its own.
"""

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.arrays import Int64
from fbench.replay.data.messages import Message
from fbench.replay.data.rig import KINDS, Kind, LogInfo, Rig
from fbench.replay.logs.codecs.codec import TruthPart

NAME = "fbench"
_ID, _DIGEST, _METADATA, _SENSOR = "log_id", "digest", "metadata.", "sensor."

LOG_JSON = "log.json"  # By which a folder is a Parquet log


@dataclass(frozen=True)
class LogHeader:
    """What an fbench log says about itself."""

    log_id: str
    metadata: Mapping[str, str] = field(default_factory=dict)
    kinds: Mapping[str, Kind] = field(default_factory=dict)  # Of the sensors of the rig, by name


def header_of(info: LogInfo, rig: Rig) -> LogHeader:
    """Return what a log with this rig says about itself."""
    return LogHeader(info.log_id, info.metadata, rig.kinds)


def header_record(about: LogHeader) -> dict[str, str]:
    """Return the content of the record: equal logs give equal records."""
    items = {_ID: about.log_id}
    items |= {_METADATA + key: value for key, value in sorted(about.metadata.items())}
    items |= {_SENSOR + name: kind for name, kind in sorted(about.kinds.items())}
    return {**items, _DIGEST: _digest(items)}


def read_header(record: Mapping[str, str]) -> LogHeader:
    """Read what `header_record` made. Raises DecodeError where the record was changed."""
    items = {key: value for key, value in record.items() if key != _DIGEST}
    if record.get(_DIGEST) != _digest(items) or _ID not in items:
        raise DecodeError("its digest doesn't match")
    metadata = {key.removeprefix(_METADATA): text for key, text in items.items() if key.startswith(_METADATA)}
    sensors = {key.removeprefix(_SENSOR): kind for key, kind in items.items() if key.startswith(_SENSOR)}
    return LogHeader(items[_ID], metadata, {name: KINDS[kind] for name, kind in sensors.items() if kind in KINDS})


def _digest(items: Mapping[str, str]) -> str:
    digest = blake2b(digest_size=16)
    for text in (text for item in sorted(items.items()) for text in item):
        data = text.encode(errors="surrogateescape")
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()


@dataclass(frozen=True)
class Schema:
    """The definition of a message type, as the container stores it."""

    name: str
    encoding: str  # `protobuf`, `ros2msg`, `ros1msg`, `ros2idl` ...; empty: the definition isn't there
    data: bytes


@dataclass(frozen=True)
class Channel:
    """A stream of messages of one type on one topic."""

    topic: str
    encoding: str  # Of the messages: `protobuf`, `cdr`, `ros1`; `fbench` where the container gives decoded ones
    schema: Schema | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def schema_name(self) -> str:
        """Name of the schema, empty where there is none."""
        return "" if self.schema is None else self.schema.name


class Stored(Protocol):
    """A message that a container holds in fbench's own columns."""

    def read(self) -> Message | TruthPart:
        """Return the message. Raises DecodeError where its columns don't fit together."""


class Entry(NamedTuple):
    """One message of a container; sorts canonically: (`log_ns`, topic, position in the topic's stream)."""

    log_ns: int
    topic: str
    part: int
    """Number of the file in a log of several, position of its block in the file, and its own in the block: together
    its position."""
    block: int
    offset: int
    channel: int
    sequence: int
    publish_ns: int
    data: memoryview | Stored


class Container(Protocol):
    """One file, folder or set of files that holds a log; faults of the data are counted once each. Files are opened
    when entries are read and closed afterwards.
    """

    @property
    def path(self) -> Path:
        """What was opened."""

    @property
    def channels(self) -> Mapping[int, Channel]:
        """All channels by id."""

    @property
    def counts(self) -> Mapping[int, int]:
        """Messages of each channel, by its id."""

    @property
    def header(self) -> LogHeader | None:
        """What fbench wrote about the log; `None` in the logs of others."""

    @property
    def keeps_checksums(self) -> bool:
        """Whether the format has checksums, so that a log without them could have had some."""

    @property
    def rigs(self) -> Sequence[tuple[int, Rig]]:
        """Rigs and the `log_ns` from which each holds, the first one first; empty where messages tell the rig."""

    def entries(self, channels: frozenset[int], start_ns: int | None = None) -> Iterator[Entry]:
        """All messages of these channels, or those from a log time on, in canonical order; what is damaged is skipped
        and counted. What lies before the time needn't be read.
        """
        ...

    def log_times(self) -> Mapping[int, Int64] | None:
        """`log_ns` of each channel's messages, ascending, from the index; `None` where all would have to be read."""

    def verify(self) -> None:
        """Check what reading messages needs no look at, such as checksums over a whole file; may read all of it."""

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""


class Spanning(Protocol):
    """A part of a log that is read at once."""

    @property
    def start_ns(self) -> int:
        """No message of it has a smaller log time."""

    @property
    def offset(self) -> int:
        """Its place among the others."""


B = TypeVar("B", bound=Spanning)


def merge_blocks(blocks: Sequence[B], load: Callable[[B], Iterable[Entry]]) -> Iterator[Entry]:
    """Yield the messages of all blocks; a block is loaded when its time comes and dropped when it is used up."""
    heap: list[tuple[Entry, Iterator[Entry]]] = []

    def pop() -> Entry:
        entry, rest = heap[0]
        if (following := next(rest, None)) is None:
            heapq.heappop(heap)
        else:
            heapq.heapreplace(heap, (following, rest))
        return entry

    for block in sorted(blocks, key=lambda b: (b.start_ns, b.offset)):
        while heap and heap[0][0].log_ns < block.start_ns:
            yield pop()
        entries = iter(load(block))
        if (first := next(entries, None)) is not None:
            heapq.heappush(heap, (first, entries))
    while heap:
        yield pop()
