"""Verdicts on all numbers of a comparison, with error rates controlled over what is judged together."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Literal

import numpy as np

from fbench.metrics.comparison.cells import OTHER, CellPair, add_units
from fbench.metrics.comparison.counts import Place, metrics_of
from fbench.metrics.comparison.inference import ErrorRates, Inference, PairedUnits, adjust_discoveries, adjust_holm
from fbench.metrics.core.slices import VEHICLE
from fbench.metrics.definitions.catalog import DEFINITIONS, Better
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.data.comparison import Row, Verdict
from fbench.replay.data.scores import Score

DECISIVE = ("f1", "mota")
_ROUNDING = 1e-12  # 0.80 - 0.79 is a little more than 0.01 in binary
Key = tuple[str, str, str, str]  # Metric, class, slice, matching


@dataclass(frozen=True)
class Rule:
    """What a number must keep; names may be patterns such as `range *`."""

    metric: str
    class_: str = VEHICLE.name
    slice: str = "all"
    condition: str = "*"
    pipeline: str = "*"
    space: Literal["own", "all"] = "own"  # The pipeline's own space, or also the image
    kind: Literal["absolute", "relative", "statistical"] = "absolute"
    """How a loss is judged: by the number itself, as a share of the base's, or by a test."""
    tolerance: float = (
        0.0  # Largest loss that passes, in the number's unit or as a share; of a test, what counts as same
    )
    least: float | None = None  # The head's number must be at least this
    most: float | None = None

    def __post_init__(self) -> None:
        if not self.tolerance >= 0:
            raise ConfigError(f"tolerance {self.tolerance}: expected a number from 0 on")

    def holds_for(self, group: tuple[str, str], key: Key, own: str) -> bool:
        """Tell whether it is about a number of a pipeline and condition, whose own space is `own`. Where pipelines
        differ, that of the head counts.
        """
        names = (group[0].rpartition(OTHER)[2], group[1], *key[:3])
        patterns = (self.pipeline, self.condition, self.metric, self.class_, self.slice)
        fits = all(name == p or fnmatchcase(name, p) for name, p in zip(names, patterns, strict=True))
        return fits and (self.space == "all" or key[3] == own)

    def __str__(self) -> str:
        loss = f"{100 * self.tolerance:g} %" if self.kind == "relative" else f"{self.tolerance:g}"
        bounds = [f"at least {self.least:g}"] if self.least is not None else []
        bounds += [f"at most {self.most:g}"] if self.most is not None else []
        return ", ".join([f"{self.kind}, tolerance {loss}", *bounds])


def default_rules(tolerance: float) -> tuple[Rule, ...]:
    """Return what gates where no policy says: F1 and MOTA may not fall by more than the tolerance."""
    return tuple(Rule(metric, tolerance=tolerance) for metric in DECISIVE)


@dataclass(frozen=True)
class _Number:
    """One number of both sides before it is judged."""

    group: tuple[str, str]
    key: Key
    unit: str
    base: float | None
    head: float | None
    why: str | None  # Why a side has no value
    sides: tuple[bool, bool]  # Which sides have such a row at all
    rule: Rule | None
    found: Inference
    is_identical: bool

    @property
    def delta(self) -> float | None:
        return None if self.base is None or self.head is None else self.head - self.base


