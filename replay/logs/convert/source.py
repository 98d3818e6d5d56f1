"""The part of a log that is converted: its channels by pattern and its messages by time."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, groupby, islice, takewhile

from fbench.replay.contracts.errors import ConfigError, DataError, DecodeError
from fbench.replay.data.messages import Image, Message
from fbench.replay.data.rig import LogInfo
from fbench.replay.data.video import CODECS
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.logs.codecs.codec import MESSAGES, Origin, TruthPart
from fbench.replay.logs.codecs.video.stream import VideoLead
from fbench.replay.logs.container import Container, Entry, LogHeader
from fbench.replay.logs.convert.sinks import RigAt
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.roles import Role, select

_RIG_AND_TRUTH = ("transform", "calibration", "truth")


@dataclass(frozen=True)
class Window:
    """Half-open range of `log_ns`."""

    start_ns: int | None = None
    end_ns: int | None = None

    def is_before(self, log_ns: int) -> bool:
        """Tell whether a time is before the window."""
        return self.start_ns is not None and log_ns < self.start_ns

    def is_behind(self, log_ns: int) -> bool:
        """Tell whether a time is behind the window."""
        return self.end_ns is not None and log_ns >= self.end_ns

    def require_all(self) -> None:
        """Refuse a window that turned out to be empty. Raises ConfigError where anything was cut off."""
        if self != Window():
            start = "the start" if self.start_ns is None else f"{self.start_ns}ns"
            end = "the end" if self.end_ns is None else f"{self.end_ns}ns"
            raise ConfigError(f"no message from {start} to {end}; see fbench log info for the times of the log")


def cut(entries: Iterable[Entry], window: Window, roles: Mapping[int, Role]) -> Iterator[Entry]:
    """Yield the entries of the window, before them the last transforms and calibrations that were there when it began:
    one for each coordinate frame and camera; and each video from its last keyframe on, in canonical order. Raises
    ConfigError where there are no others.
    """
    last: dict[tuple[str, str], Entry] = {}
    leads = _Leads()
    is_empty = True
    for log_ns, together in groupby(entries, key=lambda entry: entry.log_ns):
        if window.is_behind(log_ns):
            break
        others = []
        for entry in together:
            early = window.start_ns is not None and log_ns <= window.start_ns
            data = entry.data if early else None
            if isinstance(data, memoryview) and (keys := _rig_keys(roles.get(entry.channel), data)):
                last |= dict.fromkeys(keys, _copy(entry))  # its block needn't stay in memory
                continue
            others.append(entry)
            if early:
                leads.add(roles.get(entry.channel), entry)
        if window.is_before(log_ns):
            continue
        is_empty = False
        at_start = {entry[:5] for entry in others}
        before = {entry[:5]: entry for entry in last.values()}
        before |= {entry[:5]: entry for entry in leads.take() if entry[:5] not in at_start}
        last = {}
        yield from (entry for _, entry in sorted(before.items()))
        yield from others
    if is_empty:
        window.require_all()


def _copy(entry: Entry) -> Entry:
    return entry._replace(data=memoryview(bytes(entry.data))) if isinstance(entry.data, memoryview) else entry


_MOST_UNREAD = 5  # So many messages of a camera are tried before it is taken for one without video


class _Leads:
    """Entries of videos, each from its last keyframe on."""

    def __init__(self) -> None:
        self._leads: dict[str, VideoLead[Entry]] = {}
        self._others: set[int] = set()  # Channels of cameras that are no video

    def add(self, role: Role | None, entry: Entry) -> None:
        """Take the next entry of any channel."""
        if role is None or role.kind != "camera" or entry.channel in self._others:
            return
        image = _read(role, entry)
        if isinstance(image, Image) and image.encoding in CODECS:
            self._leads.setdefault(entry.topic, VideoLead()).add(_copy(entry), image)
        elif image is not None:
            self._others.add(entry.channel)

    def take(self) -> list[Entry]:
        """Hand over all that are kept."""
        found = [entry for lead in self._leads.values() for entry in lead.items]
        self._leads = {}
        return found


def _read(role: Role, entry: Entry) -> Message | TruthPart | None:
    """What a message of a camera holds; `None` where it can't be read."""
    with suppress(DecodeError, DataError):
        if not isinstance(entry.data, memoryview):
            return entry.data.read()
        if role.codec is not None:
            return role.codec.message(role.kind, entry.data, Origin("", entry.log_ns, entry.publish_ns))
    return None


