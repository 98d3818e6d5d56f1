"""The one matcher: truth and estimates are paired one to one, by score or by the best total."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from fbench.replay.arrays import Array, Bool, Float64, Int64


@dataclass(frozen=True, eq=False)
class Matches:
    """Partners of N truth boxes and M estimates; -1 where there is none."""

    estimate_of_truth: Int64
    """(N,) index of the estimate."""
    truth_of_estimate: Int64
    """(M,) index of the truth box."""

    @classmethod
    def of(cls, shape: tuple[int, int], truth: Array, estimates: Array) -> "Matches":
        """Build from lists of pairs (K,) and (K,) for `shape` (N, M)."""
        partners = np.full(shape[0], -1), np.full(shape[1], -1)
        partners[0][truth], partners[1][estimates] = estimates, truth
        return cls(*partners)


def match_greedy(similarity: Float64, threshold: float, score: Float64, preferred: Bool | None = None) -> Matches:
    """Give each estimate, best score first, the most similar truth box that is still free.

    The rule of the nuScenes and KITTI detection benchmarks. Equal scores: the more similar pair first, then the
    lower index of the estimate, then of the truth box.

    Args:
        similarity: (N, M), higher is nearer (distances are negated); NaN and -inf never match.
        threshold: Pairs match from this similarity on.
        score: (M,) of the estimates.
        preferred: (M,) estimates that choose before all others; all by default.
    """
    truth, estimates = np.nonzero(similarity >= threshold)
    late = np.zeros(len(score), bool) if preferred is None else ~preferred
    keys = (truth, estimates, -similarity[truth, estimates], -score[estimates], late[estimates])
    pairs: dict[int, int] = {}
    taken = np.zeros(len(similarity), bool)
    for k in np.lexsort(keys):
        t, e = int(truth[k]), int(estimates[k])
        if e not in pairs and not taken[t]:
            pairs[e] = t
            taken[t] = True
    chosen = np.fromiter(pairs.values(), np.int64, len(pairs)), np.fromiter(pairs, np.int64, len(pairs))
    return Matches.of(_shape(similarity), *chosen)


def match_hungarian(similarity: Float64, threshold: float, preferred: Bool | None = None) -> Matches:
    """Pair as many as possible; among these, use most preferred estimates; among these, the highest total similarity.

    Pairs below the threshold are not only dropped, they can't displace a valid pair either.

    Args:
        similarity: (N, M), higher is nearer (distances are negated); NaN and -inf never match.
        threshold: Pairs match from this similarity on.
        preferred: (M,) estimates to use rather than others; all by default.
    """
    valid = similarity >= threshold
    if not valid.any():
        return Matches.of(_shape(similarity), np.zeros(0, np.int64), np.zeros(0, np.int64))
    low, high = similarity[valid].min(), similarity[valid].max()
    quality = np.where(valid, similarity - low, 0.0) / (high - low if high > low else 1.0)
    # Three ranks in one number: m pairs sum to at most m in quality and m * step in preference, m < step.
    step = min(similarity.shape) + 1
    favour = np.ones(similarity.shape[1], bool) if preferred is None else preferred
    gain = np.where(valid, step * step + step * favour[None, :] + quality, 0.0)
    truth, estimates = linear_sum_assignment(gain, maximize=True)
    kept = valid[truth, estimates]
    return Matches.of(_shape(similarity), truth[kept], estimates[kept])


def _shape(similarity: Float64) -> tuple[int, int]:
    return similarity.shape[0], similarity.shape[1]
