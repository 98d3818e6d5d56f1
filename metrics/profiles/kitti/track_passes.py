"""AB3DMOT's passes over all sequences, from compact tables of tracks."""

import math
from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np

from fbench.metrics.core.ordering import find_twice, number_tracks
from fbench.metrics.profiles.kitti import rows
from fbench.metrics.profiles.kitti.rows import KittiClass, Pairs
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.sequences import Sequence


@dataclass(frozen=True)
class TrackRules:
    """Thresholds of `trackingEvaluation` in scripts/KITTI/evaluate.py, AB3DMOT 61f3bd7."""

    match: Match
    min_height_px: float = 25.0  # Results up to this height are excused where they match nothing
    max_occlusion: int = 2  # Truth above is ignored; in KITTI 3 is unknown
    max_truncation: int = 0
    max_covered: float = 0.5  # Results of which a "don't care" region covers more are excused where they match nothing
    num_recalls: int = 40  # Recalls 1/40 to 1 over which sAMOTA, AMOTA and AMOTP are averaged


@dataclass(frozen=True, eq=False)
class TrackTable:
    """N truth boxes on K tracks and M results on T tracks; about 40 bytes a box and 16 a pair that can match."""

    num_frames: int
    pairs: Pairs
    truth_ignored: Bool  # (N,) occluded, truncated or of a neighboring class
    track_start: Int64
    """(K + 1,) track k has the truth rows `track_rows[track_start[k]:track_start[k + 1]]`, in the order of time."""
    track_rows: Int64  # (N,)
    estimate_track: Int64  # (M,)
    excusable: Bool
    """(M,) low, of a neighboring class or in a "don't care" region: no false positive where it matches nothing."""
    track_size: Int64  # (T,) boxes of the track
    track_score: Float64  # (T,) mean score of the track
    num_bad_truth: int  # Left out; what the source left out already is of any class
    num_bad_results: int  # They are false positives at every threshold


def track_table(sequence: Sequence, kind: KittiClass, rules: TrackRules) -> TrackTable:
    """Select what counts for a class. MetricError: an id is twice in a frame (GT003), or boxes lack what is matched."""
    steps, match, sides, num_bad = sequence.steps, rules.match, [], []
    for side, own in (("truth", sequence.truth), ("results", sequence.estimates)):
        objects = own[np.isin(own.label, kind.labels) & (own.track_id >= 0)]
        if (row := find_twice(objects.step, objects.track_id)) is not None:
            where = f"{sequence.name}: frame {steps.frame[objects.step[row]]}"
            raise MetricError(f"{where}: {side} has id {objects.track_id[row]} twice", "GT003")
        good = rows.are_sound(objects, match.kind, side == "truth")
        sides.append(rows.by_content(objects[good], sequence))
        num_bad.append(int((~good).sum()))
    truth, results = sides
    # Levels are whole numbers, cut off as AB3DMOT cuts them; what nobody knows is no reason to ignore.
    occlusion, truncation = (np.trunc(rows.fill_unknown(v, truth, -1.0)) for v in (truth.occlusion, truth.truncation))
    ignored = (occlusion > rules.max_occlusion) | (truncation > rules.max_truncation) | rows.outside(truth)
    rectangle = rows.rectangles(results)
    excusable = np.abs(rectangle[:, 1] - rectangle[:, 3]) <= rules.min_height_px
    excusable |= rows.share_in_regions(results, sequence.truth, len(steps)) > rules.max_covered
    truth_track, estimate_track = (number_tracks(side.track_id, steps.stream[side.step]) for side in sides)
    track_rows, track_size = np.argsort(truth_track, kind="stable"), np.bincount(estimate_track).astype(np.int64)
    return TrackTable(
        num_frames=len(steps),
        pairs=rows.pairs_within(truth, results, len(steps), match.kind, match.threshold),
        truth_ignored=ignored | (truth.label == kind.neighbor),
        track_start=np.searchsorted(truth_track[track_rows], np.arange(truth_track.max(initial=-1) + 2)),
        track_rows=track_rows,
        estimate_track=estimate_track,
        excusable=excusable | (results.label == kind.neighbor) | rows.outside(results),
        track_size=track_size,
        # Scores are added in the order of frames, as AB3DMOT does.
        track_score=np.bincount(estimate_track, weights=results.score) / np.maximum(track_size, 1),
        num_bad_truth=num_bad[0] + sequence.num_invalid_truth,
        num_bad_results=num_bad[1],
    )


