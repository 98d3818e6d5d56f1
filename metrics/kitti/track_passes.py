"""AB3DMOT's passes over all sequences: everything, then each recall, then the threshold of the best MOTA."""

import math
from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np

from fbench.metrics.kitti.recalls import recall_thresholds
from fbench.metrics.kitti.track_table import TrackTable
from fbench.replay.arrays import Float64, Int64

ALL_RESULTS = -10000.0
"""AB3DMOT's threshold for everything."""


@dataclass(frozen=True)
class Pass:
    """Raw counts at one confidence threshold; names and rules are AB3DMOT's."""

    threshold: float
    recall: float
    """The recall that the threshold was chosen for; 1 where it wasn't."""
    tp: int
    """With ignored ones."""
    itp: int
    fp: int
    fn: int
    """Without ignored ones."""
    ifn: int
    ids: int
    frag: int
    mt: int
    pt: int
    ml: int
    ignored_tracks: int
    gt: int
    """Truth boxes that count."""
    results: int
    ignored_results: int
    likeness: float
    """Sum over `tp`."""
    frame_likeness: float
    """Sum over frames of the mean over matches that count, 1 where there are none."""

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
        """Mean likeness of matches, 0 where there are none."""
        return self.likeness / self.tp if self.tp else 0.0


@dataclass(frozen=True)
class Passes:
    """All that the rows of one class are made of."""

    recalls: tuple[Pass, ...]
    """By rising recall; recalls that weren't reached are missing."""
    best: Pass
    """At the threshold with the highest MOTA above 0, else with all results."""


def run_passes(tables: Many[TrackTable], num_recalls: int) -> Passes:
    """Find the thresholds from the scores of all tables, and count at each."""
    walks = [_Walk(table) for table in tables]
    everything = _added(walks, (ALL_RESULTS,), (1.0,), is_first=True)[0]
    scores = np.concatenate([np.zeros(0), *(walk.matched_scores() for walk in walks)])
    thresholds, recalls = recall_thresholds(scores, everything.tp + everything.fn, num_recalls)
    thresholds, recalls = thresholds[1:], recalls[1:]  # the first is recall 0
    passes = _added(walks, thresholds, recalls, is_first=False)
    best_mota, best = 0.0, ALL_RESULTS
    for one in passes:
        if one.mota is not None and one.mota > best_mota:
            best_mota, best = one.mota, one.threshold
    return Passes(tuple(passes), _added(walks, (best,), (1.0,), is_first=False)[0])


class _Walk:
    """One table with what AB3DMOT carries from pass to pass: scores, averaged anew, and which results matched once."""

    def __init__(self, table: TrackTable) -> None:
        self.table = table
        self._score = table.track_score.copy()
        self._valid = np.zeros(len(table.estimate_track), np.bool_)
        self._matched: Int64 = np.zeros(0, np.int64)

    def count(self, thresholds: tuple[float, ...], is_first: bool) -> tuple[Int64, Float64]:
        """Return counts (K, 14) and sums (K, 2)."""
        from fbench.metrics.kernels.kitti_tracks import count_passes  # numba takes a while to import

        table, pairs = self.table, self.table.pairs
        counts, sums, self._matched = count_passes(
            pairs.truth_start, pairs.estimate_start, pairs.start, pairs.estimate, pairs.likeness, table.truth_ignored,
            table.track_start, table.track_rows, table.estimate_track, table.excusable, table.track_size, self._score,
            self._valid, np.array(thresholds, np.float64), is_first,
        )  # fmt: skip
        counts[:, 2] += table.num_bad_results  # false positives
        counts[:, 12] += table.num_bad_results  # results
        return counts, sums

    def matched_scores(self) -> Float64:
        """Return the scores of the tracks that matched in the last pass, one a match."""
        matched = self._matched[self._matched >= 0]
        return self._score[self.table.estimate_track[matched]]


def _added(walks: list[_Walk], thresholds: tuple[float, ...], recalls: tuple[float, ...], is_first: bool) -> list[Pass]:
    """Add up the passes of all tables; the sums of reals are exact before they are rounded, so order is nothing."""
    own = [walk.count(thresholds, is_first) for walk in walks]
    passes = []
    for k, (threshold, recall) in enumerate(zip(thresholds, recalls, strict=True)):
        counts = [sum(int(counts[k, c]) for counts, _ in own) for c in range(14)]
        sums = [math.fsum(float(sums[k, c]) for _, sums in own) for c in range(2)]
        passes.append(Pass(threshold, recall, *counts, *sums))
    return passes
