"""Messages from several places of a log, however long it is."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.logs.container import Container, Entry
from fbench.replay.logs.seek import Seekable
from fbench.replay.logs.storage import span_ns

NUM_WINDOWS = 4
MAX_ENTRIES = 800
"""Messages of a window."""
MAX_BYTES = 128 * 1024 * 1024
"""Payload of a window."""
_STORED_BYTES = 100_000
"""What a message counts that the container gives decoded, without telling its size."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """One message, and in which window it is: messages of one window follow each other without a gap."""

    window: int
    entry: Entry


def sampled(
    container: Container, channels: frozenset[int], times: Mapping[int, Int64] | None, max_entries: int = MAX_ENTRIES
) -> Iterator[Sampled]:
    """Yield the messages of these channels from a few windows of time that are spread over the log.

    Args:
        container: The log.
        channels: Those that are wanted.
        times: Log times of all channels, where the index tells them.
        max_entries: Messages of a window.
    """
    starts = _starts(container, channels, times) if channels else []
    for window, start_ns in enumerate(starts):
        end_ns = starts[window + 1] if window + 1 < len(starts) else None
        for entry in _window(container, channels, start_ns, end_ns, max_entries):
            yield Sampled(window, entry)


def _starts(container: Container, channels: frozenset[int], times: Mapping[int, Int64] | None) -> list[int | None]:
    """Log times at which windows begin; `None`: where the log does."""
    if not isinstance(container, Seekable):
        return [None]
    if times is None:
        first, last = span_ns(container, None) or (0, 0)
        return [None, *(first + (last - first) * i // NUM_WINDOWS for i in range(1, NUM_WINDOWS))]
    known = [np.zeros(0, np.int64), *(times[id_] for id_ in sorted(channels & times.keys()))]
    merged = np.sort(np.concatenate(known), kind="stable")
    # Shares of messages, not of time: there may be hours without any.
    later = sorted({int(merged[len(merged) * i // NUM_WINDOWS]) for i in range(1, NUM_WINDOWS)} if len(merged) else [])
    return [None, *(start for start in later if start > merged[0])]


def _window(
    container: Container, channels: frozenset[int], start_ns: int | None, end_ns: int | None, max_entries: int
) -> Iterator[Entry]:
    num_bytes = 0
    if start_ns is None or not isinstance(container, Seekable):
        entries = container.entries(channels)
    else:
        entries = container.entries_from(channels, start_ns)
    for entry in islice(entries, max_entries):
        if end_ns is not None and entry.log_ns >= end_ns:
            return
        yield entry
        num_bytes += len(entry.data) if isinstance(entry.data, memoryview) else _STORED_BYTES
        if num_bytes > MAX_BYTES:
            return
