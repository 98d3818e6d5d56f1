"""Where the rig changes within a log."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby

from fbench.replay.data import Rig, RigChange
from fbench.replay.errors import LogError
from fbench.replay.logs.container import Entry
from fbench.replay.logs.read_rig import RigState
from fbench.replay.logs.roles import Role


class RigChanges:
    """Follows transforms and calibrations, to tell where the rig changes."""

    def __init__(self, rig: Rig | None, stored: Sequence[tuple[int, Rig]], state: RigState | None) -> None:
        """Start with the rig of the log's beginning (`None` where it isn't whole: then no change is told), the rigs
        that the container itself knows of, or what its messages told so far.
        """
        self._rig, self._stored = rig, list(stored)
        self._state = None if state is None or rig is None else state.copy()
        self._is_new = False
        self.channels = frozenset() if self._state is None else _telling(self._state.roles)

    def followed(self, entries: Iterable[Entry]) -> Iterator[Entry]:
        """Pass all entries on, taking the transforms and calibrations of one log time before its other messages: which
        topic comes first in the alphabet must not decide what they are seen with.
        """
        if not self.channels:
            yield from entries
            return
        for _, group in groupby(entries, key=lambda entry: entry.log_ns):
            together = list(group)
            for entry in together:
                if entry.channel in self.channels and self._state is not None:
                    self._is_new = self._state.take(entry) or self._is_new
            yield from together

    def until(self, log_ns: int) -> Iterator[RigChange]:
        """Yield the change of the rig before a message of log time `log_ns`, where there is one."""
        rig = None
        while self._stored and self._stored[0][0] <= log_ns:
            _, rig = self._stored.pop(0)
        if rig is not None:
            yield from self._changed(log_ns, rig)
        if self._is_new and self._state is not None:
            self._is_new = False
            try:
                rig = self._state.rig()
            except LogError:  # what was broken in the middle of a log doesn't end it: the old rig stays
                return
            yield from self._changed(log_ns, rig)

    def _changed(self, log_ns: int, rig: Rig) -> Iterator[RigChange]:
        sensors = () if self._rig is None else rig.changed_since(self._rig)
        if sensors:
            self._rig = rig
            yield RigChange(log_ns, rig, sensors)


def _telling(roles: Mapping[int, Role]) -> frozenset[int]:
    """Channels whose messages tell the rig."""
    return frozenset(
        id_
        for id_, role in roles.items()
        if role.kind == "calibration" or (role.kind == "transform" and role.is_static)
    )
