"""The profile `nuscenes-tracking`: AMOTA, AMOTP and what CLEAR counts."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from math import fsum
from typing import ClassVar, Self

import numpy as np

from fbench.metrics.profiles.nuscenes.boxes import check_tracked, select_counted
from fbench.metrics.profiles.nuscenes.clips import Clip, TrackingStatistics, clips_of, track_points
from fbench.metrics.profiles.nuscenes.settings import TrackingSettings, center_distance
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.arrays import Float64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence as Sequence_of_sequence

UNITS = {
    "amota": "1", "amotp": "m", "recall": "1", "motar": "1", "gt": "1", "mota": "1", "motp": "m", "mt": "1", "ml": "1",
    "faf": "1", "tp": "1", "fp": "1", "fn": "1", "ids": "1", "frag": "1", "tid": "s", "lgd": "s",
}  # fmt: skip
"""The metrics and their units; `faf` is false positives per 100 samples."""


SUMMED = ("mt", "ml", "tp", "fp", "fn", "ids", "frag")
"""Over classes; all others are averaged, `gt` too (nuscenes-devkit 1.2.0, eval/tracking/data_classes.py)."""


@dataclass(frozen=True)
class ClassValues:
    """One class over all sequences."""

    num_truth: int  # Truth boxes, those filled in included
    num_reached: int  # Thresholds whose recall is reached
    threshold: float | None
    """Score from which on results are taken for all but AMOTA and AMOTP: the one of the best MOTA."""
    frames: int  # Samples with any box of the class at that score
    values: Mapping[str, float]  # All of `UNITS`


def class_values(clips: Sequence[Clip], settings: TrackingSettings) -> ClassValues:
    """Return the metrics of one class from its clips."""
    num_truth = sum(len(clip.near.truth_track) for clip in clips)
    if not num_truth:
        return ClassValues(0, 0, None, 0, dict.fromkeys(UNITS, np.nan))
    thresholds = _thresholds(clips, num_truth, settings)
    if not len(thresholds):  # what the devkit puts where no result ever matches
        values = dict.fromkeys(UNITS, 0.0)
        values |= dict.fromkeys(("fp", "ids", "frag"), np.nan) | {"gt": num_truth, "fn": num_truth}
        values |= {"motp": settings.worst_amotp_m, "amotp": settings.worst_amotp_m, "faf": settings.worst_faf}
        values |= {"tid": settings.worst_duration_s, "lgd": settings.worst_duration_s}
        values |= {"ml": sum(clip.num_truth_tracks for clip in clips)}
        return ClassValues(num_truth, 0, None, 0, values)
    counts, total_m = _sweep(clips, thresholds)
    metrics = _curves(counts, total_m, num_truth, settings)
    best = int(np.argmax(metrics["mota"]))  # the highest recall among equals
    values = {name: float(curve[best]) for name, curve in metrics.items()}
    values["amota"] = _mean(metrics["motar"], settings.worst_amota, settings)
    values["amotp"] = _mean(metrics["motp"], settings.worst_amotp_m, settings)
    return ClassValues(num_truth, len(thresholds), float(thresholds[best]), int(counts["frames"][best]), values)


def _thresholds(clips: Sequence[Clip], num_truth: int, settings: TrackingSettings) -> Float64:
    """Scores (T,) at which the recalls from `min_recall` to 1 would be reached, as far as they are; highest first.

    Interpolated between the scores of matches when all results are taken (nuscenes-devkit 1.2.0,
    eval/tracking/algo.py, `compute_thresholds`), so the recall at a threshold is another one.
    """
    score = np.sort(np.concatenate([clip.matched_score for clip in clips]))[::-1]
    if not len(score):
        return np.zeros(0)
    recall = np.arange(1, len(score) + 1) / num_truth
    wanted = np.linspace(settings.min_recall, 1, settings.num_thresholds).round(12)
    threshold: Float64 = np.interp(wanted[wanted <= recall[-1]], recall, score, right=0)[::-1].copy()
    return threshold


def _sweep(clips: Sequence[Clip], thresholds: Float64) -> tuple[dict[str, Float64], Float64]:
    """Counts (T,) of one class over all sequences by name, and the sum of the distances of all pairs (T,) [m]."""
    from fbench.metrics.profiles.nuscenes.kernels import COUNTS, sweep  # numba takes a while to import

    distinct, index = np.unique(thresholds, return_inverse=True)
    found = [sweep(distinct, clip.near, clip.num_truth_tracks) for clip in clips]
    counts = np.sum([own for own, _, _ in found], axis=0)[index].T.astype(np.float64)
    # Exact, so that the order of clips is no matter.
    total_m = np.array([fsum(column) for column in zip(*(own_m for _, own_m, _ in found), strict=True)])
    return dict(zip(COUNTS, counts, strict=True)), total_m[index]


def _curves(n: dict[str, Float64], total_m: Float64, num_truth: int, settings: TrackingSettings) -> dict[str, Float64]:
    """Each metric (T,) at the thresholds that are reached; nuscenes-devkit 1.2.0, eval/tracking/metrics.py."""
    recall = n["tp"] / num_truth  # for MOTAR, without switches
    wrong = n["fn"] + n["ids"] + n["fp"]
    motar = 1 - _share(wrong - (1 - recall) * num_truth, recall * num_truth)
    return {name: n[name] for name in ("tp", "ids", "fp", "fn", "mt", "ml", "frag")} | {
        "recall": (n["tp"] + n["ids"]) / num_truth,
        "motar": np.maximum(0.0, motar),  # keeps NaN
        "gt": np.full(len(recall), num_truth, np.float64),
        "mota": np.maximum(0.0, 1 - wrong / num_truth),
        "motp": _share(total_m, n["tp"] + n["ids"]),
        "faf": 100 * _share(n["fp"], n["frames"]),
        "tid": settings.sample_s * _share(n["late"], n["found"]),
        "lgd": settings.sample_s * _share(n["gap"], n["found"]),
    }


def _share(part: Float64, whole: Float64) -> Float64:
    share: Float64 = np.divide(part, whole, out=np.full(len(part), np.nan), where=whole != 0)
    return share


def _mean(curve: Float64, worst: float, settings: TrackingSettings) -> float:
    """Mean over all thresholds, with the worst value where one isn't reached or the metric is undefined."""
    if np.isnan(curve).all():
        return float("nan")
    missing = settings.num_thresholds - len(curve)
    return float(np.mean(np.append(np.full(missing, worst), np.where(np.isnan(curve), worst, curve))))


