"""Assignment problems: the boxes of one class that count, and how similar they are."""

from dataclasses import dataclass, replace

import numpy as np

from fbench.metrics.core.similarity import Blocks
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Match, SimilarityKind
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.sequences import Objects, are_finite


@dataclass(frozen=True, eq=False)
class Problem:
    """S steps with N truth boxes to be found and M estimates that count, of one class of one sequence."""

    pairs: Blocks  # Similarity (N, M), higher is nearer; distances are negated
    stream: Int64  # (S,) tracks go on within a stream only
    truth_id: Int64
    """(N,) 0 to num_truth_ids - 1 over all streams (an id in two streams counts as two), -1 where there is none."""
    estimate_id: Int64  # (M,) as `truth_id`
    truth_row: Int64  # (N,) which rows of the sequence's truth they are, for reports
    estimate_row: Int64  # (M,)

    @property
    def num_truth_ids(self) -> int:
        """Truth tracks that count."""
        return int(self.truth_id.max(initial=-1)) + 1

    @property
    def num_estimate_ids(self) -> int:
        """Estimated tracks that count."""
        return int(self.estimate_id.max(initial=-1)) + 1

    def with_similarity(self, values: Float64) -> "Problem":
        """Return the problem with other similarities (B,) of its pairs."""
        return replace(self, pairs=replace(self.pairs, values=values))

    def overlaps(self, match: Match) -> "Problem":
        """Return the problem with similarities of 0 (or less: none) to 1, as HOTA needs them: distances become
        max(0, 1 - distance / threshold), as TrackEval has it for 3D (`_calculate_euclidean_similarity`).
        """
        if not match.is_distance:
            return self
        return self.with_similarity(np.maximum(0.0, 1 + self.pairs.values / match.threshold))


def is_valid(objects: Objects, similarity: SimilarityKind) -> Bool:
    """Tell of which objects (N,) score and geometry are finite, and no size is negative (fault PRD001 of results).
    Raises MetricError where the objects lack what the similarity compares.
    """
    good: Bool = np.isfinite(objects.score)
    if not len(objects):
        return good
    parts, is_inverted = _geometry(objects, similarity)
    return np.asarray(np.all([good, ~is_inverted, *map(are_finite, parts.values())], axis=0))


def faults(objects: Objects, row: int, similarity: SimilarityKind) -> list[str]:
    """Say what is wrong with one object that isn't valid."""
    parts, is_inverted = _geometry(objects, similarity)
    found = [] if np.isfinite(objects.score[row]) else ["its score isn't finite"]
    found += [f"its {what} isn't finite" for what, part in parts.items() if not are_finite(part[row : row + 1])[0]]
    if is_inverted[row]:
        turned = "its right is left of its left, or its bottom above its top"
        found.append(turned if similarity == "iou2d" else "its size is negative")
    return found


def _geometry(objects: Objects, similarity: SimilarityKind) -> tuple[dict[str, Float64], Bool]:
    """What is compared (N, K) by name, and which objects (N,) have a negative size."""
    if similarity == "iou2d":
        if objects.xyxy_px is None:
            raise MetricError("there are no boxes in images to score")
        inverted = objects.xyxy_px[:, 2:] < objects.xyxy_px[:, :2]
        return {"rectangle": objects.xyxy_px}, np.asarray(inverted.any(axis=1))
    if objects.center_m is None or objects.size_lwh_m is None or objects.yaw_rad is None:
        raise MetricError("there are no 3D boxes to score")
    parts = {"center": objects.center_m, "size": objects.size_lwh_m, "heading": objects.yaw_rad[:, None]}
    return parts, np.asarray((objects.size_lwh_m < 0).any(axis=1))
