"""NDS, mAP, AP and errors as rows."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from fbench.metrics.nuscenes.curves import average_precision, mean_errors, precision_curve
from fbench.metrics.nuscenes.errors import ERRORS, UNDEFINED, UNITS
from fbench.metrics.nuscenes.ranking import ClassRanking, DetectionStatistics, class_rankings
from fbench.metrics.nuscenes.settings import DetectionSettings
from fbench.metrics.profile import Match
from fbench.replay.arrays import Float64
from fbench.replay.scores import Score

NO_TRUTH = "no truth boxes"


@dataclass(frozen=True, eq=False)
class _Class:
    """One class as the devkit counts it: where it has no truth, AP is 0 and the errors are 1."""

    name: str
    ranking: ClassRanking
    ap: Float64
    """(D,)"""
    errors: Float64
    """(5,) NaN where the benchmark defines none."""

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
