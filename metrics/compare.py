"""Two runs side by side: what became better, what worse, and whether that is a regression."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from fbench.metrics.cards.card import Better
from fbench.metrics.cards.catalog import CARDS
from fbench.replay.errors import ConfigError, MetricError
from fbench.replay.scores import Score

Verdict = Literal["same", "better", "worse", "changed", "gone", "new", "null"]
"""`changed`: of a number that is neither good nor bad."""
Key = tuple[str, str, str, str]

_DECISIVE = ("f1", "mota")
_ROUNDING = 1e-12
"""0.80 - 0.79 is a little more than 0.01 in binary."""


@dataclass(frozen=True)
class Row:
    """One number of both runs."""

    metric: str
    class_: str
    slice: str
    matching: str
    unit: str
    base: float | None
    head: float | None
    delta: float | None
    """`head - base`, where both have a value."""
    verdict: Verdict
    primary: bool
    """Whether it decides about regression."""


@dataclass(frozen=True)
class Comparison:
    """All rows, the base's order first."""

    rows: tuple[Row, ...]
    tolerance: float

    @property
    def regressed(self) -> bool:
        """Whether a primary number fell by more than the tolerance, or lost its value."""
        return any(row.primary and (row.verdict in ("worse", "gone") or _lost(row)) for row in self.rows)


def compare(base: Sequence[Score], head: Sequence[Score], tolerance: float) -> Comparison:
    """Compare the scores of two runs.

    Primary are F1 and MOTA (higher is better) of the base's first row: its class, slice and matching.

    Args:
        base: What is compared with, primary rows first.
        head: What is judged.
        tolerance: Change up to which a number counts as the same, in the number's unit.

    Raises:
        ConfigError: where the tolerance isn't a number from 0 on.
        MetricError: where the two have no primary row in common, so that nothing can be said.
    """
    if not tolerance >= 0:
        raise ConfigError(f"tolerance {tolerance}: expected a number from 0 on")
    before, after = {_key(s): s for s in base}, {_key(s): s for s in head}
    primary = _primary(base)
    if not any(key in after for key in primary):
        raise MetricError(
            f"nothing to compare: base has {_name(base)}, head has {_name(head)}; "
            "score both with the same options, and compare 3D with 3D, 2D with 2D"
        )
    if all(before[key].value is None for key in primary):
        raise MetricError(f"nothing to compare: base has no value of f1 or mota ({before[primary[0]].reason})")
    keys = [*before, *(key for key in after if key not in before)]
    rows = tuple(_row(key, before.get(key), after.get(key), key in primary, tolerance) for key in keys)
    return Comparison(rows, tolerance)


def _key(score: Score) -> Key:
    return score.metric, score.class_, score.slice, score.matching


def _primary(base: Sequence[Score]) -> tuple[Key, ...]:
    first = next((s for s in base if s.metric in _DECISIVE), None)
    return tuple(_key(s) for s in base if first and s.metric in _DECISIVE and _key(s)[1:] == _key(first)[1:])


def _name(scores: Sequence[Score]) -> str:
    first = next((s for s in scores if s.metric in _DECISIVE), None)
    return f"{first.metric} of {first.class_} ({first.matching})" if first else "neither f1 nor mota"


def _row(key: Key, base: Score | None, head: Score | None, primary: bool, tolerance: float) -> Row:
    a, b = (base.value if base else None), (head.value if head else None)
    delta = None if a is None or b is None else b - a
    unit = next(score.unit for score in (head, base) if score)
    return Row(*key, unit, a, b, delta, _verdict(base, head, delta, tolerance), primary)


def _verdict(base: Score | None, head: Score | None, delta: float | None, tolerance: float) -> Verdict:
    if base is None:
        return "new"
    if head is None:
        return "gone"
    if delta is None:
        return "null"
    if abs(delta) <= tolerance + _ROUNDING:
        return "same"
    wanted = _wanted(head)
    if wanted == "neither":
        return "changed"
    return "better" if (delta < 0) == (wanted == "lower") else "worse"


def _wanted(score: Score) -> Better:
    """Which values are better; a distance is an error, whatever the metric is in another unit."""
    if score.unit == "m" or score.metric not in CARDS:
        return "lower" if score.unit == "m" else "higher"
    return CARDS[score.metric].better


def _lost(row: Row) -> bool:
    return row.base is not None and row.head is None
