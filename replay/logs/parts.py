"""Several files as one log."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from fbench.replay.arrays import Int64
from fbench.replay.data import Rig
from fbench.replay.faults import FaultLog
from fbench.replay.logs.container import Channel, Container, Entry
from fbench.replay.logs.header import LogHeader
from fbench.replay.logs.order import merged
from fbench.replay.logs.seek import entries_from

T = TypeVar("T")
_IDS = 2**32
"""Channel `c` of part `p` gets the id `p * _IDS + c`."""


@dataclass(frozen=True)
class _Part:
    offset: int
    """Its number."""
    start_ns: int
    container: Container


class Parts:
    """A recording that was split into files; implements `Container`.

    Files are opened when their time comes, so that many of them don't fill the memory.
    """

    def __init__(self, path: Path, containers: Sequence[Container], faults: FaultLog) -> None:
        self.path = path
        self._faults = faults
        self._parts = [_Part(i, _start_ns(c), c) for i, c in enumerate(containers)]
        self.channels: dict[int, Channel] = self._by_id([c.channels for c in containers])
        self.counts: dict[int, int] = self._by_id([c.counts for c in containers])
        self.header: LogHeader | None = next((c.header for c in containers if c.header is not None), None)
        self.rigs: Sequence[tuple[int, Rig]] = ()

    def entries(self, channels: frozenset[int]) -> Iterator[Entry]:
        """All messages of these channels in canonical order."""
        wanted = [part for part in self._parts if self._of(part, channels)]
        return merged(wanted, lambda part: self._entries(part, part.container.entries(self._of(part, channels))))

    def entries_from(self, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
        """All messages of these channels from a log time on, in canonical order."""
        wanted = [part for part in self._parts if self._of(part, channels)]
        return merged(
            wanted, lambda part: self._entries(part, entries_from(part.container, self._of(part, channels), start_ns))
        )

    def log_times(self) -> Mapping[int, Int64] | None:
        """Log times of each channel, where all parts know them."""
        times = [part.container.log_times() for part in self._parts]
        return None if any(t is None for t in times) else self._by_id([t for t in times if t is not None])

    def verify(self) -> None:
        """Check all parts."""
        for part in self._parts:
            part.container.verify()

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""
        self._faults.once(code, (str(self.path), *key), f"{self.path.name}: {where}")

    @staticmethod
    def _entries(part: _Part, entries: Iterator[Entry]) -> Iterator[Entry]:
        first = part.offset * _IDS
        for entry in entries:
            yield entry._replace(part=part.offset, channel=first + entry.channel)

    def _of(self, part: _Part, channels: frozenset[int]) -> frozenset[int]:
        return frozenset(id_ % _IDS for id_ in channels if id_ // _IDS == part.offset)

    @staticmethod
    def _by_id(maps: Sequence[Mapping[int, T]]) -> dict[int, T]:
        return {i * _IDS + id_: value for i, values in enumerate(maps) for id_, value in values.items()}


def _start_ns(container: Container) -> int:
    """Log time before which the container has no message."""
    entry = next(container.entries(frozenset(container.channels)), None)
    return 0 if entry is None else entry.log_ns
