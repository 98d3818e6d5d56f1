"""The profile `nuscenes-detection`: NDS, mAP, AP and errors."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Self

import numpy as np

from fbench.metrics.profiles.nuscenes.boxes import Counted, centers_xy, select_counted, sort_groups
from fbench.metrics.profiles.nuscenes.ranking import (
    ERRORS,
    UNDEFINED,
    UNITS,
    ClassRanking,
    DetectionStatistics,
    Ranking,
    average_precision,
    class_rankings,
    match_errors,
    mean_errors,
    precision_curve,
)
from fbench.metrics.profiles.nuscenes.settings import DetectionSettings, center_distance
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

NO_TRUTH = "no truth boxes"


@dataclass(frozen=True, eq=False)
class _Class:
    """One class as the devkit counts it: where it has no truth, AP is 0 and the errors are 1."""

    name: str
    ranking: ClassRanking
    ap: Float64  # (D,)
    errors: Float64  # (5,) NaN where the benchmark defines none

    @property
    def has_truth(self) -> bool:
        return self.ranking.num_truth > 0


def detection_rows(settings: DetectionSettings, statistics: DetectionStatistics, part: str) -> list[Score]:
    """Return NDS, mAP and mean errors, then AP and errors of each class."""
    rankings = class_rankings(statistics, len(settings.rules.classes))
    classes = [_measured(settings, name, r) for name, r in zip(settings.rules.classes, rankings, strict=True)]
    rows = _overall_rows(settings, classes, asdict(statistics.left_out), part)
    for one in classes:
        rows += _class_rows(settings, one, part)
    return rows


def _measured(settings: DetectionSettings, name: str, ranking: ClassRanking) -> _Class:
    curves = [precision_curve(ranking.score, hit, ranking.num_truth) for hit in ranking.hit.T]
    ap = [average_precision(curve.precision, settings.min_recall, settings.min_precision) for curve in curves]
    at = settings.error_index
    errors = mean_errors(ranking, ranking.hit[:, at], curves[at], settings.min_recall)
    errors[[ERRORS.index(error) for error in UNDEFINED.get(name, ())]] = np.nan
    return _Class(name, ranking, np.array(ap, np.float64), errors)


def _overall_rows(
    settings: DetectionSettings, classes: list[_Class], left_out: Mapping[str, int], part: str
) -> list[Score]:
    mean_ap = float(np.mean([one.ap.mean() for one in classes]))
    errors = np.nanmean([one.errors for one in classes], axis=0)
    quality = np.maximum(0.0, 1.0 - errors).sum()
    nds = (settings.map_weight * mean_ap + quality) / (settings.map_weight + len(ERRORS))
    found = [one for one in classes if one.has_truth]
    counts = {
        "gt": sum(one.ranking.num_truth for one in classes),
        "estimates": sum(len(one.ranking.score) for one in classes),
        "classes_without_truth": len(classes) - len(found),
        **left_out,
    }

    def row(metric: str, value: float, matching: str, unit: str, prints: str) -> Score:
        reason = None if found else f"{NO_TRUTH} (nuscenes-devkit prints {prints})"
        return Score(metric, "all", part, matching, value if found else None, reason, unit, counts)

    rows = [
        row("nds", float(nds), settings.matching, "1", f"{nds:g}"),
        row("map", mean_ap, settings.matching, "1", "0"),
    ]
    for name, value in zip(ERRORS, errors, strict=True):
        rows.append(row(f"m{name}", float(value), settings.error_matching, UNITS[name], "1"))
    return rows


def _class_rows(settings: DetectionSettings, one: _Class, part: str) -> list[Score]:
    def row(metric: str, value: float, matching: str, unit: str, prints: str, hits: int) -> Score:
        reason = None if one.has_truth else f"{NO_TRUTH} (nuscenes-devkit prints {prints})"
        if np.isnan(value):
            reason = f"not defined for {one.name} (nuscenes-devkit prints nan)"
        counts = _counts(one.ranking, hits)
        return Score(metric, one.name, part, matching, value if reason is None else None, reason, unit, counts)

    hits = one.ranking.hit.sum(axis=0)
    rows = [row("mean_dist_ap", float(one.ap.mean()), settings.matching, "1", "0", int(hits.max(initial=0)))]
    for d, distance_m in enumerate(settings.distances_m):
        rows.append(row("ap", float(one.ap[d]), str(Match("bev", distance_m)), "1", "0", int(hits[d])))
    at = int(hits[settings.error_index])
    for name, value in zip(ERRORS, one.errors, strict=True):
        rows.append(row(name, float(value), settings.error_matching, UNITS[name], "1", at))
    return rows


def _counts(ranking: ClassRanking, tp: int) -> dict[str, int]:
    return {"gt": ranking.num_truth, "tp": tp, "fp": len(ranking.score) - tp, "fn": ranking.num_truth - tp}


_FACTS = Facts(
    judges_tracks=False, space="3d", family="nuscenes", needs_ego=True, ranks_by_file=True,
    headlines=Headlines(
        ("nds", "map", "mate", "mase", "maoe", "mave", "maae", "mean_dist_ap", "ate", "ase", "aoe", "ave", "aae")
    ),
)  # fmt: skip


@dataclass(frozen=True)
class NuscenesDetection:
    """nuScenes' detection benchmark (AP by center distance, five errors, NDS) as nuscenes-devkit 1.2.0 counts it.

    A sequence is a scene, its steps are samples; boxes are in coordinates that don't move with the ego. Where the
    devkit goes by the order in the file (equal scores, truth at equal distances), this one goes by content.
    """

    settings: DetectionSettings = field(default_factory=DetectionSettings)
    name: str = "nuscenes-detection"
    summary: str = "detection_cvpr_2019 as nuscenes-devkit 1.2.0 counts it"

    @property
    def facts(self) -> Facts:
        """What it judges, and what it needs for that."""
        return _FACTS

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(self.settings.rules.classes)

    def with_match(self, match: Match) -> Self:
        """Return the profile with one distance for AP and errors. Raises ConfigError where it isn't a distance between
        centers in the ground plane.
        """
        distance_m = center_distance(self.name, match)
        settings = replace(self.settings, distances_m=(distance_m,), error_distance_m=distance_m)
        return replace(self, settings=settings)

    def measure(self, sequence: Sequence) -> DetectionStatistics:
        """Return what each result of one sequence hit. Raises MetricError where it can't be scored: an id twice in a
        sample (GT003), no boxes in space, too many results.
        """
        boxes = select_counted(sequence, self.settings.rules)
        order, partner = self._matches(boxes, len(sequence.steps))
        return DetectionStatistics((self._ranking(sequence, boxes, order, partner),), boxes.left_out)

    def scores(self, statistics: DetectionStatistics, part: str) -> list[Score]:
        """Return NDS, mAP and mean errors, then AP and errors of each class."""
        return detection_rows(self.settings, statistics, part)

    def _matches(self, boxes: Counted, num_steps: int) -> tuple[Int64, Int64]:
        """Return the order (M,) in which estimates choose, and the truth row (M, D) of each in that order, or -1."""
        from fbench.metrics.profiles.nuscenes.kernels import match_nearest  # numba takes a while to import

        num_classes = len(self.settings.rules.classes)
        rows, truth_start = sort_groups(boxes.truth, num_classes, num_steps)
        order, estimate_start = sort_groups(boxes.estimates, num_classes, num_steps, by_score=True)
        truth_xy, estimate_xy = centers_xy(boxes.truth)[rows], centers_xy(boxes.estimates)[order]
        limits_m = np.array(self.settings.distances_m, np.float64)
        invalid = boxes.estimates.invalid[order]
        partner = match_nearest(truth_xy, truth_start, estimate_xy, estimate_start, invalid, limits_m)
        return order, np.append(rows, -1)[partner]

    def _ranking(self, sequence: Sequence, boxes: Counted, order: Int64, partner: Int64) -> Ranking:
        step = boxes.estimates.boxes.step[order]
        score = boxes.estimates.boxes.score[order]
        of_error = partner[:, self.settings.error_index]
        has_error = of_error >= 0
        return Ranking(
            sequence=sequence.name,
            num_truth=np.bincount(boxes.truth.kind, minlength=len(self.settings.rules.classes)),
            frame=sequence.steps.frame[step],
            place=order - np.searchsorted(boxes.estimates.boxes.step, step),
            kind=boxes.estimates.kind[order].astype(np.int8),
            score=np.where(np.isfinite(score), score, np.nan),
            hit=partner >= 0,
            error=_errors(boxes, of_error[has_error], order[has_error]),
            has_error=has_error,
        )


def _errors(boxes: Counted, truth: Int64, estimates: Int64) -> Float64:
    if not len(truth):
        return np.zeros((0, len(ERRORS)))
    return match_errors(boxes.truth.boxes[truth], boxes.estimates.boxes[estimates])
