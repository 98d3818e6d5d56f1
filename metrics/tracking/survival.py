"""Survival of occlusions: whether tracks keep their id while what they follow can't be seen."""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from fbench.metrics.core.exact import Counts
from fbench.metrics.core.problem import Problem
from fbench.metrics.core.slices import ScoreKey
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Steps

LENGTHS_S = (0.0, 0.5, 1.0, 2.0, np.inf)
HIDDEN_BELOW = 0.2  # Truth boxes with a smaller visible share count as hidden


@dataclass(frozen=True)
class SurvivalCounts(Counts):
    """Occlusions of truth tracks by length: after how many the object had the id that it had before."""

    occlusions: tuple[int, ...] = (0,) * (len(LENGTHS_S) - 1)
    survived: tuple[int, ...] = (0,) * (len(LENGTHS_S) - 1)
    untimed: int = 0  # Occlusions of unknown length: frames have no stamps
    untimed_survived: int = 0


def survival_counts(problem: Problem, partner_id: Int64, visibility: Float64 | None, steps: Steps) -> SurvivalCounts:
    """Count the occlusions of one class of one sequence.

    An occlusion is a stretch between two steps of a stream at which a truth track is seen, through which it isn't:
    hidden, or without a box that counts. Its length is the time between the two, where stamps are known. It counts
    where the object was tracked since the occlusion before it, if any; the id then, at the last match, must be the id
    at the first match after it. An object that isn't found again before its next occlusion, or its end, didn't survive.
    `partner_id` (N,) is the id of the estimate that each truth box was matched to, -1: none; `visibility` (N,) the
    visible share; NaN or `None`: seen.
    """
    seen = np.ones(len(problem.truth_id), bool) if visibility is None else ~(visibility < HIDDEN_BELOW)
    counts = np.zeros((2, len(LENGTHS_S)), np.int64)  # in front those of unknown length
    step_of, place = np.repeat(np.arange(len(steps)), np.diff(problem.pairs.row_start)), steps.places
    order = np.argsort(problem.truth_id, kind="stable")
    order = order[problem.truth_id[order] >= 0]
    for track in np.split(order, np.flatnonzero(np.diff(problem.truth_id[order])) + 1):
        rows = track[seen[track]]
        at = step_of[rows]
        breaks = np.flatnonzero(np.diff(place[at]) > 1) + 1
        stretches = np.split(partner_id[rows], breaks)
        for gap, (before, after) in zip(breaks, itertools.pairwise(stretches), strict=True):
            had = before[before >= 0]
            if len(had):
                length = (steps.stamp_ns[at[gap]] - steps.stamp_ns[at[gap - 1]]) * 1e-9
                which = int(np.searchsorted(LENGTHS_S, length, side="left"))
                found = after[after >= 0]
                counts[:, which] += (1, bool(len(found) and found[0] == had[-1]))
    (untimed, *occlusions), (untimed_survived, *survived) = counts.tolist()
    return SurvivalCounts(tuple(occlusions), tuple(survived), untimed, untimed_survived)


def survival_rows(n: SurvivalCounts, head: ScoreKey, reason: str | None) -> list[Score]:
    """Return the share of occlusions that were survived: of all, then by length."""
    total = {"occlusions": sum(n.occlusions) + n.untimed, "survived": sum(n.survived) + n.untimed_survived}
    bottom, name = 0 if reason else total["occlusions"], "occlusion_survival"
    rows = [head.ratio(name, total["survived"], bottom, reason or "no tracked object was occluded", total)]
    if not bottom:
        return rows
    why = "no tracked object was occluded that long" if any(n.occlusions) else "frames have no stamps"
    for low, high, num, kept in zip(LENGTHS_S[:-1], LENGTHS_S[1:], n.occlusions, n.survived, strict=True):
        part = f"occlusion over {low:g} s" if high == np.inf else f"occlusion {low:g}-{high:g} s"
        own = replace(head, slice=part if head.slice == "all" else f"{head.slice}, {part}")
        rows.append(own.ratio(name, kept, num, why, {"occlusions": num, "survived": kept}))
    return rows
