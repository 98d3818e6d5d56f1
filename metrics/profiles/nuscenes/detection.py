"""The profile `nuscenes-detection`: NDS, mAP, AP and errors."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import ClassVar, Self

import numpy as np

from fbench.metrics.profiles.nuscenes import ranking
from fbench.metrics.profiles.nuscenes.boxes import centers_xy, select_counted, sort_groups
from fbench.metrics.profiles.nuscenes.ranking import (
    ERRORS,
    UNDEFINED,
    UNITS,
    ClassRanking,
    DetectionStatistics,
    Ranking,
)
from fbench.metrics.profiles.nuscenes.settings import DetectionSettings, center_distance
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.arrays import Float64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

_PRINTS = "no truth boxes (nuscenes-devkit prints {})"


def _overall_rows(
    settings: DetectionSettings, rankings: list[ClassRanking], precisions: list[Float64], errors: list[Float64],
    left_out: Mapping[str, int], part: str,
) -> list[Score]:  # fmt: skip
    mean_ap, means = float(np.mean([ap.mean() for ap in precisions])), np.nanmean(errors, axis=0)
    quality = np.maximum(0.0, 1.0 - means).sum()
    nds = (settings.map_weight * mean_ap + quality) / (settings.map_weight + len(ERRORS))
    num_found = sum(one.num_truth > 0 for one in rankings)
    counts = {
        "gt": sum(one.num_truth for one in rankings), "estimates": sum(len(one.score) for one in rankings),
        "classes_without_truth": len(rankings) - num_found, **left_out,
    }  # fmt: skip
    how = settings.error_matching
    table = [("nds", nds, settings.matching, "1", f"{nds:g}"), ("map", mean_ap, settings.matching, "1", "0")]
    table += [(f"m{name}", own, how, UNITS[name], "1") for name, own in zip(ERRORS, means, strict=True)]
    rows = []
    for metric, value, how, unit, prints in table:
        reason = None if num_found else _PRINTS.format(prints)
        rows.append(Score(metric, "all", part, how, float(value) if num_found else None, reason, unit, counts))
    return rows


def _class_rows(
    settings: DetectionSettings, name: str, one: ClassRanking, ap: Float64, errors: Float64, part: str
) -> list[Score]:
    hits = one.hit.sum(axis=0).tolist()
    table = [("mean_dist_ap", ap.mean(), settings.matching, "1", "0", max(hits, default=0))]
    bev = [str(Match("bev", distance_m)) for distance_m in settings.distances_m]
    table += [("ap", own, how, "1", "0", num) for own, how, num in zip(ap, bev, hits, strict=True)]
    how, num = settings.error_matching, hits[settings.error_index]
    table += [(error, own, how, UNITS[error], "1", num) for error, own in zip(ERRORS, errors, strict=True)]
    rows = []
    for metric, value, how, unit, prints, tp in table:
        reason = None if one.num_truth else _PRINTS.format(prints)
        if np.isnan(value):
            reason = f"not defined for {name} (nuscenes-devkit prints nan)"
        counts = {"gt": one.num_truth, "tp": tp, "fp": len(one.score) - tp, "fn": one.num_truth - tp}
        rows.append(Score(metric, name, part, how, float(value) if reason is None else None, reason, unit, counts))
    return rows


@dataclass(frozen=True)
class NuscenesDetection:
    """nuScenes' detection benchmark (AP by center distance, five errors, NDS) as nuscenes-devkit 1.2.0 counts it.

    A sequence is a scene, its steps are samples; boxes are in coordinates that don't move with the ego. Where the
    devkit goes by the order in the file (equal scores, truth at equal distances), this one goes by content.
    """

    settings: DetectionSettings = field(default_factory=DetectionSettings)
    name: str = "nuscenes-detection"
    summary: str = "detection_cvpr_2019 as nuscenes-devkit 1.2.0 counts it"

    facts: ClassVar[Facts] = Facts(
        judges_tracks=False, space="3d", family="nuscenes", needs_ego=True, ranks_by_file=True,
        headlines=Headlines(
            ("nds", "map", "mate", "mase", "maoe", "mave", "maae", "mean_dist_ap", "ate", "ase", "aoe", "ave", "aae")
        ),
    )  # fmt: skip

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(self.settings.rules.classes)

    def with_match(self, match: Match) -> Self:
        """Return the profile with one distance for AP and errors. ConfigError if not of centers on the ground."""
        distance_m = center_distance(self.name, match)
        settings = replace(self.settings, distances_m=(distance_m,), error_distance_m=distance_m)
        return replace(self, settings=settings)

    def measure(self, sequence: Sequence) -> DetectionStatistics:
        """Return what results hit. MetricError: id twice in a sample (GT003), no boxes in space, too many results."""
        from fbench.metrics.profiles.nuscenes.kernels import match_nearest  # numba takes a while to import

        truth, estimates, left_out = select_counted(sequence, self.settings.rules)
        num_classes, num_steps = len(self.settings.rules.classes), len(sequence.steps)
        rows, truth_start = sort_groups(truth, num_classes, num_steps)
        order, start = sort_groups(estimates, num_classes, num_steps, by_score=True)  # in which estimates choose
        truth_xy, xy = centers_xy(truth)[rows], centers_xy(estimates)[order]
        limits_m = np.array(self.settings.distances_m, np.float64)
        partner = match_nearest(truth_xy, truth_start, xy, start, estimates.invalid[order], limits_m)
        of_error = np.append(rows, -1)[partner[:, self.settings.error_index]]
        has_error, step, score = of_error >= 0, estimates.boxes.step[order], estimates.boxes.score[order]
        error = np.zeros((0, len(ERRORS)))
        if has_error.any():
            error = ranking.match_errors(truth.boxes[of_error[has_error]], estimates.boxes[order[has_error]])
        own = Ranking(
            sequence=sequence.name,
            num_truth=np.bincount(truth.kind, minlength=num_classes),
            frame=sequence.steps.frame[step],
            place=order - np.searchsorted(estimates.boxes.step, step),
            kind=estimates.kind[order].astype(np.int8),
            score=np.where(np.isfinite(score), score, np.nan),
            hit=partner >= 0,
            error=error,
            has_error=has_error,
        )
        return DetectionStatistics((own,), left_out)

    def scores(self, statistics: DetectionStatistics, part: str) -> list[Score]:
        """Return NDS, mAP and mean errors, then AP and errors of each class.

        A class counts as in the devkit: where it has no truth, AP is 0 and the errors are 1; NaN where none is defined.
        """
        settings = self.settings
        names, at = settings.rules.classes, settings.error_index
        rankings = ranking.class_rankings(statistics.parts, len(names))
        precisions, errors = [], []
        for name, one in zip(names, rankings, strict=True):
            curves = [ranking.precision_curve(one.score, hit, one.num_truth) for hit in one.hit.T]
            limits = settings.min_recall, settings.min_precision
            precisions.append(np.array([ranking.average_precision(c.precision, *limits) for c in curves], np.float64))
            errors.append(ranking.mean_errors(one, one.hit[:, at], curves[at], settings.min_recall))
            errors[-1][[ERRORS.index(error) for error in UNDEFINED.get(name, ())]] = np.nan
        rows = _overall_rows(settings, rankings, precisions, errors, asdict(statistics.left_out), part)
        for name, one, ap, own in zip(names, rankings, precisions, errors, strict=True):
            rows += _class_rows(settings, name, one, ap, own, part)
        return rows
