"""Items of a log, as they are or as fbench understands them."""

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import groupby

from fbench.replay.contracts.errors import DataError, DecodeError, LogError
from fbench.replay.data.messages import Image, Message
from fbench.replay.data.rig import RigChange
from fbench.replay.logs.codecs.codec import MESSAGES, Origin, TruthPart
from fbench.replay.logs.codecs.foxglove.topics import BOXES2D, BOXES3D
from fbench.replay.logs.codecs.video.stream import VideoLead
from fbench.replay.logs.container import Channel, Container, Entry
from fbench.replay.logs.containers.mcap.write import Encoded
from fbench.replay.logs.containers.parquet.folder import ParquetFolder
from fbench.replay.logs.convert.sinks import Copied, Decoded, Item, RigAt, encode_message, encode_rig
from fbench.replay.logs.convert.source import Source, Window, cut, cut_rigs
from fbench.replay.logs.reader import Event, LogReader
from fbench.replay.logs.rig import RigState
from fbench.replay.logs.roles import STORED, Role

_MAX_RIGS = 1000  # Rigs that change all the time stay messages, which are streamed


class _Leads:
    """Pictures of videos before a window, without which those in it can't be decoded."""

    def __init__(self) -> None:
        self._leads: dict[str, VideoLead[Decoded]] = {}

    def add(self, entry: Entry, content: Event) -> None:
        """Take what lies before the window."""
        if isinstance(content, Image) and content.video is not None:
            item = Decoded(entry.topic, entry.log_ns, content)
            self._leads.setdefault(entry.topic, VideoLead()).add(item, content)

    def take(self, entry: Entry, content: Event) -> list[Decoded]:
        """Hand over what is needed in canonical order, where the window begins with this entry."""
        if isinstance(content, Image) and content.video is not None and content.video.is_start:
            self._leads.pop(entry.topic, None)
        early = [item for lead in self._leads.values() for item in lead.items]
        self._leads = {}
        return sorted(early, key=lambda item: (item.log_ns, item.topic))  # stable


def decode(reader: LogReader, window: Window, left_out: Counter[str]) -> Iterator[Item]:
    """Yield measurements, poses, truth and rigs in canonical order, from one pass over the log. Damaged messages are
    counted as faults; what else there is gets counted in `left_out`, by topic.
    """
    waiting: RigAt | None = RigAt(0, reader.rig)
    leads = _Leads()
    for entry, content in reader.everything():
        if window.is_behind(entry.log_ns):
            break
        if isinstance(content, RigChange):
            early = window.is_before(content.log_ns) or waiting is not None
            waiting = RigAt(0, content.rig) if early else RigAt(content.log_ns, content.rig, content.log_ns)
            continue
        if window.is_before(entry.log_ns):
            leads.add(entry, content)
            continue
        role, topic = reader.roles.get(entry.channel), entry.topic
        is_result = role is None or role.kind == "detections"
        # Truth that only a pose could move to the body
        in_world = isinstance(content, TruthPart) and content.truth.in_world
        if content is None or is_result or in_world:
            # Without content, it is damaged, part of the rig, or left out on purpose.
            if is_result or in_world or (role is not None and role.kind == "transform" and not role.is_static):
                left_out[topic] += 1
            continue
        if waiting is not None:
            yield waiting
            waiting = None
            yield from leads.take(entry, content)
        if isinstance(content, TruthPart):  # comes under the names that fbench gives it, measurements keep theirs
            topic = BOXES2D if content.is_2d else BOXES3D
        yield Decoded(topic, entry.log_ns, content)
    if waiting is not None:
        window.require_all()
        yield waiting


class InexactError(Exception):
    """A message that would change on the way: its channel must be copied as it is."""

    def __init__(self, channel: int) -> None:
        super().__init__(channel)
        self.channel = channel


def own_channels(container: Container, roles: Mapping[int, Role]) -> frozenset[int]:
    """Channels that fbench seems to have written."""
    return frozenset(
        id_
        for id_, role in roles.items()
        if role.is_own and role.kind in (*MESSAGES, "truth") and container.channels[id_].encoding != STORED
    )


