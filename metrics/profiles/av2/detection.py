"""The profile `av2`: composite detection score, AP by distance, and errors."""

from dataclasses import asdict, dataclass, replace
from typing import ClassVar, Self

import numpy as np

from fbench.metrics.core.similarity import blocks
from fbench.metrics.profiles.av2.boxes import CLASSES, LeftOut, Side, check_places, select_side
from fbench.metrics.profiles.nuscenes.boxes import content_order, solids
from fbench.metrics.profiles.nuscenes.ranking import NUM_RECALLS, ClassRanking, Ranking, class_rankings
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence

ERRORS = ("ate", "ase", "aoe")
UNITS = {"ate": "m", "ase": "1", "aoe": "rad"}
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class DetectionStatistics:
    """Rankings of any number of sequences; their order doesn't matter, because results have a total order."""

    parts: tuple[Ranking, ...]
    left_out: LeftOut

    def __add__(self, other: "DetectionStatistics") -> "DetectionStatistics":
        return DetectionStatistics(self.parts + other.parts, self.left_out + other.left_out)


def average_precision(hit: Bool, num_truth: int) -> float:
    """Area under the curve of results (M,), best score first: the best precision at or beyond each of 101 recalls.

    As `compute_average_precision` of av2-api 0.3.6: linear between the recalls of results, 0 beyond the last.
    """
    if not num_truth or not len(hit):
        return 0.0
    tp = np.cumsum(hit)
    precision = tp / (tp + np.cumsum(~hit) + _EPS)
    best = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.mean(np.interp(np.linspace(0, 1, NUM_RECALLS), tp / num_truth, best, right=0)))


def match_errors(truth: Objects, estimates: Objects) -> Float64:
    """Errors (K, 3) of K pairs, in the order of `ERRORS`: distance of the centers in space, 1 - overlap of sizes, and
    the smaller angle between the headings.

    The overlap of sizes is the product of the smaller extents over that of the larger ones, not the intersection over
    union of aligned boxes (av2-api 0.3.6, `geometry/iou.py`).
    """
    true, said = solids(truth), solids(estimates)
    smaller, larger = (pick(true.size_lwh_m, said.size_lwh_m).prod(axis=1) for pick in (np.minimum, np.maximum))
    turn = np.abs((said.yaw_rad - true.yaw_rad + np.pi) % (2 * np.pi) - np.pi)
    place = np.linalg.norm(said.center_m - true.center_m, axis=1)
    return np.stack([place, 1 - smaller / larger, turn], axis=1)


