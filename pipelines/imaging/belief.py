"""How likely objects in an image are: what every sensor that sees one says, and what those say that don't."""

from collections.abc import Iterable
from typing import overload

import numpy as np

from fbench.replay.arrays import Float64

SURE = 0.5
"""A camera alone reports what it believes so far."""
_MOST = 0.98
"""No sensor alone can be surer of an object, nor of none."""


def relative(score: Float64, min_score: float) -> Float64:
    """Turn the scores (N,) of a camera's boxes into probabilities, `SURE` at the score from which on it reports them.

    Detectors mean different things by a score. The ratio of odds to those of `min_score`, which weights bring with
    them, is taken to mean the same for all.
    """
    return np.asarray(1 / (1 + np.exp(log_odds(min_score) - log_odds(score))), np.float64)


@overload
def log_odds(probability: float) -> float: ...


@overload
def log_odds(probability: Float64) -> Float64: ...


def log_odds(probability: float | Float64) -> float | Float64:
    """Logarithm of odds, of probabilities that are neither 0 nor 1."""
    p = np.clip(probability, 1 - _MOST, _MOST)
    return np.log(p / (1 - p))  # type: ignore[no-any-return]


def agreed(prior: float, factors: Iterable[float]) -> float:
    """Probability of an object, given how likely one is before any sensor looks, and by which factor each says that its
    odds are larger or smaller: sensors are taken for independent (naive Bayes).
    """
    total = log_odds(prior) + sum(np.log(max(factor, 1e-9)) for factor in factors)
    return float(1 / (1 + np.exp(-total)))