def _decode_exactly(role: Role, channel: Channel, entry: Entry) -> Message | TruthPart:
    """Decode a message of a channel that fbench wrote. Raises InexactError where it isn't what fbench would write
    today.
    """
    if role.codec is None or not isinstance(entry.data, memoryview):
        raise InexactError(entry.channel)
    number = entry.sequence if role.numbered else None
    origin = Origin(role.sensor, entry.log_ns, entry.publish_ns, number, role.size_wh)
    try:
        content: Message | TruthPart = (
            role.codec.truth(entry.data, origin)
            if role.kind == "truth"
            else role.codec.message(role.kind, entry.data, origin)
        )
        encoded = encode_message(channel.topic, content)
    except (DecodeError, DataError, ValueError) as error:
        raise InexactError(entry.channel) from error
    if not _is_same(encoded, channel, entry):
        raise InexactError(entry.channel)
    return content


def _is_same(encoded: Encoded, channel: Channel, entry: Entry) -> bool:
    """Tell whether a message of a container is what was encoded, in every byte."""
    head = encoded.channel == channel and (encoded.publish_ns, encoded.sequence) == (entry.publish_ns, entry.sequence)
    return head and isinstance(entry.data, memoryview) and bytes(entry.data) == encoded.data


def _read_rigs(container: Container, roles: Mapping[int, Role], channels: frozenset[int]) -> list[RigAt]:
    """Rigs that the messages of an fbench log tell; none where encoding them again would give other messages."""
    state = RigState(container, roles)
    rigs: list[RigAt] = []
    for log_ns, group in groupby(container.entries(channels), key=lambda entry: entry.log_ns):
        entries = list(group)
        for entry in entries:
            state.take(entry)
        stamp_ns = entries[0].publish_ns
        try:
            rig = state.rig()
            encoded = sorted(encode_rig(stamp_ns, rig), key=lambda message: message.channel.topic)
        except (LogError, ValueError):
            return []
        told_by = [container.channels[entry.channel] for entry in entries]
        same = len(encoded) == len(entries) and all(map(_is_same, encoded, told_by, entries))
        if not same or len(rigs) == _MAX_RIGS:
            return []
        rigs.append(RigAt(log_ns, rig, stamp_ns))
    return rigs


class Copying:
    """All wanted items in canonical order. `as_columns` are the channels whose messages are decoded, where that loses
    nothing; then the rig becomes data too.
    """

    def __init__(self, source: Source, as_columns: frozenset[int]) -> None:
        self._source, self._as_columns = source, as_columns
        self._channels = source.channels
        container, roles = source.container, source.reader.roles
        stamps = container.rig_stamps if isinstance(container, ParquetFolder) else [None] * len(container.rigs)
        rigs = [RigAt(log_ns, rig, stamp) for (log_ns, rig), stamp in zip(container.rigs, stamps, strict=True)]
        if as_columns and not rigs:
            channels = frozenset(id_ for id_, role in roles.items() if role.kind in ("transform", "calibration"))
            if all(roles[id_].is_own for id_ in channels):
                rigs = _read_rigs(container, roles, channels)
            self._channels -= channels if rigs else frozenset()
        self.rigs = [rig._replace(rig=rig.rig.without(source.gone)) for rig in cut_rigs(rigs, source.window)]

    def items(self) -> Iterator[Item]:
        """Read the log once, each rig before the messages that it holds for. Raises InexactError where a channel can't
        become columns.
        """
        source, waiting = self._source, list(self.rigs)
        for entry in cut(source.entries(self._channels), source.window, source.reader.roles):
            item = self._convert(entry)
            while item is not None and waiting and waiting[0].log_ns <= entry.log_ns:
                yield waiting.pop(0)
            if item is not None:
                yield item
        yield from waiting

    def _convert(self, entry: Entry) -> Copied | Decoded | None:
        """`None` for what a container holds in columns that don't fit together, which is counted."""
        container = self._source.container
        channel = container.channels[entry.channel]
        if entry.channel in self._as_columns:
            role = self._source.reader.roles[entry.channel]
            return Decoded(entry.topic, entry.log_ns, _decode_exactly(role, channel, entry))
        if isinstance(entry.data, memoryview):
            return Copied(channel, entry)
        try:
            return Decoded(entry.topic, entry.log_ns, entry.data.read())
        except (DecodeError, DataError) as error:
            where = f"{entry.topic} at {entry.publish_ns}: {error}"
            container.once("DEC001", (entry.part, entry.block, entry.offset), where)
            return None
