"""Statistics as rows of numbers, so that many sums of the same ones are made at once."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from fractions import Fraction
from typing import Any, TypeVar

import numpy as np

from fbench.replay.arrays import Float64, Int64

S = TypeVar("S")
Number = int | Fraction


def weighted_sums(units: Sequence[S], total: S, times: Int64) -> Iterator[S] | None:
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


def _built(total: S, sums: Float64) -> Iterator[S]:
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
