"""The profile `coco`."""

from dataclasses import dataclass, field, replace
from math import fsum
from typing import ClassVar, Self

import numpy as np

from fbench.metrics.profiles.coco.measure import ClassStatistics, CocoRules, CocoStatistics, Outcome, measure
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.arrays import Array, Int64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence


def average_precision(outcome: Array, num_truth: int, num_recalls: int) -> float:
    """Mean of the best precision at or beyond each of `num_recalls` recalls from 0 to 1, 101 in COCO; 0 where none is
    reached. `outcome` (M,) are `Outcome`s of estimates, the best score first; `num_truth`, boxes to be found, is above
    0.
    """
    hits, counted = np.cumsum(outcome == Outcome.HIT), np.cumsum(outcome != Outcome.IGNORED)
    precision = np.append(hits / np.maximum(counted, 1), 0.0)
    best = np.maximum.accumulate(precision[::-1])[::-1]
    reached = np.searchsorted(hits / num_truth, np.linspace(0, 1, num_recalls), side="left")
    return float(best[reached].mean())


@dataclass(frozen=True)
class Kind:
    """One of COCO's numbers."""

    name: str
    area: int  # Index of the range of area
    thresholds: tuple[int, ...]  # Indices of the thresholds that are averaged
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


_COUNTS = ("truth", "crowds", "estimates", "tp", "fp")


def _cell(
    kind: Kind, rules: CocoRules, statistics: ClassStatistics, place: Int64, outcome: Array
) -> tuple[float | None, dict[str, int]]:
    """One number of one class, `None` where undefined, and raw counts: hits and false alarms summed over thresholds."""
    early: Array = place < kind.max_estimates
    own, truth = outcome[kind.area][list(kind.thresholds)][:, early], statistics.num_truth[kind.area]
    hits, alarms = (own == Outcome.HIT).sum(axis=1), int((own == Outcome.FALSE_ALARM).sum())
    numbers = (truth, statistics.num_crowds, int(early.sum()), int(hits.sum()), alarms)
    counts = dict(zip(_COUNTS, numbers, strict=True))
    if not truth:
        return None, counts
    shares = (
        (hits / truth).tolist() if kind.is_recall else [average_precision(o, truth, rules.num_recalls) for o in own]
    )
    return fsum(shares) / len(shares), counts


@dataclass(frozen=True)
class CocoProfile:
    """Average precision and recall of boxes in images as pycocotools 2.0.11 counts them (`COCOeval`, `bbox`).

    - Each step is an image; rankings of all images and sequences are pooled.
    - In an image the estimates of one class choose truth by score, up to 100; a truth box of the wrong size is
      ignored, as is an estimate of the wrong size that matches nothing; crowds (truth with `ignore`) excuse any number
      of estimates that lie in them by more than the threshold.
    - `ap`: mean over classes, 10 thresholds and 101 recalls of the best precision at or beyond each recall.
      `ar100`: mean over classes and thresholds of the recall with up to 100 estimates of a class in an image.
    - `aps`, `apm`, `apl`: boxes up to 32 x 32 px, 96 x 96 px, and larger ones.

    The area of truth is that of its box (COCO's files may say another, from a mask). Where pycocotools lets the order
    in the files decide, content does: equal scores stand by sequence, frame, camera, then rectangle; of truth boxes
    that an estimate overlaps equally the one with the lower left edge is taken, then the lower top edge.
    """

    rules: CocoRules = field(default_factory=CocoRules)
    classes: tuple[str, ...] = ()  # Labels that count; empty: all that truth has
    name: str = "coco"
    summary: str = "average precision and recall in images, as pycocotools 2.0.11 (bbox)"

    facts: ClassVar[Facts] = Facts(
        judges_tracks=False, space="2d", ranks_by_file=True,
        headlines=Headlines(("ap", "ap50", "ap75", "aps", "apm", "apl", "ar1", "ar10", "ar100", "ars", "arm", "arl")),
    )  # fmt: skip

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(self.classes)

    def with_match(self, match: Match) -> Self:
        """Return the profile with a single threshold. Raises ConfigError where it isn't an overlap in images."""
        if match.kind != "iou2d":
            raise ConfigError(f"profile coco: can't match by {match.kind}, use iou2d")
        return replace(self, rules=replace(self.rules, thresholds=(match.threshold,)))

    def measure(self, sequence: Sequence) -> CocoStatistics:
        """Return outcomes of the estimates of one sequence.

        Estimates that aren't finite or have a negative size are false alarms, such truth is left out and counted.
        Raises MetricError where boxes have no rectangles in images.
        """
        return measure(sequence, self.rules, self.classes)

    def scores(self, statistics: CocoStatistics, part: str) -> list[Score]:
        """Return COCO's twelve numbers over the classes that have truth, then average precisions of each class.

        Counts of the means are summed. Classes are shown in the profile's order, else those that truth has, sorted.
        """
        rules, classes = self.rules, self.classes
        found, wanted = statistics.classes, kinds(rules)
        shown = [name for name in classes or sorted(found) if name in found]
        shown = [name for name in shown if classes or found[name].num_truth[0] or found[name].num_crowds]
        ranked = {name: found[name].rank() for name in shown}
        cells = {(name, kind): _cell(kind, rules, found[name], *ranked[name]) for kind in wanted for name in shown}

        def row(kind: Kind, class_: str, value: float | None, counts: dict[str, int]) -> Score:
            chosen, area = [rules.thresholds[i] for i in kind.thresholds], rules.areas[kind.area]
            iou = f"{chosen[0]:g}" if len(chosen) == 1 else f"{chosen[0]:g}:{chosen[-1]:g}"
            sizes = f", area {area.low_px2:g} to {area.high_px2:g} px2" if kind.area else ""
            reason = "no truth boxes (pycocotools prints -1)" if value is None else None
            matching = f"iou2d {iou}, {kind.max_estimates} an image{sizes}"
            return Score(kind.name, class_, part, matching, value, reason, "1", counts)

        result = []
        for kind in wanted:
            values = [value for name in shown if (value := cells[name, kind][0]) is not None]
            sums = (sum(cells[name, kind][1][count] for name in shown) for count in _COUNTS)
            counts = {
                **dict(zip(_COUNTS, sums, strict=True)), "classes": len(values), "images": statistics.num_images,
                "invalid_truth": statistics.num_invalid_truth, "invalid_estimates": statistics.num_invalid_estimates,
            }  # fmt: skip
            result.append(row(kind, "all", fsum(values) / len(values) if values else None, counts))
        for name in shown:
            for kind in wanted:
                if kind.area == 0 and not kind.is_recall:
                    value, own = cells[name, kind]
                    result.append(row(kind, name, value, {**own, "images": statistics.num_images}))
        return result
