"""Pairs of boxes that are alike enough to match, row by row."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.matching.blocks import pairs_of
from fbench.metrics.matching.similarity import blocks
from fbench.metrics.objects import Objects
from fbench.metrics.profile import Likeness
from fbench.replay.arrays import Bool, Float64, Int64, freeze_fields


@dataclass(frozen=True, eq=False)
class Pairs:
    """P pairs of N truth rows with M results over S steps; those of row i are `start[i]:start[i + 1]`."""

    truth_start: Int64
    """(S + 1,)"""
    estimate_start: Int64
    """(S + 1,)"""
    start: Int64
    """(N + 1,)"""
    estimate: Int64
    """(P,) ascending within a row."""
    likeness: Float64
    """(P,)"""

    def __post_init__(self) -> None:
        steps, one = ("i8", ("S1",)), ("f8", ("P",))
        freeze_fields(
            self, truth_start=steps, estimate_start=steps, start=("i8", ("N1",)), estimate=("i8", ("P",)), likeness=one
        )  # fmt: skip


def pairs_within(truth: Objects, estimates: Objects, num_steps: int, likeness: Likeness, least: float) -> Pairs:
    """Return the pairs whose distance, 1 - intersection over union, is at most 1 - `least`.

    That is AB3DMOT's rule, which rounds the difference; the object benchmark's, above `least`, is stricter.
    """
    starts = truth.starts(num_steps), estimates.starts(num_steps)
    similarity, _ = blocks(truth, estimates, *starts, likeness)
    row, column = pairs_of(*starts)
    near: Bool = 1 - similarity <= 1 - least
    row = row[near]
    return Pairs(*starts, np.searchsorted(row, np.arange(len(truth) + 1)), column[near], similarity[near])