@dataclass(frozen=True, eq=False)
class Judge:
    """Judges pairs of cells by rules."""

    rules: Sequence[Rule]
    how: ErrorRates = field(default_factory=ErrorRates)
    informs: bool = True  # Whether numbers without a rule are judged, too
    _units: dict[int, PairedUnits] = field(default_factory=dict)

    def judge(self, pairs: Sequence[CellPair]) -> tuple[list[Row], list[Rule]]:
        """Return all numbers with their verdicts, pipeline by pipeline and condition by condition; and the rules that
        are about none of them that has a value. Of several rules for one number the first counts. Raises MetricError
        where the two sides have neither F1 nor MOTA in common, or nothing was measured.
        """
        groups: dict[tuple[str, str], list[CellPair]] = {}
        for pair in pairs:
            groups.setdefault((pair.name.pipeline, pair.name.condition), []).append(pair)
        numbers = [number for group, own in groups.items() for number in self._numbers(group, own)]
        gating = [n for n in numbers if n.rule is not None and n.rule.kind == "statistical" and n.found.p is not None]
        informing = [n for n in numbers if n.rule is None and n.found.p is not None]
        p = dict(zip(map(id, gating), adjust_holm([n.found.p or 0.0 for n in gating]), strict=True))
        p |= zip(map(id, informing), adjust_discoveries([n.found.p or 0.0 for n in informing]), strict=True)
        rows = [self._row(number, p.get(id(number), number.found.p), max(len(gating), 1)) for number in numbers]
        used = {id(number.rule) for number in numbers if number.base is not None or number.head is not None}
        return rows, [rule for rule in self.rules if id(rule) not in used]

    def _numbers(self, group: tuple[str, str], pairs: Sequence[CellPair]) -> Iterator[_Number]:
        before, after = ({s.key: s for s in side} for side in _scores(pairs))
        own = _own_space(group, pairs, before, after)
        places = _places(pairs)
        for key in {**before, **after}:
            one, other = before.get(key), after.get(key)
            rule = next((rule for rule in self.rules if rule.holds_for(group, key, own)), None)
            a, b = (None if score is None else score.value for score in (one, other))
            found = Inference(a, b, reason="no test of this metric")
            if a is not None and b is not None and (rule is not None or self.informs):
                found = self._infer(key, places, pairs, found)
            why = next((s.reason for s in (other, one) if s is not None and s.reason), None)
            unit = next(score.unit for score in (other, one) if score)
            same = all(pair.is_identical for pair in pairs)
            yield _Number(group, key, unit, a, b, why, (one is not None, other is not None), rule, found, same)

    def _infer(self, key: Key, places: Mapping[Key, Place], pairs: Sequence[CellPair], without: Inference) -> Inference:
        place = places.get(key)
        if all(pair.is_identical for pair in pairs):
            return Inference(without.base, without.head, 0.0, 0.0, 1.0, reason=None)
        if place is None or (units := add_units(pairs, place)) is None:
            return without
        paired = self._units.setdefault(len(units[0]), PairedUnits(len(units[0]), self.how))
        return paired.infer(*units, metrics_of(place)[key[0]])

    def _row(self, n: _Number, p: float | None, num_gating: int) -> Row:
        found, gate, num = n.found, "" if n.rule is None else str(n.rule), num_gating if n.rule is not None else 1
        verdict, reason = _judge(n, p, self.how, num)
        smallest = found.smallest(self.how, num)
        return Row(
            *n.group, *n.key, n.unit, n.base, n.head, n.delta, verdict, gate, reason, found.low, found.high, smallest,
            p, found.num_units, better(n.key[0], n.unit),
        )  # fmt: skip


def _judge(n: _Number, p: float | None, how: ErrorRates, num_judged: int) -> tuple[Verdict, str]:
    if n.base is None or n.head is None:
        return _judge_missing(n)
    if n.rule is not None and (out := _out_of_bounds(n.rule, n.head)):
        return "REGRESSED", out
    if n.is_identical:
        return "identical", "outputs have equal digests"
    delta = n.head - n.base
    wanted = better(n.key[0], n.unit)
    gain = -delta if wanted == "lower" else delta
    if n.rule is not None and n.rule.kind != "statistical":
        return _judge_by_threshold(n, n.rule, gain, wanted, p)
    tolerance = 0.0 if n.rule is None else n.rule.tolerance
    if n.found.low is None or n.found.high is None or p is None:
        if delta == 0:
            return "same", "equal"
        return "INCONCLUSIVE", n.found.reason or "no interval"
    if p < how.alpha and abs(delta) > tolerance + _ROUNDING:
        if wanted == "neither":
            return "changed", f"p = {p:.2g}"
        return ("improved" if gain > 0 else "REGRESSED"), f"p = {p:.2g} after correction"
    if -tolerance - _ROUNDING <= n.found.low and n.found.high <= tolerance + _ROUNDING:
        return "same", "the interval is within the tolerance"
    return "INCONCLUSIVE", _explain_doubt(n.found.low, n.found.high, tolerance, p, n.found, how, num_judged)


def _explain_doubt(
    low: float, high: float, tolerance: float, p: float, found: Inference, how: ErrorRates, num_judged: int
) -> str:
    interval, num = f"the interval {low:+.3f} to {high:+.3f}", found.num_units
    if num < (least := how.least_units(num_judged)):
        far = "reaches beyond the tolerance" if low <= tolerance and high >= -tolerance else "is beyond the tolerance"
        return f"{interval} {far}, but {num} stretches or scenes are too few to show any change; {least} or more can"
    smallest = found.smallest(how, num_judged)
    shows = "" if smallest is None else f"; this much data shows changes from {smallest:.3f} on"
    if low <= tolerance and high >= -tolerance:
        return f"{interval} reaches beyond the tolerance{shows}"
    few = f"{num} stretches or scenes are too few to be sure"
    return f"{interval} is beyond the tolerance, but p = {p:.2g} after correction: {few}{shows}"


def _judge_missing(n: _Number) -> tuple[Verdict, str]:
    has_base, has_head = n.sides
    if n.base is None:
        return ("null" if has_base else "new"), n.why or "only head has it"
    why = n.why or "head has no such number"
    if n.rule is not None:  # Where nothing was measured, nothing is as good as before
        return "REGRESSED", f"nothing was measured: {why}"
    return ("null" if has_head else "gone"), why