def _rig_keys(role: Role | None, data: memoryview) -> list[tuple[str, str]]:
    """What a message tells of the rig, nothing where it doesn't or can't be read."""
    if role is None or role.codec is None:
        return []
    if role.kind == "calibration":
        return [(role.topic, role.sensor)]
    if role.kind != "transform" or not role.is_static:
        return []
    try:
        return [(role.topic, child) for child, _ in role.codec.transforms(data)]
    except DecodeError:
        return []


def cut_rigs(rigs: Sequence[RigAt], window: Window) -> list[RigAt]:
    """Keep the rig that is in force where the window begins, and its changes within."""
    start_ns = window.start_ns or 0
    old = [rig for rig in rigs if rig.log_ns <= start_ns][-1:] or list(rigs[:1])
    new = [rig for rig in rigs if rig.log_ns > start_ns and not window.is_behind(rig.log_ns)]
    return old + [rig for rig in new if rig not in old]


@dataclass(frozen=True)
class Source:
    """A log, opened, with the topics and the time that are wanted of it."""

    container: Container
    topics: Sequence[str] = ()  # Patterns
    excerpt: Excerpt = field(default_factory=Excerpt)  # A range of time, by `log_ns`

    @cached_property
    def reader(self) -> LogReader:
        """The whole log."""
        return LogReader(self.container)

    @cached_property
    def channels(self) -> frozenset[int]:
        """Channels that the patterns choose; transforms, calibrations of kept cameras and truth stay. Raises
        ConfigError where a pattern fits nothing.
        """
        channels = self.container.channels
        if not self.topics:
            return frozenset(channels)
        # To the patterns, a channel without meaning is a stream that is called like its topic.
        plain = {id_: Role(MESSAGES[0], channel.topic, channel.topic) for id_, channel in channels.items()}
        roles = self.reader.roles.items()
        known = {id_: role for id_, role in roles if role.kind in (*MESSAGES, *_RIG_AND_TRUTH)}
        return frozenset(select({**plain, **known}, self.topics))

    @cached_property
    def gone(self) -> frozenset[str]:
        """Sensors that aren't wanted."""
        roles = self.reader.roles
        kept = {role.sensor for id_, role in roles.items() if id_ in self.channels}
        return frozenset(role.sensor for role in roles.values()) - kept

    @cached_property
    def window(self) -> Window:
        """Time that is wanted; times that count from the log's first measurement on do from the smallest `log_ns` of a
        sensor or pose. Raises ConfigError where it is empty.
        """
        start, end = self.excerpt.start, self.excerpt.end
        if start is None and end is None:
            return Window()
        streams = frozenset(id_ for id_, role in self.reader.roles.items() if role.kind in MESSAGES)
        first = next(self.container.entries(streams or frozenset(self.container.channels)), None)
        first_ns = 0 if first is None else first.log_ns
        start_ns, end_ns = (None if m is None else m.absolute_ns(first_ns) for m in (start, end))
        window = Window(start_ns, end_ns)
        if start_ns is not None and window.is_behind(start_ns):
            raise ConfigError(f"range {self.excerpt}: empty; the first measurement is at {first_ns}ns")
        return window

    def entries(self, channels: frozenset[int]) -> Iterator[Entry]:
        """Entries of some channels up to the end of the log: all of those that tell the rig or hold a video, and of the
        others only what is in or behind the window; what is before it needn't be read.
        """
        start_ns, roles = self.window.start_ns, self.reader.roles
        if start_ns is None:
            return self.container.entries(channels)
        kinds = {id_: roles[id_] for id_ in channels if id_ in roles}
        wanted = frozenset(
            id_
            for id_, r in kinds.items()
            if r.kind == "calibration" or (r.kind == "transform" and r.is_static) or self._is_video(id_, r)
        )
        early = takewhile(lambda entry: entry.log_ns < start_ns, self.container.entries(wanted) if wanted else ())
        return chain(early, self.container.entries(channels, start_ns))

    def _is_video(self, channel: int, role: Role) -> bool:
        """Whether the first message of a camera that can be read is a picture of a video."""
        if role.kind != "camera":
            return False
        readable = (_read(role, entry) for entry in islice(self.container.entries(frozenset({channel})), _MOST_UNREAD))
        first = next((image for image in readable if image is not None), None)
        return isinstance(first, Image) and first.encoding in CODECS

    @property
    def info(self) -> LogInfo:
        """Id, given or derived, and metadata."""
        return self.reader.info

    @cached_property
    def about(self) -> LogHeader:
        """What the new log says about itself, where messages tell the rig."""
        kinds = {} if self.container.header is None else self.container.header.kinds
        wanted = {name: kind for name, kind in kinds.items() if name not in self.gone}
        return LogHeader(self.info.log_id, self.info.metadata, wanted)
