"""Items of a log, as they are or as fbench understands them."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby

from fbench.replay.contracts.errors import DataError, DecodeError, LogError
from fbench.replay.data.messages import Message
from fbench.replay.data.rig import RigChange
from fbench.replay.logs.codecs.codec import MESSAGES, Origin, TruthPart
from fbench.replay.logs.codecs.foxglove.topics import BOXES2D, BOXES3D
from fbench.replay.logs.container import Channel, Container, Entry, LogHeader, header_of
from fbench.replay.logs.containers.parquet.folder import ParquetFolder
from fbench.replay.logs.convert.sinks import Copied, Decoded, Encoded, Encoder, Item, RigAt, log_ns_of
from fbench.replay.logs.convert.source import Source, Window, cut, cut_rigs
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.rig import RigState
from fbench.replay.logs.roles import STORED, Role


class Decoding:
    """Measurements, poses, truth and rigs in canonical order; what else there is gets counted in `left_out`. Raises
    LogError naming the sensor that has no transform, or the camera that isn't calibrated.
    """

    def __init__(self, reader: LogReader, window: Window) -> None:
        self._reader, self._window = reader, window
        self._rig = reader.rig
        self.about: LogHeader = header_of(reader.info, reader.rig)
        self.left_out: Counter[str] = Counter()

    def items(self) -> Iterator[Item]:
        """Read the log once; damaged messages are counted as faults."""
        waiting: RigAt | None = RigAt(0, self._rig)
        for entry, content in self._reader.everything():
            if self._window.is_behind(entry.log_ns):
                break
            if isinstance(content, RigChange):
                early = self._window.is_before(content.log_ns) or waiting is not None
                waiting = RigAt(0, content.rig) if early else RigAt(content.log_ns, content.rig, content.log_ns)
            if self._window.is_before(entry.log_ns) or isinstance(content, RigChange):
                continue
            role = self._reader.roles.get(entry.channel)
            if content is None or role is None or role.kind == "detections" or _in_world(content):
                if _is_lost(role) or _in_world(content):
                    self.left_out[entry.topic] += 1
                continue
            if waiting is not None:
                yield waiting
                waiting = None
            yield Decoded(_topic(entry.topic, content), entry.log_ns, content)
        if waiting is not None:
            self._window.require_all()
            yield waiting


def _topic(topic: str, content: object) -> str:
    """Truth comes under the names that fbench gives it, measurements keep theirs."""
    if isinstance(content, TruthPart):
        return BOXES2D if content.is_2d else BOXES3D
    return topic


def _in_world(content: object) -> bool:
    """Tell whether content is truth that only a pose could move to the body."""
    return isinstance(content, TruthPart) and content.truth.in_world


def _is_lost(role: Role | None) -> bool:
    """Tell whether a message without content is left out on purpose: neither damaged nor part of the rig."""
    if role is None or role.kind == "detections":
        return True
    return role.kind == "transform" and not role.is_static


class InexactError(Exception):
    """A message that would change on the way: its channel must be copied as it is."""

    def __init__(self, channel: int) -> None:
        super().__init__(channel)
        self.channel = channel


def candidates(container: Container, roles: dict[int, Role]) -> frozenset[int]:
    """Channels that fbench seems to have written."""
    return frozenset(
        id_
        for id_, role in roles.items()
        if role.is_own and role.kind in (*MESSAGES, "truth") and container.channels[id_].encoding != STORED
    )


def exactly_decoded(role: Role, channel: Channel, entry: Entry, encoder: Encoder) -> Message | TruthPart:
    """Decode a message of a channel that fbench wrote. Raises InexactError where it isn't what fbench would write
    today.
    """
    try:
        content = _decode(role, entry)
        encoded = encoder.message(channel.topic, content)
    except (DecodeError, DataError, ValueError) as error:
        raise InexactError(entry.channel) from error
    if not is_same(encoded, channel, entry):
        raise InexactError(entry.channel)
    return content


def is_same(encoded: Encoded, channel: Channel, entry: Entry) -> bool:
    """Tell whether a message of a container is what was encoded, in every byte."""
    head = encoded.channel == channel and (encoded.publish_ns, encoded.sequence) == (entry.publish_ns, entry.sequence)
    return head and isinstance(entry.data, memoryview) and bytes(entry.data) == encoded.data


def _decode(role: Role, entry: Entry) -> Message | TruthPart:
    if role.codec is None or not isinstance(entry.data, memoryview):
        raise DecodeError("not a message of bytes")
    number = entry.sequence if role.numbered else None
    origin = Origin(role.sensor, entry.log_ns, entry.publish_ns, number, role.size_wh)
    if role.kind == "truth":
        return role.codec.truth(entry.data, origin)
    return role.codec.message(role.kind, entry.data, origin)


_KINDS = ("transform", "calibration")
_MAX_RIGS = 1000  # Rigs that change all the time stay messages, which are streamed


def rig_channels(roles: Mapping[int, Role]) -> frozenset[int]:
    """Channels that tell the rig."""
    return frozenset(id_ for id_, role in roles.items() if role.kind in _KINDS)


def stored_rigs(container: Container) -> list[RigAt]:
    """Rigs that the container holds as data."""
    stamps: Sequence[int | None] = (
        container.rig_stamps if isinstance(container, ParquetFolder) else [None] * len(container.rigs)
    )
    return [RigAt(log_ns, rig, stamp) for (log_ns, rig), stamp in zip(container.rigs, stamps, strict=True)]


def rigs_in_messages(container: Container, roles: Mapping[int, Role], encoder: Encoder) -> list[RigAt] | None:
    """Rigs that the messages of an fbench log tell; `None` where encoding them again would give other messages."""
    channels = rig_channels(roles)
    if not all(roles[id_].is_own for id_ in channels):
        return None
    state = RigState(container, roles)
    found: list[RigAt] = []
    for _, group in groupby(container.entries(channels), key=lambda entry: entry.log_ns):
        rig = _describe_rig(container, state, list(group), encoder)
        if rig is None or len(found) == _MAX_RIGS:
            return None
        found.append(rig)
    return found


def _describe_rig(container: Container, state: RigState, entries: Sequence[Entry], encoder: Encoder) -> RigAt | None:
    for entry in entries:
        state.take(entry)
    log_ns, stamp_ns = entries[0].log_ns, entries[0].publish_ns
    try:
        rig = state.rig()
        encoded = sorted(encoder.rig(stamp_ns, rig), key=lambda message: message.channel.topic)
    except (LogError, ValueError):
        return None
    channels = [container.channels[entry.channel] for entry in entries]
    same = len(encoded) == len(entries) and all(map(is_same, encoded, channels, entries))
    return RigAt(log_ns, rig, stamp_ns) if same else None


class Copying:
    """All wanted items in canonical order.

    `as_columns` are the channels whose messages are decoded, where that loses nothing; then the rig becomes data too.
    """

    def __init__(self, source: Source, as_columns: frozenset[int]) -> None:
        self._source, self._as_columns = source, as_columns
        self._encoder = Encoder()
        self._channels = source.channels
        self.rigs = stored_rigs(source.container)
        if as_columns and not self.rigs:
            told = rigs_in_messages(source.container, source.reader.roles, self._encoder)
            self.rigs = told or []
            self._channels -= rig_channels(source.reader.roles) if told else frozenset()
        self.rigs = [rig._replace(rig=rig.rig.without(source.gone)) for rig in cut_rigs(self.rigs, source.window)]

    def items(self) -> Iterator[Item]:
        """Read the log once. Raises InexactError where a channel can't become columns."""
        entries = self._source.container.entries(self._channels)
        yield from _with_rigs(self.rigs, self._convert(cut(entries, self._source.window, self._source.reader.roles)))

    def _convert(self, entries: Iterable[Entry]) -> Iterator[Copied | Decoded]:
        channels, roles = self._source.container.channels, self._source.reader.roles
        for entry in entries:
            channel = channels[entry.channel]
            if entry.channel in self._as_columns:
                content = exactly_decoded(roles[entry.channel], channel, entry, self._encoder)
                yield Decoded(entry.topic, entry.log_ns, content)
            elif isinstance(entry.data, memoryview):
                yield Copied(channel, entry)
            else:
                yield from _store(self._source.container, entry)


def _store(container: Container, entry: Entry) -> Iterator[Decoded]:
    """What a container holds in columns; what doesn't fit together is counted."""
    if isinstance(entry.data, memoryview):
        return
    try:
        yield Decoded(entry.topic, entry.log_ns, entry.data.read())
    except (DecodeError, DataError) as error:
        where = f"{entry.topic} at {entry.publish_ns}: {error}"
        container.once("DEC001", (entry.part, entry.block, entry.offset), where)


def _with_rigs(rigs: Sequence[RigAt], items: Iterable[Copied | Decoded]) -> Iterator[Item]:
    """Put each rig before the messages that it holds for."""
    waiting = list(rigs)
    for item in items:
        while waiting and waiting[0].log_ns <= log_ns_of(item):
            yield waiting.pop(0)
        yield item
    yield from waiting
