"""Confidence intervals by the percentile bootstrap."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from fractions import Fraction
from functools import reduce
from operator import add
from typing import Any, Generic, TypeVar

import numpy as np

from fbench.metrics.profiles.profile import Statistics
from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.scores import Score

Summed = TypeVar("Summed")
Number = int | Fraction


def weighted_sums(units: Sequence[Summed], total: Summed, times: Int64) -> Iterator[Summed] | None:
    """Return the sums in which unit u of U is `times[k, u]` (K, U) times; `None` where they must be added one by one.

    Statistics are dataclasses, tuples and mappings that hold ints and `Fraction`s. Where all are of one form, and the
    numbers of `total` are the sums of theirs, then so are those of any other sum. Sums of reals are rounded to floats:
    intervals don't need them exactly.
    """
    try:
        rows = [list(_numbers(unit)) for unit in units]
        if any(_form(unit) != _form(total) for unit in units):
            return None
        if [sum(column) for column in zip(*rows, strict=True)] != list(_numbers(total)):
            return None
    except _OtherError:
        return None
    table = np.array([[float(number) for number in row] for row in rows], np.float64)
    sums = np.zeros((len(times), table.shape[1]))
    for unit, row in enumerate(table):  # not a product of matrices: BLAS may round in another order
        sums += times[:, unit, None] * row
    return _built(total, sums)


class _OtherError(Exception):
    """Something that isn't added as numbers are."""


def _numbers(value: Any) -> Iterator[Number]:
    if isinstance(value, Fraction) or type(value) is int:
        yield value
    for _, part in _parts(value):
        yield from _numbers(part)


def _form(value: Any) -> object:
    """What it is but for its numbers."""
    if isinstance(value, Fraction) or type(value) is int:
        return type(value)
    parts = tuple((name, _form(part)) for name, part in _parts(value))
    if parts or is_dataclass(value) or isinstance(value, tuple | dict):
        return type(value), parts
    if isinstance(value, np.ndarray) and not value.size:
        return np.ndarray
    if value is None or isinstance(value, str | bool):
        return value
    raise _OtherError


def _parts(value: Any) -> list[tuple[str, Any]]:
    if is_dataclass(value):
        return [(field.name, getattr(value, field.name)) for field in fields(value)]
    if isinstance(value, dict):
        return [(repr(key), part) for key, part in value.items()]
    return [(str(i), part) for i, part in enumerate(value)] if isinstance(value, tuple) else []


def _built(total: Summed, sums: Float64) -> Iterator[Summed]:
    for row in sums.tolist():
        yield _filled(total, iter(row))


def _filled(value: Any, numbers: Iterator[float]) -> Any:
    """The same with other numbers."""
    if isinstance(value, Fraction):
        return Fraction(next(numbers))
    if type(value) is int:
        return round(next(numbers))
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: _filled(getattr(value, field.name), numbers) for field in fields(value)})
    if isinstance(value, dict):
        return {key: _filled(part, numbers) for key, part in value.items()}
    return tuple(_filled(part, numbers) for part in value) if isinstance(value, tuple) else value


S = TypeVar("S", bound=Statistics)
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
            raise ConfigError(
                f"bootstrap: {self.num} resamples, {self.share:g}: expected 1 or more, and a share in 0-1"
            )

    def times(self, num_units: int) -> Int64:
        """Return how often each unit (num, U) is in each resample; depends on the seed and the number of units only,
        so that numbers of the same units are resampled alike.
        """
        drawn = generator(self.seed, "bootstrap", num_units).integers(0, num_units, (self.num, num_units))
        return np.array([np.bincount(row, minlength=num_units) for row in drawn], np.int64)

    def said(self, num_units: int, unit: str) -> str:
        """Say how an interval was made."""
        return f"{100 * self.share:g} % of {self.num} bootstrap resamples of {num_units} {unit}"


@dataclass(frozen=True)
class Interval:
    """Between its ends lies the share of resamples that was asked for."""

    low: float
    high: float


def interval(
    statistics: Mapping[str, S], value: Callable[[S], float | None], how: Bootstrap, unit: str = "logs"
) -> Interval | str:
    """Return the interval of one number, or why there is none; see `intervals`."""
    return intervals(statistics, lambda total: {"": value(total)}, how, unit)[""]


