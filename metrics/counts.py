"""Raw counts of hits and misses, which can be added over frames and runs."""

from dataclasses import asdict, dataclass

import numpy as np

from fbench.metrics.matching import Matches, match_hungarian
from fbench.metrics.prepare import Problem
from fbench.replay.arrays import Bool


@dataclass(frozen=True)
class BoxCounts:
    """Hits and misses."""

    tp: int = 0
    fp: int = 0
    fn: int = 0
    ignored: int = 0
    """Estimates that are neither: outside the region, or on truth that needn't be found."""
    invalid: int = 0
    """Estimates that aren't finite; they are in `fp` too."""
    invalid_truth: int = 0
    """Truth boxes that aren't finite; they are left out."""

    def __add__(self, other: "BoxCounts") -> "BoxCounts":
        mine, theirs = asdict(self), asdict(other)
        return BoxCounts(**{name: mine[name] + theirs[name] for name in mine})

    @property
    def gt(self) -> int:
        """Truth boxes that had to be found."""
        return self.tp + self.fn

    @property
    def estimates(self) -> int:
        """Estimates that counted."""
        return self.tp + self.fp


def count_boxes(problem: Problem, matches: Matches) -> BoxCounts:
    """Count one problem: an estimate without partner is a false alarm unless it is excused or outside the region."""
    free = matches.truth_of_estimate < 0
    candidates = free & problem.inside & ~problem.invalid
    excused = np.zeros(len(free), bool)
    excused[candidates] = _excused(problem, candidates)
    false = (candidates & ~excused) | problem.invalid
    tp = int((~free).sum())
    return BoxCounts(
        tp=tp,
        fp=int(false.sum()),
        fn=len(problem.truth_id) - tp,
        ignored=int((free & ~false).sum()),
        invalid=int(problem.invalid.sum()),
        invalid_truth=problem.num_bad_truth,
    )


def _excused(problem: Problem, candidates: Bool) -> Bool:
    excuse = problem.excuse[:, candidates]
    shared: Bool = np.any(excuse >= problem.threshold, axis=0)
    single: Bool = match_hungarian(excuse, problem.threshold).truth_of_estimate >= 0
    return shared if problem.shared_excuse else single
