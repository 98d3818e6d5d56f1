"""When the messages of one sensor were measured and recorded: kept compactly, and what that says."""

from array import array
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import xxhash

from fbench.replay.arrays import Array, Int64
from fbench.replay.data import Message
from fbench.replay.digest import digest
from fbench.replay.logs.container import Entry


@dataclass
class Times:
    """Stamps, log times and digests of the messages of one sensor, in canonical order: 24 bytes a message."""

    stamps: "array[int]" = field(default_factory=lambda: array("q"))
    logs: "array[int]" = field(default_factory=lambda: array("q"))
    digests: "array[int]" = field(default_factory=lambda: array("Q"))
    num_unordered: int = 0
    """Messages that were recorded before one with a smaller log time."""
    _last: dict[int, tuple[int, int, int]] = field(default_factory=dict)

    def add(self, entry: Entry, message: Message) -> None:
        """Note one message."""
        self.stamps.append(message.stamp_ns)
        self.logs.append(message.log_ns)
        self.digests.append(_digest(entry, message))
        place = (entry.part, entry.block, entry.offset)
        self.num_unordered += place < self._last.get(entry.channel, place)
        self._last[entry.channel] = place


def _digest(entry: Entry, message: Message) -> int:
    if isinstance(entry.data, memoryview):
        return xxhash.xxh3_64_intdigest(entry.data)
    return int(digest(message)[:16], 16)


@dataclass(frozen=True, eq=False)
class Timeline:
    """The times of one sensor as arrays, cut where its clock jumps back."""

    stamp_ns: Int64
    """Of all messages with a stamp, in canonical order; the next two belong to it."""
    log_ns: Int64
    digest: Array
    pieces: tuple[slice, ...]
    """Between jumps of the clock."""
    steps_ns: Int64
    """From each distinct stamp of a piece to the next one."""
    steps_from_ns: Int64
    """The stamp at which each begins."""
    num_zero: int
    """Messages whose stamp is 0."""
    num_unordered: int


def timeline(times: Times, max_jump_ns: int) -> Timeline:
    """Return the times of one sensor; a step back by more than `max_jump_ns` is a jump."""
    stamp, log, code = (np.array(a, d) for a, d in ((times.stamps, "i8"), (times.logs, "i8"), (times.digests, "u8")))
    real = stamp != 0
    stamp, log, code = stamp[real], log[real], code[real]
    cuts = [0, *(np.flatnonzero(np.diff(stamp) < -max_jump_ns) + 1).tolist(), len(stamp)]
    pieces = tuple(slice(a, b) for a, b in pairwise(cuts))
    distinct = [np.unique(stamp[piece]) for piece in pieces]
    steps = np.concatenate([np.diff(d) for d in distinct])
    starts = np.concatenate([d[:-1] for d in distinct])
    return Timeline(stamp, log, code, pieces, steps, starts, int(np.count_nonzero(~real)), times.num_unordered)


def out_of_order(line: Timeline) -> tuple[Int64, Int64]:
    """Which messages have a smaller stamp than one before them in their piece, and by how much [ns]."""
    behind = [np.maximum.accumulate(line.stamp_ns[piece]) - line.stamp_ns[piece] for piece in line.pieces]
    amount = np.concatenate(behind)
    rows = np.flatnonzero(amount)
    return rows, amount[rows]


def repeated(line: Timeline) -> tuple[Int64, Int64]:
    """Which messages have the stamp of one before, with the same content and with another."""
    order = np.lexsort((line.digest, line.stamp_ns))  # stable
    stamp, code = line.stamp_ns[order], line.digest[order]
    again = stamp[1:] == stamp[:-1]
    same = again & (code[1:] == code[:-1])
    return np.sort(order[1:][same], kind="stable"), np.sort(order[1:][again & ~same], kind="stable")
