"""From a sequence to what the matcher needs for one class."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fbench.metrics.matching.blocks import Blocks, pairs_of
from fbench.metrics.matching.similarity import blocks, image_overlaps
from fbench.metrics.objects import Objects
from fbench.metrics.profile import Match
from fbench.metrics.sequence import Sequence
from fbench.metrics.standard.groups import Group
from fbench.metrics.standard.slices import Part
from fbench.metrics.validity import is_valid
from fbench.replay.arrays import Bool, Float64, Int64


@dataclass(frozen=True, eq=False)
class Alike:
    """T truth boxes of a sequence and the M estimates of one class, and how alike they are."""

    sequence: Sequence
    must: Bool
    """(T,) truth boxes to be found; the others may excuse estimates."""
    estimate_row: Int64
    """(M,) rows of the sequence's estimates."""
    similarity: Blocks
    """(T, M), higher is nearer; -inf for invalid estimates."""
    excuse: Blocks
    """(T, M), as `similarity`, or the share of the estimate that is in the truth box; -inf where the box couldn't
    excuse the estimate if it needn't be found."""
    match: Match
    invalid: Bool
    """(M,) estimates that aren't finite, or have negative sizes."""


@dataclass(frozen=True, eq=False)
class Counted:
    """One class of a sequence, or of a part of it: N truth boxes to be found, M estimates, K truth boxes that may
    excuse estimates.
    """

    sequence: Sequence
    truth_row: Int64
    """(N,) rows of the sequence's truth."""
    rest_row: Int64
    """(K,) its other rows."""
    estimate_row: Int64
    """(M,) rows of the sequence's estimates."""
    similarity: Blocks
    """(N, M), higher is nearer; -inf for invalid estimates."""
    excuse: Blocks
    """(K, M), as `similarity`; -inf where the box doesn't excuse the estimate."""
    match: Match
    inside: Bool
    """(M,) false for estimates outside the region: they can be hits but no false alarms."""
    invalid: Bool
    """(M,) estimates that aren't finite, or have negative sizes."""

    @cached_property
    def truth(self) -> Objects:
        """The N truth boxes."""
        return self.sequence.truth[self.truth_row]

    @cached_property
    def estimates(self) -> Objects:
        """The M estimates."""
        return self.sequence.estimates[self.estimate_row]

    @property
    def score(self) -> Float64:
        """(M,) of the estimates."""
        return self.sequence.estimates.score[self.estimate_row]

    @property
    def shared_excuse(self) -> bool:
        """Whether one box can excuse several estimates."""
        return self.match.likeness == "iou2d"


def alike(sequence: Sequence, group: Group, match: Match) -> Alike:
    """Compare all truth with the estimates of one class.

    In space a truth box that needn't be found excuses one estimate that matches it. In images it excuses all estimates
    that lie in it with at least the match's share, as KITTI does for its regions: they are larger than what is in
    them, and hold any number of objects.

    Raises:
        MetricError: where boxes lack what the match compares.
    """
    truth, estimate_row = sequence.truth, np.flatnonzero(group.holds(sequence.estimates))
    estimates = sequence.estimates[estimate_row]
    starts = [objects.starts(len(sequence.steps)) for objects in (truth, estimates)]
    invalid = ~is_valid(estimates, match.likeness)
    values, start = blocks(truth, estimates, starts[0], starts[1], match.likeness, sequence.ego_m)
    pairs = pairs_of(starts[0], starts[1])
    if match.likeness == "iou2d":
        shares, _ = image_overlaps(truth, estimates, starts[0], starts[1], np.ones(len(truth), bool))
    else:
        shares = values
    usable = ~invalid[pairs[1]]
    excused = usable & group.excuses(truth, estimates, pairs)
    similarity, excuse = (
        Blocks(starts[0], starts[1], start, np.where(held, numbers, -np.inf))
        for held, numbers in ((usable, values), (excused, shares))
    )
    return Alike(sequence, group.counts(truth), estimate_row, similarity, excuse, match, invalid)


def counted(pairs: Alike, part: Part | None = None) -> Counted:
    """Select what counts: of the whole sequence, or of a part of it."""
    rows, num = pairs.estimate_row, len(pairs.estimate_row)
    estimates = pairs.sequence.estimates
    inside = np.ones(num, bool) if estimates.inside is None else estimates.inside[rows]
    must, given = pairs.must, np.ones(num, bool)
    if part is not None:
        must, inside = must & part.truth, inside & part.estimates[rows]
        given = part.estimates[rows] | ~pairs.invalid  # elsewhere, what isn't valid is nobody's false alarm
        given = given if part.given is None else given & part.given[rows]
    return Counted(
        pairs.sequence, np.flatnonzero(must), np.flatnonzero(~must), rows[given], pairs.similarity.select(must, given),
        pairs.excuse.select(~must, given), pairs.match, inside[given], pairs.invalid[given],
    )  # fmt: skip
