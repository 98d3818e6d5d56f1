"""Findings about the times of one sensor's messages, from compact statistics."""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import xxhash

from fbench.replay.check.findings import Finding, finding
from fbench.replay.data.arrays import Array, Int64
from fbench.replay.data.messages import Message
from fbench.replay.data.scores import format_count
from fbench.replay.logs.codecs.codec import SENSORS
from fbench.replay.logs.container import Entry
from fbench.replay.logs.setup import MAX_SKEW_NS, mending_offset
from fbench.replay.runs.digest import digest


class Times:
    """Stamps, log times and digests of the messages of one sensor, in canonical order: 24 bytes a message."""

    def __init__(self) -> None:
        self.stamps, self.logs, self.digests = array("q"), array("q"), array("Q")
        self.num_unordered = 0  # Messages that were recorded before one with a smaller log time
        self._last: dict[int, tuple[int, int, int]] = {}

    def add(self, entry: Entry, message: Message) -> None:
        """Note one message."""
        self.stamps.append(message.stamp_ns)
        self.logs.append(message.log_ns)
        data = entry.data
        code = xxhash.xxh3_64_intdigest(data) if isinstance(data, memoryview) else int(digest(message)[:16], 16)
        self.digests.append(code)
        place = (entry.part, entry.block, entry.offset)
        self.num_unordered += place < self._last.get(entry.channel, place)
        self._last[entry.channel] = place


@dataclass(frozen=True, eq=False)
class Timeline:
    """The times of one sensor as arrays, cut where its clock jumps back."""

    stamp_ns: Int64  # Of all messages with a stamp, in canonical order; the next two belong to it
    log_ns: Int64
    digest: Array
    pieces: tuple[slice, ...]  # Between jumps of the clock
    steps_ns: Int64  # From each distinct stamp of a piece to the next one
    steps_from_ns: Int64  # The stamp at which each begins
    num_zero: int  # Messages whose stamp is 0
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
    pieces = [line.stamp_ns[piece] for piece in line.pieces]
    amount = np.concatenate([np.maximum.accumulate(stamps) - stamps for stamps in pieces])
    rows = np.flatnonzero(amount)
    return rows, amount[rows]


def find_repeated(line: Timeline) -> tuple[Int64, Int64]:
    """Which messages have the stamp of one before, with the same content and with another."""
    order = np.lexsort((line.digest, line.stamp_ns))  # stable
    stamp, code = line.stamp_ns[order], line.digest[order]
    again = stamp[1:] == stamp[:-1]
    same = again & (code[1:] == code[:-1])
    return np.sort(order[1:][same], kind="stable"), np.sort(order[1:][again & ~same], kind="stable")


_LOST_PERIODS = 1.5  # Between two messages that are farther apart than so many periods others were lost
_OFF_BEAT = 0.25  # A step that differs from a multiple of the period by a larger share of it is irregular


@dataclass(frozen=True)
class StreamStats:
    """What one sensor delivered; times by stamp, in nanoseconds; `None` where there are too few messages."""

    sensor: str
    kind: str
    num_messages: int
    first_stamp_ns: int | None
    last_stamp_ns: int | None
    rate_hz: float | None  # From the median period
    median_period_ns: int | None
    max_gap_ns: int | None
    jitter_p99_ns: int | None
    """99th percentile of the absolute difference of a period from the median one; gaps between segments don't count."""
    num_lost: int  # Estimated from periods that are multiples of the median one; gaps between segments don't count
    num_irregular: int  # Periods that aren't multiples of the median one
    num_gaps: int
    num_duplicates: int  # Messages that equal another one, stamp and content
    num_equal_stamps: int  # Other messages with the stamp of another one
    num_disordered: int
    max_inversion_ns: int
    num_jumps: int
    num_zero_stamps: int
    num_unordered: int  # Messages that were recorded before one with a smaller log time
    skew_median_ns: int | None  # Log time minus stamp
    skew_min_ns: int | None
    skew_max_ns: int | None


def stream_stats(sensor: str, kind: str, line: Timeline, max_gap_ns: int) -> StreamStats:
    """Sum up one sensor; a longer step than `max_gap_ns` is a gap."""
    stamps, steps = line.stamp_ns, line.steps_ns
    period = quantile(steps, 0.5)
    short = steps[steps <= max_gap_ns]
    num_lost = num_irregular = 0
    if period:
        multiples = np.rint(short / period)
        num_lost = int(np.where(short > _LOST_PERIODS * period, multiples.astype(np.int64) - 1, 0).sum())
        off = np.abs(short - np.maximum(1, multiples) * period) > _OFF_BEAT * period
        num_irregular = int(np.count_nonzero(off))
    _, behind = out_of_order(line)
    same, other = find_repeated(line)
    skew = line.log_ns - stamps
    return StreamStats(
        sensor, kind, len(stamps) + line.num_zero,
        int(stamps.min()) if len(stamps) else None, int(stamps.max()) if len(stamps) else None,
        1e9 / period if period else None, period, quantile(steps, 1.0),
        None if period is None else quantile(np.abs(short - period), 0.99), num_lost, num_irregular,
        len(steps) - len(short), len(same), len(other), len(behind), int(behind.max(initial=0)),
        len(line.pieces) - 1, line.num_zero, line.num_unordered,
        quantile(skew, 0.5), quantile(skew, 0.0), quantile(skew, 1.0),
    )  # fmt: skip