@dataclass(frozen=True)
class NuscenesTracking:
    """nuScenes' tracking benchmark (AMOTA, AMOTP and CLEAR at the best score) as nuscenes-devkit 1.2.0 counts it.

    A sequence is a scene, its steps are samples; boxes are in coordinates that don't move with the ego. Its quirks,
    which no other profile has: a box has the mean score of its track; tracks, of truth and results, are filled in at
    samples where they miss, from before and after, with weights the wrong way round; MOTA is floored at 0; what is
    averaged over recalls takes the worst value where a recall isn't reached.
    Where the devkit goes by the order in the file (two truth boxes that both want to go on with one track), this one
    goes by content. The devkit's distances lose digits far from the origin, by expanding the square; these don't.
    """

    settings: TrackingSettings = field(default_factory=TrackingSettings)
    name: str = "nuscenes-tracking"
    summary: str = "tracking_nips_2019 as nuscenes-devkit 1.2.0 with motmetrics 1.4.0 counts it"

    facts: ClassVar[Facts] = Facts(
        judges_tracks=True, space="3d", family="nuscenes-tracking", needs_ego=True, needs_time=True,
        headlines=Headlines(
            ("amota", "amotp", "recall", "motar", "mota", "motp", "mt", "ml", "faf", "tp", "fp", "fn", "ids", "frag",
             "tid", "lgd")
        ),
    )  # fmt: skip

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(self.settings.rules.classes)

    def with_match(self, match: Match) -> Self:
        """Return the profile with another distance. ConfigError where it isn't one of centers in the ground plane."""
        return replace(self, settings=replace(self.settings, distance_m=center_distance(self.name, match)))

    def measure(self, sequence: Sequence_of_sequence) -> TrackingStatistics:
        """Return what is near what in one sequence. Raises MetricError where it can't be scored: an id twice in a
        sample (GT003), boxes without track, no boxes in space, too many results.
        """
        truth, estimates, left_out = select_counted(sequence, self.settings.rules)
        check_tracked(sequence, "truth", truth.boxes)
        check_tracked(sequence, "a result", estimates.boxes)
        points = track_points(sequence, truth), track_points(sequence, estimates)
        num_steps, num_classes = len(sequence.steps), len(self.settings.rules.classes)
        clips = clips_of(sequence.name, *points, num_steps, num_classes, self.settings.distance_m)
        return TrackingStatistics(clips, left_out)

    def scores(self, statistics: TrackingStatistics, part: str) -> list[Score]:
        """Return all metrics over the classes, then of each class."""
        classes = {
            name: class_values([clip for clip in statistics.clips if clip.kind == kind], self.settings)
            for kind, name in enumerate(self.settings.rules.classes)
        }
        found = [one for one in classes.values() if one.num_truth]
        known = {m: [one.values[m] for one in found if not np.isnan(one.values[m])] for m in UNITS}
        sums = {name: int(sum(known[name])) for name in ("tp", "fp", "fn", "ids")}
        counts: dict[str, int | float] = {
            "gt": sum(one.num_truth for one in found),
            **sums,
            **asdict(statistics.left_out),
        }
        counts["classes_without_truth"] = len(classes) - len(found)

        def row(metric: str, class_: str, value: float, why: str, counts: Mapping[str, int | float]) -> Score:
            printed = 0 if class_ == "all" and metric in SUMMED else "nan"
            reason = f"{why} (nuscenes-devkit prints {printed})" if np.isnan(value) else None
            number = None if reason else float(value)
            return Score(metric, class_, part, self.settings.matching, number, reason, UNITS[metric], counts)

        why = "nothing matched in any class" if found else "no truth boxes"
        rows = []
        for metric, values in known.items():
            total = np.nan if not values else np.sum(values) if metric in SUMMED else np.mean(values)
            rows.append(row(metric, "all", float(total), why, counts))
        for name, one in classes.items():
            why = "nothing matched" if one.num_truth else "no truth boxes"
            own: dict[str, int | float] = {
                "gt": one.num_truth,
                "frames": one.frames,
                "recalls_reached": one.num_reached,
            }
            own |= {n: int(one.values[n]) for n in ("tp", "fp", "fn", "ids") if not np.isnan(one.values[n])}
            own |= {} if one.threshold is None else {"score": one.threshold}
            rows += [row(metric, name, one.values[metric], why, own) for metric in UNITS]
        return rows