@dataclass(frozen=True)
class Av2Detection:
    """Argoverse 2's detection challenge as av2-api 0.3.6 counts it, without its region of interest
    (`eval_only_roi_instances=False`).

    Its quirks, which no other profile has: a result looks only at the nearest truth box, and takes it, however far off
    it is; a result with a lower score at the same box is a false positive even where the first one missed. Centers are
    compared in space, heights included. Of each class and sweep the 100 results with the best scores count. Errors are
    means over all hits within 2 m, at any score. Means over classes include the classes without truth, at their worst.

    Where av2-api goes by the order in the file (equal scores, truth at equal distances), this one goes by content.
    """

    distances_m: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)  # Boxes match below each of these distances
    error_distance_m: float = 2.0  # One of `distances_m`: hits at it have the errors that count
    range_m: float = 150.0  # From which on boxes don't count
    max_results: int = 100  # Of a class and sweep
    name: str = "av2"
    summary: str = "the detection challenge of Argoverse 2 as av2-api 0.3.6 counts it: CDS, AP, ATE, ASE, AOE"

    facts: ClassVar[Facts] = Facts(
        judges_tracks=False, space="3d", family="av2", ranks_by_file=True,
        headlines=Headlines(("cds", "map", "mate", "mase", "maoe", "mean_dist_ap", "ate", "ase", "aoe")),
    )  # fmt: skip

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(CLASSES)

    @property
    def worst(self) -> tuple[float, float, float]:
        """Errors of a class without hits, and what errors are divided by in CDS [m, 1, rad]."""
        return self.error_distance_m, 1.0, float(np.pi)

    def with_match(self, match: Match) -> Self:
        """Return the profile with one distance for AP and errors. ConfigError if not of centers in space."""
        if match.kind != "center3d":
            raise ConfigError(f"{self.name} matches by center distance in space only, such as center3d:2, not {match}")
        return replace(self, distances_m=(match.threshold,), error_distance_m=match.threshold)

    def measure(self, sequence: Sequence) -> DetectionStatistics:
        """Return what results hit. Raises MetricError where boxes have no place in space."""
        check_places(sequence)
        truth, estimates = (
            select_side(sequence, boxes[content_order(boxes)], self.range_m, in_plane=False)
            for boxes in (sequence.truth, sequence.estimates)
        )
        nobody = np.zeros(len(truth.kind), bool)
        ignored = nobody if truth.boxes.ignore is None else truth.boxes.ignore
        empty = nobody if truth.boxes.num_points is None else truth.boxes.num_points == 0
        asked = ~truth.invalid & ~ignored & ~empty
        limited, above = self._best(estimates)
        left_out = LeftOut(
            **estimates.left_out, **{f"{name}_truth": n for name, n in truth.left_out.items()},
            no_points_truth=int((empty & ~ignored).sum()), ignored_truth=int(ignored.sum()), above_limit=above,
            invalid=int(limited.invalid.sum()), invalid_truth=int(truth.invalid.sum()) + sequence.num_invalid_truth,
        )  # fmt: skip
        boxes, kind = truth.boxes[asked], truth.kind[asked]
        nearest, distance_m = _nearest(boxes, kind, limited)
        hit = distance_m[:, None] < np.array(self.distances_m)
        has_error = distance_m < self.error_distance_m
        step, score = limited.boxes.step, limited.boxes.score
        own = Ranking(
            sequence=sequence.name,
            num_truth=np.bincount(kind, minlength=len(CLASSES)),
            frame=sequence.steps.frame[step],
            place=np.arange(len(step)) - np.searchsorted(step, step),
            kind=limited.kind.astype(np.int8),
            score=np.where(np.isfinite(score), score, np.nan),
            hit=hit,
            error=match_errors(boxes[nearest[has_error]], limited.boxes[has_error]),
            has_error=has_error,
        )
        return DetectionStatistics((own,), left_out)

    def _best(self, side: Side) -> tuple[Side, int]:
        """Results with the best scores of each class and sweep, and how many are left out."""
        group = side.boxes.step * len(CLASSES) + side.kind
        score = np.where(np.isnan(side.boxes.score), np.inf, side.boxes.score)
        order = np.lexsort((-score, group))
        place = np.empty(len(group), np.int64)
        place[order] = np.arange(len(group)) - np.searchsorted(group[order], group[order])
        kept = place < self.max_results
        return Side(side.boxes[kept], side.kind[kept], side.invalid[kept], {}), int((~kept).sum())

    def scores(self, statistics: DetectionStatistics, part: str) -> list[Score]:
        """Return CDS, mAP and mean errors, then those of each class and AP at each distance."""
        rankings = class_rankings(statistics.parts, len(CLASSES))
        precisions = [
            np.array([average_precision(column, one.num_truth) for column in one.hit.T], np.float64) for one in rankings
        ]
        errors = [self._errors(one) for one in rankings]
        quality = [1 - np.mean(own / np.array(self.worst)) for own in errors]
        cds = [float(ap.mean() * share) for ap, share in zip(precisions, quality, strict=True)]
        num_found = sum(one.num_truth > 0 for one in rankings)
        counts = {
            "gt": sum(one.num_truth for one in rankings), "estimates": sum(len(one.score) for one in rankings),
            "classes_without_truth": len(rankings) - num_found, **asdict(statistics.left_out),
        }  # fmt: skip
        how, at = f"center3d {', '.join(f'{m:g}' for m in self.distances_m)} m", self._matching(self.error_distance_m)
        table = [
            ("cds", np.mean(cds), how, "1", 0.0),
            ("map", np.mean([ap.mean() for ap in precisions]), how, "1", 0.0),
        ]
        means = np.mean(errors, axis=0)
        table += [(f"m{e}", means[i], at, UNITS[e], self.worst[i]) for i, e in enumerate(ERRORS)]
        rows = [_row(m, "all", part, how, v, unit, worst, num_found, counts) for m, v, how, unit, worst in table]
        for name, one, ap, own, score in zip(CLASSES, rankings, precisions, errors, cds, strict=True):
            hits = one.hit.sum(axis=0).tolist()
            most, num = max(hits, default=0), hits[self.distances_m.index(self.error_distance_m)]
            own_table = [("cds", score, how, "1", 0.0, most), ("mean_dist_ap", ap.mean(), how, "1", 0.0, most)]
            own_table += [(e, own[i], at, UNITS[e], self.worst[i], num) for i, e in enumerate(ERRORS)]
            matchings = map(self._matching, self.distances_m)
            own_table += [("ap", v, m, "1", 0.0, tp) for v, m, tp in zip(ap, matchings, hits, strict=True)]
            for metric, value, matching, unit, worst, tp in own_table:
                of = {"gt": one.num_truth, "tp": tp, "fp": len(one.score) - tp, "fn": one.num_truth - tp}
                rows.append(_row(metric, name, part, matching, value, unit, worst, one.num_truth, of))
        return rows

    def _matching(self, distance_m: float) -> str:
        return str(Match("center3d", distance_m))

    def _errors(self, one: ClassRanking) -> Float64:
        """Mean errors (3,) over all hits; the worst where there is none, or no truth."""
        hits = ~np.isnan(one.error[:, 0])
        return one.error[hits].mean(axis=0) if one.num_truth and hits.any() else np.array(self.worst)


