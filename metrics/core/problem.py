"""Assignment problems: the boxes of one class that count, and how similar they are."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Likeness
from fbench.replay.data.arrays import Bool, Float64, Int64, freeze_fields
from fbench.replay.data.sequences import Objects, are_finite


@dataclass(frozen=True, eq=False)
class Problem:
    """S steps with N truth boxes to be found and M estimates that count, of one class of one sequence.

    Similarities are kept step by step in one flat array, so that kernels go over it without Python: those of step s
    are `similarity[block_start[s]:block_start[s + 1]]`, row-major, one row a truth box of the step.
    """

    truth_start: Int64  # (S + 1,) offsets: step s has truth rows `truth_start[s]:truth_start[s + 1]`
    estimate_start: Int64  # (S + 1,)
    block_start: Int64  # (S + 1,) offsets into `similarity`
    similarity: Float64  # (B,) higher is nearer; distances are negated
    stream: Int64  # (S,) tracks go on within a stream only
    truth_id: Int64
    """(N,) 0 to num_truth_ids - 1 over all streams (an id in two streams counts as two), -1 where there is none."""
    estimate_id: Int64  # (M,) as `truth_id`
    score: Float64  # (M,)
    truth_row: Int64  # (N,) which rows of the sequence's truth they are, for reports
    estimate_row: Int64  # (M,)

    def __post_init__(self) -> None:
        offsets, truth, estimates = ("i8", ("S1",)), ("i8", ("N",)), ("i8", ("M",))
        freeze_fields(
            self, truth_start=offsets, estimate_start=offsets, block_start=offsets, similarity=("f8", ("B",)),
            stream=("i8", ("S",)), truth_id=truth, estimate_id=estimates, score=("f8", ("M",)), truth_row=truth,
            estimate_row=estimates,
        )  # fmt: skip

    @property
    def num_steps(self) -> int:
        """S."""
        return len(self.stream)

    @property
    def num_truth(self) -> int:
        """N."""
        return len(self.truth_id)

    @property
    def num_estimates(self) -> int:
        """M."""
        return len(self.estimate_id)

    @property
    def num_truth_ids(self) -> int:
        """Truth tracks that count."""
        return int(self.truth_id.max(initial=-1)) + 1

    @property
    def num_estimate_ids(self) -> int:
        """Estimated tracks that count."""
        return int(self.estimate_id.max(initial=-1)) + 1

    @property
    def starts(self) -> tuple[Int64, Int64, Int64]:
        """Offsets of truth, estimates and similarities for kernels, which are compiled for writeable arrays."""
        return np.array(self.truth_start), np.array(self.estimate_start), np.array(self.block_start)


def is_valid(objects: Objects, likeness: Likeness) -> Bool:
    """Tell of which objects (N,) score and geometry are finite, and no size is negative (fault PRD001 of results).
    Raises MetricError where the objects lack what the likeness compares.
    """
    good: Bool = np.isfinite(objects.score)
    if not len(objects):
        return good
    parts, is_inverted = _geometry(objects, likeness)
    return np.asarray(np.all([good, ~is_inverted, *map(are_finite, parts.values())], axis=0))


def faults(objects: Objects, row: int, likeness: Likeness) -> list[str]:
    """Say what is wrong with one object that isn't valid."""
    parts, is_inverted = _geometry(objects, likeness)
    found = [] if np.isfinite(objects.score[row]) else ["its score isn't finite"]
    found += [f"its {what} isn't finite" for what, part in parts.items() if not are_finite(part[row : row + 1])[0]]
    if is_inverted[row]:
        turned = "its right is left of its left, or its bottom above its top"
        found.append(turned if likeness == "iou2d" else "its size is negative")
    return found


def _geometry(objects: Objects, likeness: Likeness) -> tuple[dict[str, Float64], Bool]:
    """What is compared (N, K) by name, and which objects (N,) have a negative size."""
    if likeness == "iou2d":
        if objects.xyxy_px is None:
            raise MetricError("there are no boxes in images to score")
        inverted = objects.xyxy_px[:, 2:] < objects.xyxy_px[:, :2]
        return {"rectangle": objects.xyxy_px}, np.asarray(inverted.any(axis=1))
    if objects.center_m is None or objects.size_lwh_m is None or objects.yaw_rad is None:
        raise MetricError("there are no 3D boxes to score")
    parts = {"center": objects.center_m, "size": objects.size_lwh_m, "heading": objects.yaw_rad[:, None]}
    return parts, np.asarray((objects.size_lwh_m < 0).any(axis=1))
