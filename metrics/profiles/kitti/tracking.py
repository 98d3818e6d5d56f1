"""The profile `kitti-3dmot`: 3D tracking on KITTI as AB3DMOT's evaluation counts it."""

import math
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from fbench.metrics.profiles.kitti.rows import KittiClass, Tables
from fbench.metrics.profiles.kitti.track_passes import ALL_RESULTS, TrackRules, TrackTable, run_passes, track_table
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence


def track_scores(tables: Many[TrackTable], label: str, rules: TrackRules, part: str) -> list[Score]:
    """Return the rows of one class: averages over recall, ratios at the best threshold, and what AB3DMOT counts there.

    In the averages recalls that weren't reached count 0. Sums go from the lowest recall on, as AB3DMOT adds. Recalls
    are those of all truth, ignored boxes too, so that without truth that counts there can be an AMOTP. MOTA and MODA
    aren't clipped.
    """
    (passes, best), num_recalls = run_passes(tables, rules.num_recalls), rules.num_recalls
    has_truth, is_reached = best.gt > 0, bool(passes)
    frames, bad_truth, bad_results = (
        sum(getattr(t, name) for t in tables) for name in ("num_frames", "num_bad_truth", "num_bad_results")
    )
    truth_tracks, result_tracks = sum(len(t.track_start) - 1 for t in tables), sum(len(t.track_size) for t in tables)
    tracks, truth, ignored = truth_tracks - best.ignored_tracks, best.tp + best.fn, best.itp + best.ifn
    no_truth = "no truth boxes that count (AB3DMOT prints {})"
    no_mean, no_mota = no_truth.format("-inf" if is_reached else "0, then stops"), no_truth.format("-inf")
    no_match, no_track = "no result matches (AB3DMOT prints 0)", "no truth tracks that count (AB3DMOT prints 0)"
    no_object, no_result = "no truth boxes (AB3DMOT prints 0)", "no results (AB3DMOT prints 0)"
    no_frame, no_box = "no frames (AB3DMOT prints n/a)", no_result if truth else no_object
    log_ids = math.log10(best.ids) if best.ids else 0.0
    # AB3DMOT's number for all results is no score.
    is_score = result_tracks > 0 and best.threshold != ALL_RESULTS
    all_count = f"no threshold has a MOTA above 0, so all results count (AB3DMOT takes {ALL_RESULTS:g})"
    means = [
        ("samota", sum(p.smota or 0.0 for p in passes) / num_recalls if has_truth else None, "1"),
        ("amota", sum(p.mota or 0.0 for p in passes) / num_recalls if has_truth else None, "1"),
        ("amotp", sum(p.motp for p in passes) / num_recalls if has_truth or is_reached else None, "IoU"),
    ]
    ratios = [
        ("mota", best.mota, "1", no_mota),
        ("motp", _ratio(best.similarity, best.tp), "IoU", no_match),
        ("motal", 1 - (best.fn + best.fp + log_ids) / best.gt if best.gt else None, "1", no_mota),
        ("moda", 1 - (best.fn + best.fp) / best.gt if best.gt else None, "1", no_mota),
        ("modp", _ratio(best.frame_similarity, frames), "IoU", no_frame),
        ("recall", _ratio(best.tp, truth), "1", no_object),
        ("precision", _ratio(best.tp, best.tp + best.fp), "1", no_result),
        ("f1", _ratio(2 * best.tp, 2 * best.tp + best.fn + best.fp), "1", no_box),
        ("far", _ratio(best.fp, frames), "1/frame", no_frame),
        *((name, _ratio(getattr(best, name), tracks), "1", no_track) for name in ("mt", "pt", "ml")),
        ("best_threshold", best.threshold if is_score else None, "score", all_count if result_tracks else "no results"),
    ]
    known = {name: getattr(best, name) for name in ("tp", "itp", "fp", "fn", "ifn", "ids", "frag", "mt", "pt", "ml")}
    counts = {
        **known, "gt": best.gt, "frames": frames, "gt_tracks": truth_tracks, "ignored_gt_tracks": best.ignored_tracks,
        "iou_sum": best.similarity, "frame_iou_sum": best.frame_similarity, "invalid_truth": bad_truth,
        "invalid_results": bad_results,
    }  # fmt: skip
    printed = {name: known[name] for name in ("ids", "frag", "tp", "itp", "fp", "fn", "ifn")} | {
        "gt_objects": best.gt + ignored, "ignored_gt_objects": ignored, "gt_tracks": truth_tracks,
        "tracker_objects": best.results, "ignored_tracker_objects": best.ignored_results,
        "tracker_tracks": result_tracks,
    }  # fmt: skip
    reached = {"recalls": num_recalls, "reached": len(passes), "gt": best.gt}
    values = [(*row, no_mean, reached) for row in means] + [(*row, counts) for row in ratios]
    values += [(name, float(count), "1", "", counts) for name, count in printed.items()]
    return [
        Score(metric, label, part, str(rules.match), value, why if value is None else None, unit, own)
        for metric, value, unit, why, own in values
    ]


def _ratio(top: float, bottom: int) -> float | None:
    return top / bottom if bottom else None


_RULES = TrackRules(Match("iou3d", 0.25))
_CLASSES = (KittiClass("car", "van"), KittiClass("pedestrian", "person_sitting"), KittiClass("cyclist"))


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

    classes: tuple[KittiClass, ...] = _CLASSES
    rules: TrackRules = _RULES
    name: str = "kitti-3dmot"
    summary: str = "KITTI 3D tracking as AB3DMOT evaluates it (61f3bd7): sAMOTA, AMOTA, AMOTP, CLEAR at the best MOTA"

    facts: ClassVar[Facts] = Facts(
        judges_tracks=True, space="3d", family="kitti-tracking",
        headlines=Headlines(
            ("samota", "amota", "amotp", "mota", "motp", "recall", "precision", "f1", "ids", "frag", "tp", "fp", "fn",
             "mt", "ml", "best_threshold")
        ),
    )  # fmt: skip

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(label for kind in self.classes for label in kind.labels)

    def with_match(self, match: Match) -> Self:
        """Return the profile with another threshold, on `iou3d` or `iou2d`. Raises ConfigError for others."""
        if match.kind not in ("iou3d", "iou2d"):
            raise ConfigError(f"{self.name}: --match {match.kind}: expected iou3d or iou2d")
        return replace(self, rules=replace(self.rules, match=match))

    def measure(self, sequence: Sequence) -> Tables[TrackTable]:
        """Return what counts. MetricError: an id is twice in a frame (GT003), or boxes lack what is matched."""
        return Tables((tuple(track_table(sequence, kind, self.rules) for kind in self.classes),))

    def scores(self, statistics: Tables[TrackTable], part: str) -> list[Score]:
        """Return the rows of each class; `counts` tell invalid boxes (GT004, PRD001)."""
        tables = zip(self.classes, zip(*statistics.tables, strict=True), strict=True)
        return [row for kind, own in tables for row in track_scores(own, kind.label, self.rules, part)]
