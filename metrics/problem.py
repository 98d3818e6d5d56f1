"""What trackers and detectors are judged on: the boxes of one class that count, and how alike they are."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Float64, Int64, freeze_fields


@dataclass(frozen=True, eq=False)
class Problem:
    """S steps with N truth boxes to be found and M estimates that count, of one class of one sequence.

    Similarities are kept step by step in one flat array, so that kernels go over it without Python: those of step s
    are `similarity[block_start[s]:block_start[s + 1]]`, row-major, one row a truth box of the step.
    """

    truth_start: Int64
    """(S + 1,) offsets: step s has truth rows `truth_start[s]:truth_start[s + 1]`."""
    estimate_start: Int64
    """(S + 1,)"""
    block_start: Int64
    """(S + 1,) offsets into `similarity`."""
    similarity: Float64
    """(B,) higher is nearer; distances are negated."""
    stream: Int64
    """(S,) tracks go on within a stream only."""
    truth_id: Int64
    """(N,) 0 to num_truth_ids - 1 over all streams (an id in two streams counts as two), -1 where there is none."""
    estimate_id: Int64
    """(M,) as `truth_id`."""
    score: Float64
    """(M,)"""
    truth_row: Int64
    """(N,) which rows of the sequence's truth they are, for reports."""
    estimate_row: Int64
    """(M,)"""

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
