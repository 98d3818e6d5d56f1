"""Paired differences of ratios of counts: intervals, tests, and the smallest difference that the data could show."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy import special

from fbench.metrics.core.bootstrap import LEAST_UNITS, MOST_UNDEFINED, Bootstrap
from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Float64, Int64

Ratio = Callable[[Float64], Float64]
"""Makes values (...) of counts (..., K); NaN where undefined."""


@dataclass(frozen=True)
class ErrorRates:
    """How differences are judged."""

    alpha: float = 0.05  # Chance of any false alarm among all that gates together
    power: float = 0.9  # With which the smallest difference would be found
    num_resamples: int = 2000
    num_flips: int = 19_999  # Smallest p value 1/20000: enough for Holm over 1000
    seed: int = 0

    def __post_init__(self) -> None:
        if not (0 < self.alpha < 0.5 and 0 < self.power < 1 and self.num_resamples >= 100 and self.num_flips >= 100):
            raise ConfigError("expected 0 < alpha < 0.5, 0 < power < 1, and at least 100 resamples and flips")

    def least_units(self, num_judged: int) -> int:
        """Return of how many units on a test could find anything, judged together with `num_judged` in all: swapping U
        units gives no p value below 2^(1 - U).
        """
        return max(LEAST_UNITS, 1 + math.ceil(math.log2(max(num_judged, 1) / self.alpha)))


@dataclass(frozen=True)
class Inference:
    """What the data say of one difference, head minus base."""

    base: float | None
    head: float | None
    low: float | None = None  # 95 % interval of the difference
    high: float | None = None
    p: float | None = None  # Two-sided, that there is no difference
    std: float | None = None  # Standard error of the difference
    per_box: float = 0.0  # By how much the value changes with one box
    num_units: int = 0
    reason: str | None = None  # Why there is no interval

    @property
    def delta(self) -> float | None:
        """Head minus base; `None` where either is undefined."""
        return None if self.base is None or self.head is None else self.head - self.base

    def smallest(self, how: ErrorRates, num_judged: int) -> float | None:
        """Return the smallest true difference that would be found with `how.power` at `how.alpha`, judged together with
        `num_judged` in all; `None` where no difference could be: too few units.

        A difference S must exceed z standard errors, z = c + t(power). The test's limit c is n / sqrt(1 - n²/U) for
        the normal quantile n at alpha/2m, as swapping also spreads the difference itself over U units; at least
        t(1 - alpha/2m). Making S flips about S/b boxes, b what one is worth, which adds their own sampling error:
        S = z sqrt(std² + S b), solved for S.
        """
        if self.std is None or self.num_units < LEAST_UNITS:
            return None
        level = how.alpha / max(num_judged, 1)
        if 2.0 ** (1 - self.num_units) > level or 1 / (how.num_flips + 1) > level:
            return None
        normal, free = float(special.ndtri(1 - level / 2)), self.num_units - 1
        if normal * normal >= self.num_units:
            return None
        swapped = normal / float(np.sqrt(1 - normal**2 / self.num_units))
        limit = max(float(special.stdtrit(free, 1 - level / 2)), swapped)
        z = limit + float(special.stdtrit(free, how.power))
        linear = z * z * self.per_box
        return (linear + float(np.sqrt(linear * linear + 4 * z * z * self.std * self.std))) / 2


class PairedUnits:
    """Which units are drawn and swapped: the same ones for everything that is judged together.

    Units are scenes, or stretches of one: what is in one may depend on each other, but not on other units.
    """

    def __init__(self, num_units: int, how: ErrorRates) -> None:
        self.num_units, self._how = num_units, how

    @cached_property
    def _times(self) -> Float64:
        """(B, U) how often each unit is drawn."""
        return _times(self._how.seed, self._how.num_resamples, self.num_units)

    @cached_property
    def _signs(self) -> tuple[Float64, bool]:
        """(N, U) -1 where base and head of a unit are swapped; and whether that is all there is."""
        return _signs(self._how.seed, self._how.num_flips, self.num_units)

    def infer(self, base: Int64, head: Int64, value: Ratio) -> Inference:
        """Compare the values of the counts (U, K) of both sides, summed over units.

        - Interval: percentile bootstrap over units, with the levels widened for few units, and for changes that few of
          them make (Hesterberg 2015, "What Teachers Should Know About the Bootstrap", 5.3: expanded percentiles).
        - p: share of all swaps of base and head within units whose difference is at least as large. Exact where the two
          sides are exchangeable; else right for many units, as the test of signs of a mean.
        """
        a, b = (side.sum(axis=0, dtype=np.float64) for side in (base, head))
        values = [float(value(total)) for total in (a, b)]
        one, two = (v if np.isfinite(v) else None for v in values)
        if one is None or two is None:
            return Inference(one, two, num_units=self.num_units, reason="undefined")
        if self.num_units < LEAST_UNITS:
            why = f"{self.num_units} units, at least {LEAST_UNITS} are needed"
            return Inference(one, two, num_units=self.num_units, reason=why)
        per_box = _worth_of_one(b, value)
        if np.array_equal(base, head):
            return Inference(one, two, 0.0, 0.0, 1.0, 0.0, per_box, self.num_units)
        # Whole numbers in float64: exact in whatever order they are added.
        drawn = value(self._times @ head.astype(np.float64)) - value(self._times @ base.astype(np.float64))
        known = drawn[np.isfinite(drawn)]
        if len(known) < (1 - MOST_UNDEFINED) * len(drawn):
            why = f"undefined in {len(drawn) - len(known)} of {len(drawn)} resamples"
            return Inference(one, two, per_box=per_box, num_units=self.num_units, reason=why)
        low, high = np.quantile(known, _widen_levels(self._free(base, head, value), self.num_units)).tolist()
        few = float(np.sqrt(self.num_units / (self.num_units - 1)))
        std = float(known.std()) * few
        return Inference(one, two, low, high, self.test(base, head, value), std, per_box, self.num_units)

    def _free(self, base: Int64, head: Int64, value: Ratio) -> float:
        """Degrees of freedom of the variance of the difference, from the kurtosis of what units have a part in it, by
        leaving each out: U - 1 where that is normal, and fewer where few units make the change (Satterthwaite 1946).
        """
        a, b = (side.astype(np.float64) for side in (base, head))
        parts = value(b.sum(axis=0) - b) - value(a.sum(axis=0) - a)
        parts = parts[np.isfinite(parts)]
        away = (parts - parts.mean()) ** 2
        num = self.num_units
        if not away.any():
            return num - 1.0
        kurtosis = float((away * away).mean() / away.mean() ** 2)
        return float(np.clip(2 * num / max(kurtosis - (num - 3) / (num - 1), 1e-9), 2, num - 1))

    def test(self, base: Int64, head: Int64, value: Ratio) -> float | None:
        """Return the p value alone, see `infer`; `None` where either side is undefined."""
        total, change = (base + head).sum(axis=0, dtype=np.float64), (head - base).astype(np.float64)
        moved = change.sum(axis=0)
        delta = float(value((total + moved) / 2)) - float(value((total - moved) / 2))
        if not np.isfinite(delta):
            return None
        if not change.any():
            return 1.0
        signs, is_all = self._signs
        moved = signs @ change
        swapped = value((total + moved) / 2) - value((total - moved) / 2)
        num = int(np.count_nonzero(~(np.abs(swapped) < abs(delta) - 1e-12)))  # undefined counts as large
        return num / len(signs) if is_all else (num + 1) / (len(signs) + 1)


def _worth_of_one(total: Float64, value: Ratio) -> float:
    """How much one more of any of the counts (K,) changes the value."""
    moved = value(total + np.eye(len(total)))
    return float(np.nanmax(np.abs(moved - value(total)), initial=0.0))


def _widen_levels(free: float, num_units: int) -> list[float]:
    """Levels of the percentiles of a 95 % interval of a mean of few units, whose variance has so many degrees."""
    rest = (1 - Bootstrap().share) / 2
    wide = np.sqrt(num_units / (num_units - 1)) * special.stdtrit(free, rest)
    level = float(special.ndtr(wide))
    return [level, 1 - level]


@lru_cache(8)
def _times(seed: int, num: int, num_units: int) -> Float64:
    return Bootstrap(seed, num).times(num_units).astype(np.float64)


@lru_cache(8)
def _signs(seed: int, num: int, num_units: int) -> tuple[Float64, bool]:
    if 2**num_units <= num + 1:
        return np.array(list(itertools.product((1.0, -1.0), repeat=num_units)), np.float64), True
    drawn = generator(seed, "flips", num_units).integers(0, 2, (num, num_units))
    return np.asarray(1.0 - 2.0 * drawn, np.float64), False


def adjust_holm(p: Sequence[float]) -> list[float]:
    """Return p values adjusted for being judged together: the chance of any false alarm is kept (Holm 1979)."""
    order = np.argsort(p, kind="stable")
    stepped = np.array(p)[order] * np.arange(len(p), 0, -1)
    return _unsort(np.minimum(np.maximum.accumulate(stepped), 1.0), order)


def adjust_discoveries(p: Sequence[float]) -> list[float]:
    """Return p values adjusted such that the share of false ones among what is found is kept (Benjamini, Hochberg
    1995).
    """
    order = np.argsort(p, kind="stable")
    stepped = np.array(p)[order] * len(p) / np.arange(1, len(p) + 1)
    return _unsort(np.minimum(np.minimum.accumulate(stepped[::-1])[::-1], 1.0), order)


def _unsort(values: Float64, order: Int64) -> list[float]:
    found = np.empty(len(values))
    found[order] = values
    return [float(v) for v in found]
