"""Confidence intervals by the percentile bootstrap."""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from fractions import Fraction
from functools import cache, reduce
from operator import add
from typing import Any, TypeVar

import numpy as np

from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Statistics
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.scores import Score

Summed = TypeVar("Summed")


def sum_weighted(units: Sequence[Summed], total: Summed, times: Int64) -> Iterator[Summed] | None:
    """Return the sums in which unit u of U is `times[k, u]` (K, U) times; `None` where they must be added one by one.

    Statistics are dataclasses, tuples and mappings that hold ints and `Fraction`s. Where all are of one form, and the
    numbers of `total` are the sums of theirs, then so are those of any other sum. Sums of reals are rounded to floats:
    intervals don't need them exactly.
    """
    try:
        (form, numbers), *parts = map(_split, (total, *units))
    except _NotAddedError:
        return None
    if any(own != form for own, _ in parts) or numbers != list(map(sum, zip(*(row for _, row in parts), strict=True))):
        return None
    sums = np.zeros((len(times), len(numbers)))
    for unit, (_, row) in enumerate(parts):  # not a product of matrices: BLAS may round in another order
        sums += times[:, unit, None] * np.array([float(number) for number in row])
    return (_fill(total, iter(row)) for row in sums.tolist())


class _NotAddedError(Exception):
    """Something that isn't added as numbers are."""


def _split(value: Any) -> tuple[object, list[int | Fraction]]:
    """Return what a value is but for its numbers, and these in their order."""
    if isinstance(value, Fraction) or type(value) is int:
        return type(value), [value]
    if value is None or isinstance(value, str | bool):
        return value, []
    if isinstance(value, np.ndarray) and not value.size:
        return np.ndarray, []
    if is_dataclass(value):
        parts = {field.name: _split(getattr(value, field.name)) for field in fields(value)}
    elif isinstance(value, dict):
        parts = {repr(key): _split(part) for key, part in value.items()}
    elif isinstance(value, tuple):
        parts = {str(i): _split(part) for i, part in enumerate(value)}
    else:
        raise _NotAddedError
    form = type(value), tuple((name, own) for name, (own, _) in parts.items())
    return form, [number for _, numbers in parts.values() for number in numbers]


def _fill(value: Any, numbers: Iterator[float]) -> Any:
    """The same with other numbers."""
    if isinstance(value, Fraction):
        return Fraction(next(numbers))
    if type(value) is int:
        return round(next(numbers))
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: _fill(getattr(value, field.name), numbers) for field in fields(value)})
    if isinstance(value, dict):
        return {key: _fill(part, numbers) for key, part in value.items()}
    return tuple(_fill(part, numbers) for part in value) if isinstance(value, tuple) else value


S = TypeVar("S", bound=Statistics)
Key = TypeVar("Key", bound=Hashable)
LEAST_UNITS = 5  # Of fewer, resamples are too few different ones to say anything
MOST_UNDEFINED = 0.05  # Share of resamples in which a number may be undefined; they are left out
_AT_ONCE = 3  # Units whose sums are kept by how often each was drawn


@dataclass(frozen=True)
class Bootstrap:
    """How resamples are drawn (Efron and Tibshirani 1993, 13.3: percentile intervals)."""

    seed: int = 0
    num: int = 1000
    share: float = 0.95  # Of resamples between the ends of an interval

    def __post_init__(self) -> None:
        if self.num < 1 or not 0 < self.share < 1:
            own = f"{self.num} resamples, {self.share:g}"
            raise ConfigError(f"bootstrap: {own}: expected 1 or more, and a share in 0-1")

    def times(self, num_units: int) -> Int64:
        """Return how often each unit (num, U) is in each resample: the same for one seed and number of units."""
        drawn = generator(self.seed, "bootstrap", num_units).integers(0, num_units, (self.num, num_units))
        return np.array([np.bincount(row, minlength=num_units) for row in drawn], np.int64)

    def interval(self, resamples: Float64 | None) -> tuple[float, float] | tuple[None, None]:
        """Return the ends of the interval of a number by its resamples (num,), NaN or left out where it is undefined;
        none where there are none, or too many are undefined.
        """
        own = np.zeros(0) if resamples is None else resamples[np.isfinite(resamples)]
        if not len(own) or self.num - len(own) > MOST_UNDEFINED * self.num:
            return None, None
        rest = (1 - self.share) / 2
        low, high = np.quantile(own, [rest, 1 - rest]).tolist()
        return low, high


