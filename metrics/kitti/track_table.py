"""Tracks of one class in one sequence, as compact as every confidence threshold allows."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.kitti.pairs import Pairs, pairs_within
from fbench.metrics.kitti.rows import (
    by_content,
    covered_by_regions,
    known,
    labelled,
    outside,
    rectangles,
    sound_results,
    sound_truth,
    track_numbers,
    unique_ids,
)  # fmt: skip
from fbench.metrics.kitti.track_rules import TrackClass, TrackRules
from fbench.metrics.objects import Objects
from fbench.metrics.sequence import Sequence
from fbench.replay.arrays import Bool, Float64, Int64, freeze_fields


@dataclass(frozen=True, eq=False)
class TrackTable:
    """N truth boxes on K tracks and M results on T tracks; about 40 bytes a box and 16 a pair that can match."""

    num_frames: int
    pairs: Pairs
    truth_ignored: Bool
    """(N,) occluded, truncated or of a neighbouring class."""
    track_start: Int64
    """(K + 1,) track k has the truth rows `track_rows[track_start[k]:track_start[k + 1]]`, in the order of time."""
    track_rows: Int64
    """(N,)"""
    estimate_track: Int64
    """(M,)"""
    excusable: Bool
    """(M,) low, of a neighbouring class or in a "don't care" region: no false positive where it matches nothing."""
    track_size: Int64
    """(T,) boxes of the track."""
    track_score: Float64
    """(T,) mean score of the track."""
    num_bad_truth: int
    """Left out; what the source left out already is of any class."""
    num_bad_results: int
    """They are false positives at every threshold."""

    def __post_init__(self) -> None:
        truth, estimates, tracks = ("N",), ("M",), ("T",)
        freeze_fields(
            self, truth_ignored=("?", truth), track_start=("i8", ("K1",)), track_rows=("i8", truth),
            estimate_track=("i8", estimates), excusable=("?", estimates), track_size=("i8", tracks),
            track_score=("f8", tracks),
        )  # fmt: skip

    @property
    def num_truth_tracks(self) -> int:
        """K."""
        return len(self.track_start) - 1


def track_table(sequence: Sequence, kind: TrackClass, rules: TrackRules) -> TrackTable:
    """Select what counts for one class.

    Raises:
        MetricError: where an id is twice in a frame (GT003), or boxes lack what is matched.
    """
    truth, num_bad_truth = _truth(sequence, kind, rules)
    results, num_bad_results = _results(sequence, kind, rules)
    num_steps, match = len(sequence.steps), rules.match
    truth_track, estimate_track = (track_numbers(objects, sequence) for objects in (truth, results))
    track_rows = np.argsort(truth_track, kind="stable")
    track_size = np.bincount(estimate_track).astype(np.int64)
    # Scores are added in the order of frames, as AB3DMOT does.
    scores = np.bincount(estimate_track, weights=results.score) / np.maximum(track_size, 1)
    return TrackTable(
        num_frames=num_steps,
        pairs=pairs_within(truth, results, num_steps, match.likeness, match.threshold),
        truth_ignored=_ignored(truth, kind, rules),
        track_start=np.searchsorted(truth_track[track_rows], np.arange(truth_track.max(initial=-1) + 2)),
        track_rows=track_rows,
        estimate_track=estimate_track,
        excusable=_excusable(results, sequence, kind, rules),
        track_size=track_size,
        track_score=scores,
        num_bad_truth=num_bad_truth + sequence.num_invalid_truth,
        num_bad_results=num_bad_results,
    )


def _truth(sequence: Sequence, kind: TrackClass, rules: TrackRules) -> tuple[Objects, int]:
    truth = sequence.truth[labelled(sequence.truth, kind.labels) & (sequence.truth.track_id >= 0)]
    unique_ids(truth, sequence, "truth")
    good = sound_truth(truth, rules.match.likeness)
    return by_content(truth[good], sequence), int((~good).sum())


def _results(sequence: Sequence, kind: TrackClass, rules: TrackRules) -> tuple[Objects, int]:
    results = sequence.estimates[labelled(sequence.estimates, kind.labels) & (sequence.estimates.track_id >= 0)]
    unique_ids(results, sequence, "results")
    good = sound_results(results, rules.match.likeness)
    return by_content(results[good], sequence), int((~good).sum())


def _ignored(truth: Objects, kind: TrackClass, rules: TrackRules) -> Bool:
    """Levels are whole numbers, cut off as AB3DMOT cuts them; what nobody knows is no reason to ignore."""
    occlusion, truncation = (np.trunc(known(v, truth, -1.0)) for v in (truth.occlusion, truth.truncation))
    ignored = (occlusion > rules.max_occlusion) | (truncation > rules.max_truncation)
    return np.asarray(ignored | (truth.label == kind.neighbour) | outside(truth), np.bool_)


def _excusable(results: Objects, sequence: Sequence, kind: TrackClass, rules: TrackRules) -> Bool:
    rectangle = rectangles(results)
    low: Bool = np.abs(rectangle[:, 1] - rectangle[:, 3]) <= rules.min_height_px
    covered = covered_by_regions(results, sequence.truth, len(sequence.steps))
    excusable = low | (results.label == kind.neighbour) | (covered > rules.max_covered) | outside(results)
    return np.asarray(excusable, np.bool_)
