"""Reading a log from the middle on."""

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from fbench.replay.logs.container import Container, Entry


@runtime_checkable
class Seekable(Protocol):
    """A container that needn't read what comes before."""

    def entries_from(self, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
        """All messages of these channels from a log time on, in canonical order."""
        ...


def entries_from(container: Container, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
    """Return all messages of these channels from a log time on, in canonical order, however they are found."""
    if isinstance(container, Seekable):
        return container.entries_from(channels, start_ns)
    return (entry for entry in container.entries(channels) if entry.log_ns >= start_ns)
