"""Findings about the times of one sensor."""

from collections.abc import Iterator

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.check.finding import Finding, finding
from fbench.replay.check.stats import StreamStats
from fbench.replay.check.stream import Timeline, out_of_order, repeated
from fbench.replay.logs.codec import SENSORS
from fbench.replay.restamp import MAX_SKEW_NS, mending_offset

_MANY_LOST, _MANY_IRREGULAR = 0.05, 0.1
_FEW = 10
"""Fewer messages say nothing about a period."""
_MAX_PERIODS = 2
"""A sweep that is stamped as it begins and recorded when it is over is a period old, and what sending it took."""
_MAX_EARLY_NS = 20_000_000
"""So far ahead of the recorder may a synchronised clock be."""


def time_findings(stats: StreamStats, line: Timeline, reference: StreamStats | None) -> Iterator[Finding]:
    """Judge one sensor's times, its clock against that of the reference sensor."""
    yield from _stamps(stats, line)
    yield from _repeats(stats, line)
    yield from _pauses(stats, line)
    yield from _rhythm(stats)
    yield from _clock(stats, reference)


def _stamps(stats: StreamStats, line: Timeline) -> Iterator[Finding]:
    name, num = stats.sensor, stats.num_messages
    if stats.num_zero_stamps:
        yield finding("CHK001", name, f"{stats.num_zero_stamps} of {num} stamps are 0", stats.num_zero_stamps)
    rows, behind = out_of_order(line)
    if len(rows):
        text = f"{len(rows)} of {num} stamps are older than one before, by up to {_ms(int(behind.max()))}"
        yield finding("TIM001", name, text, len(rows), _at(line.stamp_ns, rows))
    if stats.num_jumps:
        starts = np.array([piece.start for piece in line.pieces[1:]])
        back = line.stamp_ns[starts - 1] - line.stamp_ns[starts]
        text = (
            f"the clock jumps back {stats.num_jumps} {_plural('time', stats.num_jumps)}, by up to {_s(int(back.max()))}"
        )
        yield finding("TIM005", name, text, stats.num_jumps, _at(line.stamp_ns, starts))
    if stats.num_unordered:
        text = f"{stats.num_unordered} of {num} messages were recorded in another order than that of their log times"
        yield finding("CHK004", name, text, stats.num_unordered)


def _repeats(stats: StreamStats, line: Timeline) -> Iterator[Finding]:
    same, other = repeated(line)
    if len(same):
        text = f"{len(same)} of {stats.num_messages} messages are exact duplicates of others"
        yield finding("TIM004", stats.sensor, text, len(same), _at(line.stamp_ns, same))
    if len(other):
        text = f"{len(other)} of {stats.num_messages} messages have the stamp of another one, but not its content"
        yield finding("TIM003", stats.sensor, text, len(other), _at(line.stamp_ns, other))


def _pauses(stats: StreamStats, line: Timeline) -> Iterator[Finding]:
    if stats.num_gaps:
        longest = np.argsort(-line.steps_ns, kind="stable")[: stats.num_gaps]
        text = f"{stats.num_gaps} {_plural('gap', stats.num_gaps)}, the longest of {_s(int(line.steps_ns[longest[0]]))}"
        first = f"after stamp {int(line.steps_from_ns[longest].min())} ns"
        yield finding("TIM007", stats.sensor, text, stats.num_gaps, first)


def _rhythm(stats: StreamStats) -> Iterator[Finding]:
    period, num = stats.median_period_ns, stats.num_messages
    if stats.kind not in SENSORS or period is None or stats.jitter_p99_ns is None or num < _FEW:
        return
    if stats.num_irregular > _MANY_IRREGULAR * num:
        text = (f"{stats.num_irregular} of {num} periods are irregular: median {_ms(period)}, "
                f"99 % within {_ms(stats.jitter_p99_ns)} of it")  # fmt: skip
        yield finding("CHK002", stats.sensor, text, stats.num_irregular)
    elif stats.num_lost:
        lost = f"{stats.num_lost} {_plural('message', stats.num_lost)} {'was' if stats.num_lost == 1 else 'were'} lost"
        text = f"about {lost}, beside {num} that are there"
        many = stats.num_lost > _MANY_LOST * (num + stats.num_lost)
        yield finding("CHK003", stats.sensor, text, stats.num_lost, severity="warning" if many else "info")


def _clock(stats: StreamStats, reference: StreamStats | None) -> Iterator[Finding]:
    skew, period = stats.skew_median_ns, stats.median_period_ns
    if skew is None or stats.skew_min_ns is None or stats.skew_max_ns is None:
        return
    other = None if reference is None else reference.skew_median_ns
    if reference is not None and other is not None and abs(skew - other) > MAX_SKEW_NS:
        text = (
            f"its clock is {_s(abs(other - skew))} {'behind' if skew > other else 'before'} that of {reference.sensor}"
        )
        offset = mending_offset(stats.sensor, -skew, reference.sensor, -other)
        advice = f"synchronise the clocks, or give {offset} or --stamps log"
        yield finding("TIM008", stats.sensor, text, stats.num_messages, advice=advice)
    elif period is not None and (skew > _MAX_PERIODS * period or skew < -_MAX_EARLY_NS):
        beyond = (
            f", more than {_MAX_PERIODS} periods of {_ms(period)}" if skew > 0 else ": measured after it was recorded?"
        )
        text = (f"header stamps are {_ms(abs(skew))} {'older' if skew > 0 else 'newer'} than arrival (median; "
                f"log time minus stamp is {_ms(stats.skew_min_ns)} to {_ms(stats.skew_max_ns)}){beyond}")  # fmt: skip
        yield finding("TIM009", stats.sensor, text, stats.num_messages)


def _at(stamp_ns: Int64, rows: Int64) -> str:
    return f"stamp {int(stamp_ns[rows[0]])} ns"


def _plural(noun: str, num: int) -> str:
    return noun if num == 1 else f"{noun}s"


def _ms(value_ns: int) -> str:
    return f"{value_ns / 1e6:.1f} ms"


def _s(value_ns: int) -> str:
    return f"{value_ns / 1e9:.3f} s"