ALL_RESULTS = -10000.0  # AB3DMOT's threshold for everything


@dataclass(frozen=True)
class Pass:
    """Raw counts at one confidence threshold; names and rules are AB3DMOT's."""

    threshold: float
    recall: float  # The recall that the threshold was chosen for; 1 where it wasn't
    tp: int  # With ignored ones
    itp: int
    fp: int
    fn: int  # Without ignored ones
    ifn: int
    ids: int
    frag: int
    mt: int
    pt: int
    ml: int
    ignored_tracks: int
    gt: int  # Truth boxes that count
    results: int
    ignored_results: int
    similarity: float  # Sum over `tp`
    frame_similarity: float  # Sum over frames of the mean over matches that count, 1 where there are none

    @property
    def mota(self) -> float | None:
        """1 - (FN + FP + IDS) / GT, not clipped."""
        return 1 - (self.fn + self.fp + self.ids) / self.gt if self.gt else None

    @property
    def smota(self) -> float | None:
        """MOTA scaled by the recall that was aimed at, clipped to 0 and 1."""
        if not self.gt:
            return None
        missed = self.fn + self.fp + self.ids - (1 - self.recall) * self.gt
        return min(1.0, max(0.0, 1 - missed / (self.recall * self.gt)))

    @property
    def motp(self) -> float:
        """Mean similarity of matches, 0 where there are none."""
        return self.similarity / self.tp if self.tp else 0.0


def run_passes(tables: Many[TrackTable], num_recalls: int) -> tuple[list[Pass], Pass]:
    """Find the thresholds from the scores of all tables, and count at each: by rising recall, without recalls that
    aren't reached; then at the threshold with the highest MOTA above 0, else with all results.
    """
    walks = [_Walk(table) for table in tables]
    everything = _add_walks(walks, (ALL_RESULTS,), (1.0,), is_first=True)[0]
    scores = np.concatenate([np.zeros(0), *(walk.scores_of_matches() for walk in walks)])
    thresholds, recalls = rows.recall_thresholds(scores, everything.tp + everything.fn, num_recalls)
    passes = _add_walks(walks, thresholds[1:], recalls[1:], is_first=False)  # the first is recall 0
    best_mota, best = 0.0, ALL_RESULTS
    for one in passes:
        if one.mota is not None and one.mota > best_mota:
            best_mota, best = one.mota, one.threshold
    return passes, _add_walks(walks, (best,), (1.0,), is_first=False)[0]


class _Walk:
    """One table with what AB3DMOT carries from pass to pass: scores, averaged anew, and which results matched once."""

    def __init__(self, table: TrackTable) -> None:
        self._table = table
        self._score = table.track_score.copy()
        self._valid = np.zeros(len(table.estimate_track), np.bool_)
        self._matched: Int64 = np.zeros(0, np.int64)

    def count(self, thresholds: tuple[float, ...], is_first: bool) -> tuple[Int64, Float64]:
        """Return counts (K, 14) and sums (K, 2)."""
        from fbench.metrics.profiles.kitti.kernels import FP, RESULTS, count_passes  # numba takes a while to import

        table, pairs = self._table, self._table.pairs
        counts, sums, self._matched = count_passes(
            pairs.truth_start, pairs.estimate_start, pairs.start, pairs.estimate, pairs.similarity, table.truth_ignored,
            table.track_start, table.track_rows, table.estimate_track, table.excusable, table.track_size, self._score,
            self._valid, np.array(thresholds, np.float64), is_first,
        )  # fmt: skip
        counts[:, [FP, RESULTS]] += table.num_bad_results
        return counts, sums

    def scores_of_matches(self) -> Float64:
        """Return the scores of the tracks that matched in the last pass, one a match."""
        return self._score[self._table.estimate_track[self._matched[self._matched >= 0]]]


def _add_walks(
    walks: list[_Walk], thresholds: tuple[float, ...], recalls: tuple[float, ...], is_first: bool
) -> list[Pass]:
    """Add up the passes of all tables; the sums of reals are exact before they are rounded, so order is nothing."""
    counts, sums = zip(*(walk.count(thresholds, is_first) for walk in walks), strict=True)
    totals = np.sum(counts, axis=0).tolist()
    return [
        Pass(threshold, recall, *totals[k], *(math.fsum(float(own[k, c]) for own in sums) for c in range(2)))
        for k, (threshold, recall) in enumerate(zip(thresholds, recalls, strict=True))
    ]
