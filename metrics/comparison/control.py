"""Intervals from a few labels and many frames: control variates from frames without labels.

How far two pipelines agree is known of every frame. Where it goes along with the errors of one of them, labeled frames
that happen to be easier than the rest show it, and the estimate can be corrected (regression estimator: Cochran 1977,
"Sampling Techniques", 7.3; for perception Luo et al. 2025, "Sim2Val").
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from fbench.metrics.comparison.inference import Ratio
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.arrays import Bool, Float64, Int64

LEAST_FRAMES = 10
"""Of fewer labeled frames a regression says nothing."""
_SHARE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def width(self) -> float:
        """Width of the interval."""
        return self.high - self.low


@dataclass(frozen=True)
class Controlled:
    """A value of all frames, estimated from labeled ones alone, and with control variates."""

    plain: Estimate
    narrow: Estimate
    num_labeled: int
    num_frames: int

    @property
    def gain(self) -> float:
        """By which share control variates narrow the interval; below 0 where they widen it."""
        return 1 - self.narrow.width / self.plain.width if self.plain.width else 0.0


def control(counts: Int64, agreement: Sequence[Int64], is_labeled: Bool, value: Ratio) -> Controlled | str:
    """Estimate a ratio of counts over all N frames, n of which are labeled as if drawn at random; or say why not.

    Args:
        counts: (n, K) of the labeled frames.
        agreement: (N, K) of all frames, for each of M other pipelines, whose results stand for truth.
        is_labeled: (N,) which of them are labeled.
        value: The ratio, of K counts.

    Each frame's share e in the error of the ratio R is what leaving it out changes, e_i = (n - 1) (R - R without i),
    centered (jackknife: Efron and Tibshirani 1993, 11). Controls g (M,) are the same of the agreements, with mean 0
    over all N. With b the slopes of e on g over labeled frames, R - b . mean(g) has variance
    var(e - b . g) (1/n - 1/N), and R alone var(e) (1/n - 1/N).

    Raises MetricError where fewer than `LEAST_FRAMES` are labeled.
    """
    n, total = len(counts), len(is_labeled)
    if n < LEAST_FRAMES + len(agreement):
        raise MetricError(f"{n} labeled frames, at least {LEAST_FRAMES + len(agreement)} are needed for a control")
    plain, errors = _measure_shares(counts, value)
    if not np.isfinite(plain):
        return "undefined over the labeled frames"
    if not np.isfinite(errors).all():
        return "undefined without one of the labeled frames"
    own = np.column_stack([np.nan_to_num(_measure_shares(other, value)[1])[is_labeled] for other in agreement])
    centered = own - own.mean(axis=0)
    slopes = np.linalg.lstsq(centered, errors, rcond=None)[0]
    rest = errors - (centered * slopes).sum(axis=1)
    scale = float(np.sqrt(1 / n - 1 / total))
    moved = plain - float((slopes * own.mean(axis=0)).sum())
    narrow = _estimate(moved, rest, n - 1 - len(agreement), scale)
    return Controlled(_estimate(plain, errors, n - 1, scale), narrow, n, total)


def _measure_shares(counts: Int64, value: Ratio) -> tuple[float, Float64]:
    """The ratio over all frames, and each frame's share in its error (F,), whose mean is 0; NaN where undefined."""
    total = counts.sum(axis=0, dtype=np.float64)
    whole = float(value(total))
    shares = (len(counts) - 1) * (whole - value(total - counts))
    return whole, np.asarray(shares - shares.mean(), np.float64)


def _estimate(value: float, errors: Float64, free: int, scale: float) -> Estimate:
    half = float(special.stdtrit(free, (1 + _SHARE) / 2)) * scale * float(np.sqrt((errors**2).sum() / free))
    return Estimate(value, value - half, value + half)
