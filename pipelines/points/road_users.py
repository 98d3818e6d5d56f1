"""Which clusters are road users, and of which class: an additive model whose numbers a script fitted."""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fbench.pipelines.points.features import FEATURES
from fbench.replay.arrays import Float64, Text

FITTED = Path(__file__).with_name("road_users.json")
"""Made by `benchmarks/fit_road_users.py`, which says how and from what."""


@dataclass(frozen=True, eq=False)
class RoadUserModel:
    """Log-odds of each class against everything else, the sum of one piecewise linear function of each feature."""

    labels: Text
    """(C,) classes."""
    knots: tuple[Float64, ...]
    """For each feature of `FEATURES` the values (K,) between which its function is linear; beyond them it is level."""
    log_odds: tuple[Float64, ...]
    """For each feature what it adds at its knots for each class (C, K)."""
    offset: Float64
    """(C,) what is added to the sum."""

    def probabilities(self, features: Float64) -> Float64:
        """Probabilities (M, C) that clusters with features (M, F) are one road user each of these classes.

        What is missing to 1 is that of being anything else.
        """
        total = np.tile(self.offset, (len(features), 1))
        for column, knots, values in zip(features.T, self.knots, self.log_odds, strict=True):
            total += interpolated(column, knots) @ values.T
        least = np.maximum(total.max(axis=1, initial=0.0, keepdims=True), 0.0)
        odds = np.exp(total - least)
        return np.asarray(odds / (odds.sum(axis=1, keepdims=True) + np.exp(-least)), np.float64)


def interpolated(values: Float64, knots: Float64) -> Float64:
    """Weights (N, K) with which values (N,) lie between ascending knots (K,); beyond them the outermost counts."""
    at = np.clip(values, knots[0], knots[-1])
    right = np.clip(np.searchsorted(knots, at, side="right"), 1, len(knots) - 1)
    share = (at - knots[right - 1]) / (knots[right] - knots[right - 1])
    weights = np.zeros((len(values), len(knots)))
    rows = np.arange(len(values))
    weights[rows, right - 1] = 1.0 - share
    weights[rows, right] = share
    return weights


@cache
def fitted_model() -> RoadUserModel:
    """Return the model that fbench ships."""
    content = json.loads(FITTED.read_text(encoding="utf-8"))
    by_feature = content["features"]
    return RoadUserModel(
        np.array(content["labels"], np.str_),
        tuple(np.array(by_feature[name]["knots"], np.float64) for name in FEATURES),
        tuple(np.array(by_feature[name]["log_odds"], np.float64) for name in FEATURES),
        np.array(content["offset"], np.float64),
    )
