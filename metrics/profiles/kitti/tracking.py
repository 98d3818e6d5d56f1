"""The profile `kitti-3dmot`: 3D tracking on KITTI as AB3DMOT's evaluation counts it."""

import math
from collections.abc import Mapping
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from typing import Self

from fbench.metrics.profiles.kitti.track_passes import (
    ALL_RESULTS,
    Pass,
    Passes,
    TrackClass,
    TrackRules,
    TrackTable,
    run_passes,
    track_table,
)
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

_NO_TRUTH = "no truth boxes that count (AB3DMOT prints {})"
_Value = tuple[str, float | None, str, str]  # Metric, value, unit, and why it is undefined


@dataclass(frozen=True)
class Totals:
    """What doesn't depend on the threshold."""

    num_frames: int
    num_truth_tracks: int
    num_result_tracks: int
    num_bad_truth: int
    num_bad_results: int

    @classmethod
    def of(cls, tables: Many[TrackTable]) -> "Totals":
        """Add up tables."""
        return cls(
            sum(t.num_frames for t in tables),
            sum(t.num_truth_tracks for t in tables),
            sum(len(t.track_size) for t in tables),
            sum(t.num_bad_truth for t in tables),
            sum(t.num_bad_results for t in tables),
        )


def track_scores(tables: Many[TrackTable], label: str, rules: TrackRules, part: str) -> list[Score]:
    """Return the rows of one class, averages over recall first."""
    passes, totals = run_passes(tables, rules.num_recalls), Totals.of(tables)
    counts = _counts(passes.best, totals)
    values = [*_averages(passes, rules.num_recalls), *_best(passes.best, totals), *_print_counts(passes.best, totals)]
    return [
        Score(metric, label, part, str(rules.match), value, None if value is not None else why, unit, own)
        for (metric, value, unit, why), own in zip(values, _own(passes, rules, counts, len(values)), strict=True)
    ]


def _own(passes: Passes, rules: TrackRules, counts: Mapping[str, int | float], num: int) -> list[Mapping[str, float]]:
    """Counts of each row: those of the averages say how many recalls were reached."""
    reached = {"recalls": rules.num_recalls, "reached": len(passes.recalls), "gt": passes.best.gt}
    return [reached] * 3 + [counts] * (num - 3)


def _averages(passes: Passes, num_recalls: int) -> list[_Value]:
    """Recalls that weren't reached count 0. Sums go from the lowest recall on, as AB3DMOT adds.

    Recalls are those of all truth, ignored boxes too, so that without truth that counts there can be an AMOTP.
    """
    has_truth, is_reached = passes.best.gt > 0, bool(passes.recalls)
    why = _NO_TRUTH.format("-inf" if is_reached else "0, then stops")
    values = (
        ("samota", has_truth, sum(p.smota or 0.0 for p in passes.recalls), "1"),
        ("amota", has_truth, sum(p.mota or 0.0 for p in passes.recalls), "1"),
        ("amotp", has_truth or is_reached, sum(p.motp for p in passes.recalls), "IoU"),
    )
    return [(name, total / num_recalls if is_known else None, unit, why) for name, is_known, total, unit in values]


def _best(best: Pass, totals: Totals) -> list[_Value]:
    """Ratios at the best threshold; MOTA and MODA aren't clipped."""
    no_truth, detected = _NO_TRUTH.format("-inf"), best.tp + best.fp
    num_tracks = totals.num_truth_tracks - best.ignored_tracks
    log_ids = math.log10(best.ids) if best.ids else 0.0
    no_match, no_track = "no result matches (AB3DMOT prints 0)", "no truth tracks that count (AB3DMOT prints 0)"
    no_object, no_result = "no truth boxes (AB3DMOT prints 0)", "no results (AB3DMOT prints 0)"
    empty = no_object if not best.tp + best.fn else no_result
    return [
        ("mota", best.mota, "1", no_truth),
        ("motp", _ratio(best.likeness, best.tp), "IoU", no_match),
        ("motal", _rest(best.fn + best.fp + log_ids, best.gt), "1", no_truth),
        ("moda", _rest(best.fn + best.fp, best.gt), "1", no_truth),
        ("modp", _ratio(best.frame_likeness, totals.num_frames), "IoU", "no frames (AB3DMOT prints n/a)"),
        ("recall", _ratio(best.tp, best.tp + best.fn), "1", no_object),
        ("precision", _ratio(best.tp, detected), "1", no_result),
        ("f1", _ratio(2 * best.tp, 2 * best.tp + best.fn + best.fp), "1", empty),
        ("far", _ratio(best.fp, totals.num_frames), "1/frame", "no frames (AB3DMOT prints n/a)"),
        ("mt", _ratio(best.mt, num_tracks), "1", no_track),
        ("pt", _ratio(best.pt, num_tracks), "1", no_track),
        ("ml", _ratio(best.ml, num_tracks), "1", no_track),
        _threshold(best, totals),
    ]


def _threshold(best: Pass, totals: Totals) -> _Value:
    """AB3DMOT's number for all results is no score."""
    is_score = totals.num_result_tracks > 0 and best.threshold != ALL_RESULTS
    all_count = f"no threshold has a MOTA above 0, so all results count (AB3DMOT takes {ALL_RESULTS:g})"
    why = all_count if totals.num_result_tracks else "no results"
    return "best_threshold", best.threshold if is_score else None, "score", why


