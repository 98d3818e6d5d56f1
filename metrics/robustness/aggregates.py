"""Aggregates over conditions and severities, as the benchmarks of the field define them.

M is a score in 0 to 1 of C conditions at S severities, shape (..., C, S); leading dimensions are resamples. What
can't be divided is NaN.
"""

import numpy as np

from fbench.replay.data.arrays import Array, Float64


def corruption_error(score: Array, baseline: Array) -> Float64:
    """Return CE (..., C) of scores and a baseline's scores: sum_s(1 - M) / sum_s(1 - M_b) (Hendrycks and Dietterich,
    ICLR 2019; Robo3D, RoboBEV). Their mean is mCE, a mean of ratios.
    """
    return _divide((1 - score).sum(-1), (1 - baseline).sum(-1))


def relative_corruption_error(score: Array, clean: Array, baseline: Array, baseline_clean: Array) -> Float64:
    """Return relative CE (..., C): sum_s(M_clean - M) / sum_s(M_b,clean - M_b); clean scores have shape (...).
    NaN where the baseline doesn't drop (Hendrycks and Dietterich, ICLR 2019).
    """
    drop = (np.asarray(clean)[..., None, None] - score).sum(-1)
    baseline_drop = (np.asarray(baseline_clean)[..., None, None] - baseline).sum(-1)
    return _divide(drop, np.where(baseline_drop > 0, baseline_drop, 0))


def resilience_rate(score: Array, clean: Array) -> Float64:
    """Return RR (..., C): sum_s M / (S M_clean) (Robo3D, RoboBEV); equal to the mean over severities of the resistance
    ability M / M_clean (MultiCorrupt). Their mean is mRR, or mRA.
    """
    return _divide(score.mean(-1), np.asarray(clean)[..., None])


def relative_resistance(score: Array, baseline: Array) -> Float64:
    """Return RRA (..., C): sum_s M / sum_s M_b - 1 (MultiCorrupt, IV 2024)."""
    return np.asarray(_divide(score.sum(-1), baseline.sum(-1)) - 1)


def relative_change(score: Array, clean: Array) -> Float64:
    """Return (M - M_clean) / M_clean (..., C, S): the thesis's table 9.5."""
    whole = np.asarray(clean)[..., None, None]
    return _divide(score - whole, np.broadcast_to(whole, score.shape))


def _divide(top: Array, bottom: Array) -> Float64:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(bottom != 0, top / bottom, np.nan), np.float64)
