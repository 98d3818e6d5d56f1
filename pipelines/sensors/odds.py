"""Odds for which probabilities of sensors stand, and their combination."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from fbench.replay.data.arrays import Float64

SENSOR_LIMIT = 1 - 0.98  # No sensor alone can be surer of an object than 1 less this, nor of none than this


def log_odds(probability: float | Float64, least: float = SENSOR_LIMIT) -> Any:
    """Logarithm of the odds of probabilities, which count as `least` at least and 1 - `least` at most; NaN stays."""
    p = np.clip(probability, least, 1 - least)
    return np.log(p / (1 - p))


def probability_of(odds: Float64) -> Float64:
    """Probability (N,) of logarithms of odds (N,)."""
    return np.asarray(1 / (1 + np.exp(-odds)), np.float64)


def combine_factors(prior: float, factors: Iterable[float]) -> float:
    """Probability of an object, given how likely one is before any sensor looks, and by which factor each says that its
    odds are larger or smaller: sensors are taken for independent (naive Bayes).
    """
    total = log_odds(prior) + sum(np.log(max(factor, 1e-9)) for factor in factors)
    return float(1 / (1 + np.exp(-total)))
