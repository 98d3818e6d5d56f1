"""COCO's numbers as rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import fsum

from fbench.metrics.coco.curves import average_precision
from fbench.metrics.coco.rules import CocoRules
from fbench.metrics.coco.statistics import ClassStatistics, CocoStatistics, Outcome
from fbench.replay.arrays import Array, Int64
from fbench.replay.scores import Score

_NOTHING = "no truth boxes (pycocotools prints -1)"


@dataclass(frozen=True)
class Kind:
    """One of COCO's numbers."""

    name: str
    area: int
    """Index of the range of area."""
    thresholds: tuple[int, ...]
    """Indices of the thresholds that are averaged."""
    max_estimates: int
    is_recall: bool


def kinds(rules: CocoRules) -> list[Kind]:
    """Return the kinds of numbers in pycocotools' order: precisions, then recalls."""
    every, most = tuple(range(len(rules.thresholds))), rules.max_estimates[-1]
    single = [
        Kind(f"ap{round(100 * t)}", 0, (i,), most, False)
        for i, t in enumerate(rules.thresholds)
        if len(every) > 1 and round(100 * t) in (50, 75)
    ]
    areas = list(enumerate(rules.areas))
    return [
        Kind("ap", 0, every, most, False),
        *single,
        *(Kind(f"ap{area.name}", i, every, most, False) for i, area in areas[1:]),
        *(Kind(f"ar{num}", 0, every, num, True) for num in rules.max_estimates),
        *(Kind(f"ar{area.name}", i, every, most, True) for i, area in areas[1:]),
    ]


def rows(statistics: CocoStatistics, rules: CocoRules, classes: Sequence[str], part: str) -> list[Score]:
    """Return rows of the mean over classes, then the average precision of each class.

    Args:
        statistics: Of any sum of sequences.
        rules: By which they were taken.
        classes: In the order in which they are shown; empty: those that truth has, sorted.
        part: What the rows are about.
    """
    found = statistics.classes
    shown = [name for name in classes or sorted(found) if name in found and (classes or _has_truth(found[name]))]
    tables = [_Table(found[name], rules) for name in shown]
    wanted = kinds(rules)
    images = {
        "images": statistics.num_images,
        "invalid_truth": statistics.num_invalid_truth,
        "invalid_estimates": statistics.num_invalid_estimates,
    }
    means = [_mean_row(kind, rules, [t.cell(kind) for t in tables], images, part) for kind in wanted]
    own = [
        _row(kind, name, rules, table.cell(kind), {"images": statistics.num_images}, part)
        for name, table in zip(shown, tables, strict=True)
        for kind in wanted
        if kind.area == 0 and not kind.is_recall
    ]
    return means + own


@dataclass(frozen=True)
class _Cell:
    """One number of one class; `None` where undefined."""

    value: float | None
    counts: dict[str, int]


class _Table:
    """The ranking of one class, and the numbers that can be read from it."""

    def __init__(self, statistics: ClassStatistics, rules: CocoRules) -> None:
        self._statistics, self._rules = statistics, rules
        self._place, self._outcome = statistics.ranked()

    def cell(self, kind: Kind) -> _Cell:
        """Return one number with its raw counts: hits and false alarms are sums over the thresholds."""
        early: Array = self._place < kind.max_estimates
        outcome = self._outcome[kind.area][list(kind.thresholds)][:, early]
        truth = self._statistics.num_truth[kind.area]
        hits: Int64 = (outcome == Outcome.HIT).sum(axis=1)
        counts = {
            "truth": truth,
            "crowds": self._statistics.num_crowds,
            "estimates": int(early.sum()),
            "tp": int(hits.sum()),
            "fp": int((outcome == Outcome.FALSE_ALARM).sum()),
        }
        if not truth:
            return _Cell(None, counts)
        if kind.is_recall:
            return _Cell(fsum((hits / truth).tolist()) / len(hits), counts)
        precisions = [average_precision(o, truth, self._rules.num_recalls) for o in outcome]
        return _Cell(fsum(precisions) / len(precisions), counts)


def _mean_row(kind: Kind, rules: CocoRules, cells: list[_Cell], images: dict[str, int], part: str) -> Score:
    """The mean over the classes that have truth; their counts are summed."""
    values = [cell.value for cell in cells if cell.value is not None]
    names = ("truth", "crowds", "estimates", "tp", "fp")
    counts = {name: sum(cell.counts[name] for cell in cells) for name in names}
    mean = fsum(values) / len(values) if values else None
    return _row(kind, "all", rules, _Cell(mean, counts), {"classes": len(values), **images}, part)


def _row(kind: Kind, name: str, rules: CocoRules, cell: _Cell, images: dict[str, int], part: str) -> Score:
    reason = _NOTHING if cell.value is None else None
    return Score(kind.name, name, part, _matching(kind, rules), cell.value, reason, "1", {**cell.counts, **images})


def _matching(kind: Kind, rules: CocoRules) -> str:
    chosen = [rules.thresholds[i] for i in kind.thresholds]
    iou = f"{chosen[0]:g}" if len(chosen) == 1 else f"{chosen[0]:g}:{chosen[-1]:g}"
    area = rules.areas[kind.area]
    sizes = f", area {area.low_px2:g} to {area.high_px2:g} px2" if kind.area else ""
    return f"iou2d {iou}, {kind.max_estimates} an image{sizes}"


def _has_truth(statistics: ClassStatistics) -> bool:
    return statistics.num_truth[0] > 0 or statistics.num_crowds > 0
