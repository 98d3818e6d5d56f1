"""Assignment problems: the boxes of one class that count, and how similar they are."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.core.sequence import Objects
from fbench.metrics.profiles.profile import Likeness
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.arrays import Bool, Float64, Int64, freeze_fields
from fbench.replay.data.boxes import MAX_MAGNITUDE


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

    def block(self, step: int) -> Float64:
        """Similarity (n, m) of one step."""
        n, m = (int(s[step + 1] - s[step]) for s in (self.truth_start, self.estimate_start))
        block: Float64 = np.asarray(self.similarity[self.block_start[step] : self.block_start[step + 1]])
        return block.reshape(n, m)


def is_valid(objects: Objects, likeness: Likeness) -> Bool:
    """Tell of which objects (N,) score and geometry are finite, and no size is negative (fault PRD001 of results).
    Raises MetricError where the objects lack what the likeness compares.
    """
    good: Bool = np.isfinite(objects.score)
    if not len(objects):
        return good
    if likeness == "iou2d":
        box = _known(objects.xyxy_px, "boxes in images")
        good &= _finite(box) & np.all(box[:, 2:] >= box[:, :2], axis=1)
        return good
    center, size = _known(objects.center_m, "3D boxes"), _known(objects.size_lwh_m, "3D boxes")
    yaw = _known(objects.yaw_rad, "3D boxes")[:, None]
    good &= _finite(np.hstack([center, size, yaw])) & np.all(size >= 0, axis=1)
    return good


def faults(objects: Objects, row: int, likeness: Likeness) -> list[str]:
    """Say what is wrong with one object that isn't valid."""
    found = [] if np.isfinite(objects.score[row]) else ["its score isn't finite"]
    if likeness == "iou2d":
        box = _known(objects.xyxy_px, "boxes in images")[row : row + 1]
        return found + ([] if _finite(box)[0] else ["its rectangle isn't finite"]) + (
            ["its right is left of its left, or its bottom above its top"] if (box[0, 2:] < box[0, :2]).any() else []
        )  # fmt: skip
    center, size = _known(objects.center_m, "3D boxes"), _known(objects.size_lwh_m, "3D boxes")
    yaw = _known(objects.yaw_rad, "3D boxes")[:, None]
    parts = (("centre", center), ("size", size), ("heading", yaw))
    found += [f"its {what} isn't finite" for what, values in parts if not _finite(values[row : row + 1])[0]]
    return found + (["its size is negative"] if (size[row] < 0).any() else [])


def _known(values: Float64 | None, what: str) -> Float64:
    if values is None:
        raise MetricError(f"there are no {what} to score")
    return values


def _finite(values: Float64) -> Bool:
    magnitude = np.abs(np.nan_to_num(values, nan=np.inf, posinf=np.inf, neginf=-np.inf))
    small: Bool = np.all(magnitude < MAX_MAGNITUDE, axis=1)
    return small