@dataclass(frozen=True)
class Interval:
    """Between its ends lies the share of resamples that was asked for."""

    low: float
    high: float


def intervals(
    statistics: Mapping[str, S], values: Callable[[S], Mapping[Key, float | None]], how: Bootstrap, unit: str = "logs"
) -> dict[Key, Interval | str]:
    """Return the interval of each number, or why there is none.

    Units are drawn with replacement, as many as there are, and their statistics added, so that ratios are taken of
    sums, as in the number itself. The order in which units come doesn't matter.

    `statistics` are those of each unit by name: logs, sequences, segments, which `unit` says in reasons. `values` are
    the numbers of a sum by key; `None` where undefined.
    """
    names = values(reduce(add, statistics.values())) if statistics else {}
    units = [statistics[name] for name in sorted(statistics)]
    if len(units) < LEAST_UNITS:
        return dict.fromkeys(names, f"{len(units)} {unit}, at least {LEAST_UNITS} are needed")
    found: dict[Key, list[float]] = {name: [] for name in names}
    draws, often = np.unique(how.times(len(units)), axis=0, return_counts=True)  # few units: many are alike
    sums = sum_weighted(units, reduce(add, units), draws) or _add_one_by_one(units, draws)
    for total, num in zip(sums, often.tolist(), strict=True):
        for name, value in values(total).items():
            if value is not None and name in found:
                found[name] += [value] * num
    result: dict[Key, Interval | str] = {}
    for name, own in found.items():
        low, high = how.interval(np.array(own))
        if low is None or high is None:
            result[name] = f"undefined in {how.num - len(own)} of {how.num} resamples"
        else:
            result[name] = Interval(low, high)
    return result


def with_intervals(
    statistics: Mapping[str, S], rows_of: Callable[[S], Sequence[Score]], how: Bootstrap, unit: str,
    metrics: Sequence[str] | None = None,
) -> list[Score]:  # fmt: skip
    """Return the rows of all units added, with intervals: of these metrics, or of all.

    `rows_of` is called for every resample: a thousand times as long as it takes once.
    """

    def values(total: S) -> dict[tuple[str, str, str, str], float | None]:
        return {row.key: row.value for row in rows_of(total) if metrics is None or row.metric in metrics}

    found = intervals(statistics, values, how, unit)
    made = f"{100 * how.share:g} % of {how.num} bootstrap resamples of {len(statistics)} {unit}"
    rows = []
    for row in rows_of(reduce(add, (statistics[name] for name in sorted(statistics)))):
        own = None if row.value is None else found.get(row.key)
        if isinstance(own, Interval):
            rows.append(replace(row, low=own.low, high=own.high, interval=made))
        else:
            rows.append(row if own is None else replace(row, interval=own))
    return rows


def _add_one_by_one(units: Sequence[S], draws: Int64) -> Iterator[S]:
    """Yield the sum of each draw (K, U); sums of a few units come back often and are kept."""
    groups = [units[first : first + _AT_ONCE] for first in range(0, len(units), _AT_ONCE)]

    @cache
    def add_group(at: int, times: tuple[int, ...]) -> S | None:
        if not any(times):
            return None
        first = next(i for i, num in enumerate(times) if num)
        rest = add_group(at, (*times[:first], times[first] - 1, *times[first + 1 :]))
        return groups[at][first] if rest is None else rest + groups[at][first]

    for times in draws.tolist():
        sums = [add_group(at, tuple(times[at * _AT_ONCE :][:_AT_ONCE])) for at in range(len(groups))]
        yield reduce(add, (part for part in sums if part is not None))