def _out_of_bounds(rule: Rule, head: float) -> str | None:
    if rule.least is not None and head < rule.least - _ROUNDING:
        return f"{head:.4g} is less than {rule.least:g}"
    if rule.most is not None and head > rule.most + _ROUNDING:
        return f"{head:.4g} is more than {rule.most:g}"
    return None


def _judge_by_threshold(n: _Number, rule: Rule, gain: float, wanted: Better, p: float | None) -> tuple[Verdict, str]:
    scale = abs(n.base or 0.0) if rule.kind == "relative" else 1.0
    limit = rule.tolerance * scale + _ROUNDING
    if abs(gain) <= limit:
        return "same", "the change is within the tolerance"
    if wanted == "neither":
        return "changed", "it is neither good nor bad"
    doubt = "" if p is None or p < ErrorRates().alpha else f"; chance could do this (p = {p:.2g})"
    return ("improved" if gain > 0 else "REGRESSED"), f"beyond the tolerance{doubt}"


def better(metric: str, unit: str) -> Better:
    """Return which way is better; a distance is an error, whatever the metric is in another unit."""
    if unit == "m":
        return "lower"
    return DEFINITIONS[metric].better if metric in DEFINITIONS else "higher"


def _places(pairs: Sequence[CellPair]) -> dict[Key, Place]:
    """Where the counts of each key are; empty where all cells are identical, which needs no counts."""
    if all(pair.is_identical for pair in pairs):
        return {}
    held = (place for pair in pairs for side in (pair.base, pair.head) for place in side.stretches.counts)
    return {(metric, *place[1:]): place for place in dict.fromkeys(held) for metric in metrics_of(place)}


def _scores(pairs: Sequence[CellPair]) -> tuple[Sequence[Score], Sequence[Score]]:
    """Rows of both sides: of one cell its own, of several those of the sums of their counts."""
    if len(pairs) == 1:
        return pairs[0].base.scores, pairs[0].head.scores
    return _sum_scores(pairs, lambda pair: pair.base.scores, 0), _sum_scores(pairs, lambda pair: pair.head.scores, 1)


def _sum_scores(pairs: Sequence[CellPair], scores_of: Callable[[CellPair], Sequence[Score]], side: int) -> list[Score]:
    """Rows of the sums over cells. A row of which no cell has a value stays without one, with its reason."""
    sums: dict[Key, Score] = {}
    counts: dict[Place, list[int]] = {}
    for pair in pairs:
        own = (pair.base, pair.head)[side].stretches.counts
        for place, rows in own.items():
            total = rows.sum(axis=0).tolist()
            counts[place] = [a + b for a, b in zip(counts.get(place, [0] * len(total)), total, strict=True)]
    for pair in pairs:
        for score in scores_of(pair):
            before = sums.get(score.key)
            if before is None or (before.value is None and score.value is not None):
                sums[score.key] = score
    found = []
    values = {}
    for place, total in counts.items():
        for metric, ratio in metrics_of(place).items():
            value = float(ratio(np.array(total, np.float64)))
            values[metric, *place[1:]] = value
    for key, score in sums.items():
        if key in values:
            value = values[key]
            has = np.isfinite(value) and score.value is not None
            found.append(
                replace(
                    score,
                    value=value if has else None,
                    reason=None if has else score.reason or "undefined",
                    counts={},
                    low=None,
                    high=None,
                    interval=None,
                )
            )
    return found


def _own_space(
    group: tuple[str, str], pairs: Sequence[CellPair], before: Mapping[Key, Score], after: Mapping[Key, Score]
) -> str:
    """Matching in the pipeline's own space: that of the first primary row. Raises MetricError where nothing decisive
    was measured in both.
    """
    firsts = [next((s for s in scores.values() if s.metric in DECISIVE), None) for scores in (before, after)]
    primary = [k for k in before if k[0] in DECISIVE and firsts[0] and k[1:] == firsts[0].key[1:]]
    where = f"{pairs[0].name}: " if len(pairs) > 1 or group[1] != "clear" else ""
    if firsts[0] is None or not any(key in after for key in primary):
        names = [f"{s.metric} of {s.class_} ({s.matching})" if s else "neither f1 nor mota" for s in firsts]
        raise MetricError(
            f"{where}nothing to compare: base has {names[0]}, head has {names[1]}; "
            "score both with the same options, and compare 3D with 3D, 2D with 2D"
        )
    if all(before[key].value is None for key in primary):
        why = before[primary[0]].reason
        advice = "fbench score RUN --truth FILE adds truth to a run, and --reference base compares without any"
        raise MetricError(f"{where}nothing to compare: base has no value of f1 or mota ({why}); {advice}")
    return firsts[0].matching