def _row(
    metric: str, class_: str, part: str, matching: str, value: float, unit: str, worst: float, num_truth: int,
    counts: dict[str, int],
) -> Score:  # fmt: skip
    reason = None if num_truth else f"no truth boxes (av2-api prints {worst:.4g})"
    return Score(metric, class_, part, matching, float(value) if num_truth else None, reason, unit, counts)


def _nearest(truth: Objects, kind: Int64, results: Side) -> tuple[Int64, Float64]:
    """Truth row (M,) that each result takes, and its distance [m]; -1 and infinite where it takes none.

    A result takes the nearest truth box of its class and sweep, unless one with a better score has taken it.
    """
    num = int(max(truth.step.max(initial=-1), results.boxes.step.max(initial=-1))) + 1
    sides, orders = [], []
    for boxes, own, invalid in ((truth, kind, None), (results.boxes, results.kind, results.invalid)):
        group, score = boxes.step * len(CLASSES) + own, boxes.score
        rows = np.arange(len(group)) if invalid is None else np.flatnonzero(~invalid)
        keys = (group[rows],) if invalid is None else (-score[rows], group[rows])
        orders.append(rows[np.lexsort(keys)])
        sides.append(replace(boxes[orders[-1]], step=group[orders[-1]]))
    nearest, distance_m = np.full(len(results.kind), -1), np.full(len(results.kind), np.inf)
    pairs = blocks(sides[0], sides[1], num * len(CLASSES), "center3d")
    for step in np.flatnonzero(np.diff(pairs.start)).tolist():
        similarity = pairs.block(step)
        row = similarity.argmax(axis=0)
        own, first = np.unique(row, return_index=True)
        place = orders[1][pairs.column_start[step] + first]
        nearest[place] = orders[0][pairs.row_start[step] + own]
        distance_m[place] = -similarity[own, first]
    return nearest, distance_m