def _print_counts(best: Pass, totals: Totals) -> list[_Value]:
    """Counts that AB3DMOT prints at the best threshold."""
    ignored_truth = best.itp + best.ifn
    named = {
        "ids": best.ids, "frag": best.frag, "tp": best.tp, "itp": best.itp, "fp": best.fp, "fn": best.fn,
        "ifn": best.ifn, "gt_objects": best.gt + ignored_truth, "ignored_gt_objects": ignored_truth,
        "gt_tracks": totals.num_truth_tracks, "tracker_objects": best.results,
        "ignored_tracker_objects": best.ignored_results, "tracker_tracks": totals.num_result_tracks,
    }  # fmt: skip
    return [(name, float(count), "1", "") for name, count in named.items()]


def _counts(best: Pass, totals: Totals) -> Mapping[str, int | float]:
    return {
        "tp": best.tp, "itp": best.itp, "fp": best.fp, "fn": best.fn, "ifn": best.ifn, "ids": best.ids,
        "frag": best.frag, "mt": best.mt, "pt": best.pt, "ml": best.ml, "gt": best.gt, "frames": totals.num_frames,
        "gt_tracks": totals.num_truth_tracks, "ignored_gt_tracks": best.ignored_tracks,
        "iou_sum": best.likeness, "frame_iou_sum": best.frame_likeness,
        "invalid_truth": totals.num_bad_truth, "invalid_results": totals.num_bad_results,
    }  # fmt: skip


def _ratio(top: float, bottom: int) -> float | None:
    return top / bottom if bottom else None


def _rest(top: float, bottom: int) -> float | None:
    return 1 - top / bottom if bottom else None


_RULES = TrackRules(Match("iou3d", 0.25))
_CLASSES = (TrackClass("car", "van"), TrackClass("pedestrian", "person_sitting"), TrackClass("cyclist"))


@dataclass(frozen=True)
class TrackStatistics:
    """Tables of sequences, those of the profile's classes each.

    Thresholds depend on the scores of all sequences, so boxes are kept, about 60 bytes each, and counted at the end.
    """

    tables: tuple[tuple[TrackTable, ...], ...]

    def __add__(self, other: "TrackStatistics") -> "TrackStatistics":
        return TrackStatistics(self.tables + other.tables)


_FACTS = Facts(
    judges_tracks=True, space="3d", family="kitti-tracking",
    headlines=Headlines(
        ("samota", "amota", "amotp", "mota", "motp", "recall", "precision", "f1", "ids", "frag", "tp", "fp", "fn",
         "mt", "ml", "best_threshold")
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Kitti3dMot:
    """AB3DMOT's `scripts/KITTI/evaluate.py` at commit 61f3bd7 (Weng et al., IROS 2020), which extends KITTI's devkit.

    Its rules, also the odd ones, are kept: a result that matched at any earlier threshold is never excused at a later
    one; scores of a track are averaged anew in each pass; recall and MOTP count ignored matches; a first frame that is
    ignored counts as tracked; the tracking labels' `Person` isn't a neighbor of pedestrians, only `Person_sitting` is.

    What differs: overlaps are exact, where AB3DMOT's clipping divides by nearly 0 if edges of both boxes lie on one
    line (a box and its copy: anything from -116 to 3484 in 500 random ones; other pairs agree to 4e-12). Its Munkres
    adds 1e9 to costs, which rounds them to 1e-7; among assignments as near as that ours is the best one, and the
    boxes' content decides between equal ones, not the order of rows. A class without results has rows, and results
    that are no boxes are false positives.
    """

    classes: tuple[TrackClass, ...] = _CLASSES
    rules: TrackRules = _RULES
    name: str = "kitti-3dmot"
    summary: str = "KITTI 3D tracking as AB3DMOT evaluates it (61f3bd7): sAMOTA, AMOTA, AMOTP, CLEAR at the best MOTA"

    @property
    def facts(self) -> Facts:
        """What it judges, and what it needs for that."""
        return _FACTS

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(label for kind in self.classes for label in kind.labels)

    def with_match(self, match: Match) -> Self:
        """Return the profile with another threshold, on `iou3d` or `iou2d`. Raises ConfigError for other likenesses."""
        if match.likeness not in ("iou3d", "iou2d"):
            raise ConfigError(f"{self.name}: --match {match.likeness}: expected iou3d or iou2d")
        return replace(self, rules=replace(self.rules, match=match))

    def measure(self, sequence: Sequence) -> TrackStatistics:
        """Return what counts in one sequence. Raises MetricError where an id is twice in a frame (GT003), or boxes lack
        what is matched.
        """
        return TrackStatistics((tuple(track_table(sequence, kind, self.rules) for kind in self.classes),))

    def scores(self, statistics: TrackStatistics, part: str) -> list[Score]:
        """Return the rows of each class; `counts` tell invalid boxes (GT004, PRD001)."""
        rows = []
        for i, kind in enumerate(self.classes):
            rows += track_scores([tables[i] for tables in statistics.tables], kind.label, self.rules, part)
        return rows