def quantile(values: Int64, share: float) -> int | None:
    """Nearest-rank quantile, exact in integers; `None` without values."""
    if len(values) == 0:
        return None
    at = min(len(values) - 1, max(0, int(np.ceil(share * len(values))) - 1))
    return int(np.partition(values, at)[at])


_MANY_LOST, _MANY_IRREGULAR = 0.05, 0.1
_FEW = 10  # Fewer messages say nothing about a period
_MAX_PERIODS = 2
"""A sweep that is stamped as it begins and recorded when it is over is a period old, and what sending it took."""
_MAX_EARLY_NS = 20_000_000  # So far ahead of the recorder may a synchronized clock be


def time_findings(stats: StreamStats, line: Timeline, reference: StreamStats | None) -> Iterator[Finding]:
    """Judge one sensor's times, its clock against that of the reference sensor."""
    name, num, stamps = stats.sensor, stats.num_messages, line.stamp_ns
    (late, _), (same, other) = out_of_order(line), find_repeated(line)
    back = f"stamps are older than one before, by up to {_ms(stats.max_inversion_ns)}"
    for code, many, what, rows in (
        ("CHK001", stats.num_zero_stamps, "stamps are 0", None),
        ("TIM001", len(late), back, late),
        ("CHK004", stats.num_unordered, "messages were recorded in another order than that of their log times", None),
        ("TIM004", len(same), "messages are exact duplicates of others", same),
        ("TIM003", len(other), "messages have the stamp of another one, but not its content", other),
    ):
        if many:
            first = "" if rows is None else f"stamp {int(stamps[rows[0]])} ns"
            yield finding(code, name, f"{many} of {num} {what}", many, first)
    if stats.num_jumps:
        starts = np.array([piece.start for piece in line.pieces[1:]])
        back = _s(int((stamps[starts - 1] - stamps[starts]).max()))
        text = f"the clock jumps back {format_count(stats.num_jumps, 'time')}, by up to {back}"
        yield finding("TIM005", name, text, stats.num_jumps, f"stamp {int(stamps[starts[0]])} ns")
    if stats.num_gaps:
        longest = np.argsort(-line.steps_ns, kind="stable")[: stats.num_gaps]
        text = f"{format_count(stats.num_gaps, 'gap')}, the longest of {_s(int(line.steps_ns[longest[0]]))}"
        yield finding("TIM007", name, text, stats.num_gaps, f"after stamp {int(line.steps_from_ns[longest].min())} ns")
    yield from _judge_periods(stats)
    yield from _judge_clock(stats, reference)


def _judge_periods(stats: StreamStats) -> Iterator[Finding]:
    period, num = stats.median_period_ns, stats.num_messages
    if stats.kind not in SENSORS or period is None or stats.jitter_p99_ns is None or num < _FEW:
        return
    if stats.num_irregular > _MANY_IRREGULAR * num:
        text = (f"{stats.num_irregular} of {num} periods are irregular: median {_ms(period)}, "
                f"99 % within {_ms(stats.jitter_p99_ns)} of it")  # fmt: skip
        yield finding("CHK002", stats.sensor, text, stats.num_irregular)
    elif stats.num_lost:
        were = "was" if stats.num_lost == 1 else "were"
        text = f"about {format_count(stats.num_lost, 'message')} {were} lost, beside {num} that are there"
        many = stats.num_lost > _MANY_LOST * (num + stats.num_lost)
        yield finding("CHK003", stats.sensor, text, stats.num_lost, severity="warning" if many else "info")


def _judge_clock(stats: StreamStats, reference: StreamStats | None) -> Iterator[Finding]:
    skew, period = stats.skew_median_ns, stats.median_period_ns
    if skew is None or stats.skew_min_ns is None or stats.skew_max_ns is None:
        return
    other = None if reference is None else reference.skew_median_ns
    if reference is not None and other is not None and abs(skew - other) > MAX_SKEW_NS:
        side = "behind" if skew > other else "before"
        text = f"its clock is {_s(abs(other - skew))} {side} that of {reference.sensor}"
        offset = mending_offset(stats.sensor, -skew, reference.sensor, -other)
        advice = f"synchronize the clocks, or give {offset} or --stamps log"
        yield finding("TIM008", stats.sensor, text, stats.num_messages, advice=advice)
    elif period is not None and (skew > _MAX_PERIODS * period or skew < -_MAX_EARLY_NS):
        age, beyond = "newer", ": measured after it was recorded?"
        if skew > 0:
            age, beyond = "older", f", more than {_MAX_PERIODS} periods of {_ms(period)}"
        text = (f"header stamps are {_ms(abs(skew))} {age} than arrival (median; "
                f"log time minus stamp is {_ms(stats.skew_min_ns)} to {_ms(stats.skew_max_ns)}){beyond}")  # fmt: skip
        yield finding("TIM009", stats.sensor, text, stats.num_messages)


def _ms(value_ns: int) -> str:
    return f"{value_ns / 1e6:.1f} ms"


def _s(value_ns: int) -> str:
    return f"{value_ns / 1e9:.3f} s"
