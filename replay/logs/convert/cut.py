"""Cutting a log by time, so that what stays has the rig that was in force at the cut."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby

from fbench.replay.errors import ConfigError, DecodeError
from fbench.replay.excerpt import Excerpt, Moment
from fbench.replay.logs.codec import MESSAGES
from fbench.replay.logs.container import Container, Entry
from fbench.replay.logs.convert.items import RigAt
from fbench.replay.logs.roles import Role


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
        """Refuse a window that turned out to be empty.

        Raises:
            ConfigError: where anything was cut off.
        """
        if self != Window():
            start = "the start" if self.start_ns is None else f"{self.start_ns}ns"
            end = "the end" if self.end_ns is None else f"{self.end_ns}ns"
            raise ConfigError(f"no message from {start} to {end}; see fbench log info for the times of the log")


def window_of(excerpt: Excerpt, container: Container, roles: Mapping[int, Role]) -> Window:
    """Resolve times that count from the log's first measurement on: the smallest `log_ns` of a sensor or pose.

    Raises:
        ConfigError: where the window is empty.
    """
    if excerpt.start is None and excerpt.end is None:
        return Window()
    streams = frozenset(id_ for id_, role in roles.items() if role.kind in MESSAGES)
    first = next(container.entries(streams or frozenset(container.channels)), None)
    start_ns = 0 if first is None else first.log_ns
    window = Window(_absolute(excerpt.start, start_ns), _absolute(excerpt.end, start_ns))
    if window.start_ns is not None and window.is_behind(window.start_ns):
        raise ConfigError(f"range {excerpt}: empty; the first measurement is at {start_ns}ns")
    return window


def _absolute(moment: Moment | None, start_ns: int) -> int | None:
    return None if moment is None else moment.absolute_ns(start_ns)


def cut(entries: Iterable[Entry], window: Window, roles: Mapping[int, Role]) -> Iterator[Entry]:
    """Yield the entries of the window, before them the last transforms and calibrations that were there when it began.

    Raises:
        ConfigError: where there are no others.
    """
    before = _Before(roles)
    is_empty = True
    for log_ns, together in groupby(entries, key=lambda entry: entry.log_ns):
        if window.is_behind(log_ns):
            break
        others = list(together)
        if window.start_ns is not None and log_ns <= window.start_ns:
            others = [entry for entry in others if not before.take(entry)]
        if window.is_before(log_ns):
            continue
        is_empty = False
        yield from before.leave()
        yield from others
    if is_empty:
        window.require_all()


@dataclass
class _Before:
    """What must survive of the messages before the cut: the last one for each coordinate frame and camera."""

    roles: Mapping[int, Role]
    last: dict[tuple[str, str], Entry] = field(default_factory=dict)

    def take(self, entry: Entry) -> bool:
        """Take a message in place of those that it replaces; tells whether it tells the rig."""
        role = self.roles.get(entry.channel)
        if role is None or not isinstance(entry.data, memoryview):
            return False
        keys = self._keys(role, entry.data)
        if keys:
            # A copy: its block needn't stay in memory.
            kept = entry._replace(data=memoryview(bytes(entry.data)))
            self.last |= dict.fromkeys(keys, kept)
        return bool(keys)

    def leave(self) -> list[Entry]:
        """Give what was taken, in canonical order."""
        entries = {entry[:5]: entry for entry in self.last.values()}
        self.last = {}
        return [entry for _, entry in sorted(entries.items())]

    @staticmethod
    def _keys(role: Role, data: memoryview) -> list[tuple[str, str]]:
        """What a message tells, nothing where it doesn't tell the rig or can't be read."""
        if role.codec is None:
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