def intervals(
    statistics: Mapping[str, S], values: Callable[[S], Mapping[str, float | None]], how: Bootstrap, unit: str = "logs"
) -> dict[str, Interval | str]:
    """Return the interval of each number, or why there is none.

    Units are drawn with replacement, as many as there are, and their statistics added, so that ratios are taken of
    sums, as in the number itself. The order in which units come doesn't matter.

    Args:
        statistics: Of each unit, by name: logs, sequences, segments.
        values: Numbers of a sum, by name; `None` where undefined.
        how: Seed and number of resamples.
        unit: What is drawn, for reasons.
    """
    names = values(reduce(add, statistics.values())) if statistics else {}
    units = [statistics[name] for name in sorted(statistics)]
    if len(units) < LEAST_UNITS:
        why = f"{len(units)} {unit}, at least {LEAST_UNITS} are needed"
        return dict.fromkeys(names, why)
    found: dict[str, list[float]] = {name: [] for name in names}
    draws, often = np.unique(how.times(len(units)), axis=0, return_counts=True)  # few units: many are alike
    for total, num in zip(_sums(units, draws), often.tolist(), strict=True):
        for name, value in values(total).items():
            if value is not None and name in found:
                found[name] += [value] * num
    return {name: _between(of, how) for name, of in found.items()}


def with_intervals(
    statistics: Mapping[str, S],
    rows_of: Callable[[S], Sequence[Score]],
    how: Bootstrap,
    unit: str,
    metrics: Iterable[str] | None = None,
) -> list[Score]:
    """Return the rows of all units added, with intervals: of these metrics, or of all.

    `rows_of` is called for every resample: a thousand times as long as it takes once.
    """
    rows = rows_of(reduce(add, (statistics[name] for name in sorted(statistics))))
    wanted = None if metrics is None else frozenset(metrics)

    def values(total: S) -> dict[str, float | None]:
        return {_key(row): row.value for row in rows_of(total) if wanted is None or row.metric in wanted}

    found = intervals(statistics, values, how, unit)
    return [_with(row, found.get(_key(row)), how.said(len(statistics), unit)) for row in rows]


def _with(row: Score, found: Interval | str | None, said: str) -> Score:
    if found is None or row.value is None:
        return row
    if isinstance(found, str):
        return replace(row, interval=found)
    return replace(row, low=found.low, high=found.high, interval=said)


def _key(row: Score) -> str:
    return f"{row.metric}\n{row.class_}\n{row.slice}\n{row.matching}"


def _between(values: Sequence[float], how: Bootstrap) -> Interval | str:
    missing = how.num - len(values)
    if missing > MOST_UNDEFINED * how.num:
        return f"undefined in {missing} of {how.num} resamples"
    rest = (1 - how.share) / 2
    low, high = np.quantile(np.array(values), [rest, 1 - rest]).tolist()
    return Interval(low, high)


def _sums(units: Sequence[S], draws: Int64) -> Iterator[S]:
    """Yield the sum of each draw (K, U)."""
    quick = weighted_sums(units, reduce(add, units), draws)
    sums = _Sums(units)
    return (sums.of(times) for times in draws.tolist()) if quick is None else quick


class _Sums(Generic[S]):
    """Sums of units, each any number of times; small sums come back often and are kept."""

    def __init__(self, units: Sequence[S]) -> None:
        self._groups = [units[first : first + _AT_ONCE] for first in range(0, len(units), _AT_ONCE)]
        self._kept: list[dict[tuple[int, ...], S]] = [{} for _ in self._groups]

    def of(self, times: Sequence[int]) -> S:
        """Return the sum in which each unit is so many times; at least one isn't 0."""
        parts = [self._part(at, tuple(times[at * _AT_ONCE :][:_AT_ONCE])) for at in range(len(self._groups))]
        return reduce(add, (part for part in parts if part is not None))

    def _part(self, at: int, times: tuple[int, ...]) -> S | None:
        if not any(times):
            return None
        kept = self._kept[at]
        if times not in kept:
            first = next(i for i, num in enumerate(times) if num)
            rest = self._part(at, (*times[:first], times[first] - 1, *times[first + 1 :]))
            unit = self._groups[at][first]
            kept[times] = unit if rest is None else rest + unit
        return kept[times]
