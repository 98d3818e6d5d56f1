"""Numbers about the messages of one sensor."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Bool, Int64
from fbench.replay.check.stream import Timeline, out_of_order, repeated

_LOST_PERIODS = 1.5
"""Between two messages that are farther apart than so many periods others were lost."""
_OFF_BEAT = 0.25
"""A step that differs from a multiple of the period by a larger share of it is irregular."""


@dataclass(frozen=True)
class StreamStats:
    """What one sensor delivered; times by stamp, in nanoseconds; `None` where there are too few messages."""

    sensor: str
    kind: str
    num_messages: int
    first_stamp_ns: int | None
    last_stamp_ns: int | None
    rate_hz: float | None
    """From the median period."""
    median_period_ns: int | None
    max_gap_ns: int | None
    jitter_p99_ns: int | None
    """99th percentile of the absolute difference of a period from the median one; gaps between segments don't count."""
    num_lost: int
    """Estimated from periods that are multiples of the median one; gaps between segments don't count."""
    num_irregular: int
    """Periods that aren't multiples of the median one."""
    num_gaps: int
    num_duplicates: int
    """Messages that equal another one, stamp and content."""
    num_equal_stamps: int
    """Other messages with the stamp of another one."""
    num_disordered: int
    max_inversion_ns: int
    num_jumps: int
    num_zero_stamps: int
    num_unordered: int
    """Messages that were recorded before one with a smaller log time."""
    skew_median_ns: int | None
    """Log time minus stamp."""
    skew_min_ns: int | None
    skew_max_ns: int | None


def stream_stats(sensor: str, kind: str, line: Timeline, max_gap_ns: int) -> StreamStats:
    """Sum up one sensor; a longer step than `max_gap_ns` is a gap."""
    steps = line.steps_ns
    period = quantile(steps, 0.5)
    short = steps[steps <= max_gap_ns]
    _, behind = out_of_order(line)
    same, other = repeated(line)
    skew = line.log_ns - line.stamp_ns
    return StreamStats(
        sensor, kind, len(line.stamp_ns) + line.num_zero,
        int(line.stamp_ns.min()) if len(line.stamp_ns) else None,
        int(line.stamp_ns.max()) if len(line.stamp_ns) else None,
        1e9 / period if period else None, period, quantile(steps, 1.0),
        None if period is None else quantile(np.abs(short - period), 0.99),
        int(_multiples(short, period).sum()), int(np.count_nonzero(_irregular(short, period))),
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


def _multiples(steps: Int64, period: int | None) -> Int64:
    """How many messages should have come within each step."""
    if not period:
        return np.zeros(0, np.int64)
    return np.where(steps > _LOST_PERIODS * period, np.rint(steps / period).astype(np.int64) - 1, 0)


def _irregular(steps: Int64, period: int | None) -> Bool:
    if not period:
        return np.zeros(0, bool)
    off: Bool = np.abs(steps - np.maximum(1, np.rint(steps / period)) * period) > _OFF_BEAT * period
    return off
