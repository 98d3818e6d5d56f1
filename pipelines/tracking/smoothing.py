"""Means over time of what the filters don't hold: a track's size, heading and score."""

import numpy as np

from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.geometry.transforms import wrap_angle


def weight(hits: Int64, least: float) -> Float64:
    """Share (T,) of the newest of `hits` measurements in their mean: one of all at first, and never below `least`.

    With 0 the mean is that of all measurements, with 1 it is the last one.
    """
    return np.maximum(1.0 / hits, least)


def mean_of(before: Float64, now: Float64, share: Float64) -> Float64:
    """Mean of what was (T, ...) and a new measurement with its share (T,)."""
    share = share.reshape(share.shape + (1,) * (now.ndim - 1))
    return before + share * (now - before)


def mean_yaw(before: Float64, now: Float64, share: Float64) -> tuple[Float64, Bool]:
    """Mean heading (T,) [rad], and which measurements (T,) pointed backwards: they count turned by pi."""
    change = wrap_angle(now - before)
    backwards = np.abs(change) > np.pi / 2
    change = np.where(backwards, wrap_angle(change + np.pi), change)
    return wrap_angle(before + share * change), backwards


def coasted_score(score: Float64, predicted: Bool, share: float) -> Float64:
    """Scores (T,), those of predicted tracks lowered to a share; negative ones, which are no probabilities, stay."""
    return score if share == 1.0 else np.where(predicted & (score > 0), score * share, score)
