"""CLEAR MOT, identity, HOTA and survival of occlusions, all of the same boxes."""

from collections.abc import Sequence as Sequence_of_abc
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np

from fbench.metrics.core.problem import Problem
from fbench.metrics.core.sequence import Sequence
from fbench.metrics.core.slices import Group, Heading, Part
from fbench.metrics.detection.outcomes import BoxCounts, Counted, Judgement, Outcome, alike, counted, judge_tracks
from fbench.metrics.profiles.profile import Match
from fbench.metrics.tracking.clear import ClearCounts, ClearPairs, ClearRules, clear_counts, clear_pairs
from fbench.metrics.tracking.hota import HotaCounts, hota_counts
from fbench.metrics.tracking.identity import IdentityCounts, identity_counts
from fbench.metrics.tracking.survival import SurvivalCounts, survival_counts, survival_rows
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.scores import Score, ratio


@dataclass(frozen=True)
class TrackingCounts:
    """Sufficient statistics of one class."""

    boxes: BoxCounts = field(default_factory=BoxCounts)
    clear: ClearCounts = field(default_factory=ClearCounts)
    identity: IdentityCounts = field(default_factory=IdentityCounts)
    hota: HotaCounts = field(default_factory=HotaCounts)
    survival: SurvivalCounts = field(default_factory=SurvivalCounts)
    num_truth_ids: int = 0  # Truth boxes with an id
    num_estimates: int = 0
    num_estimate_ids: int = 0  # Estimates with an id

    def __add__(self, other: "TrackingCounts") -> "TrackingCounts":
        return TrackingCounts(
            self.boxes + other.boxes, self.clear + other.clear, self.identity + other.identity,
            self.hota + other.hota, self.survival + other.survival, self.num_truth_ids + other.num_truth_ids,
            self.num_estimates + other.num_estimates, self.num_estimate_ids + other.num_estimate_ids,
        )  # fmt: skip


def clear_rules(match: Match) -> ClearRules:
    """Return fbench's own rules: a pair of the previous step stays while it is inside the threshold; the rest is
    matched for most pairs, then best total.
    """
    offset = match.threshold if match.is_distance else 0.0
    return ClearRules(floor=match.floor, margin=0.0, offset=offset, settle_first=True, most_pairs=True)


@dataclass(frozen=True, eq=False)
class Followed:
    """Which truth each track was on, step by step, in one class of one sequence."""

    counted: Counted
    judgement: Judgement  # Of each step alone: what is left out
    used: Bool  # (M,) estimates that aren't left out
    problem: Problem  # Of the used estimates
    pairs: ClearPairs  # Partners, as rows of the problem


def followed(sequence: Sequence, group: Group, match: Match, part: Part | None = None) -> Followed:
    """Match one class of one sequence, or of a part of it.

    What doesn't count (outside the region, or on truth that needn't be found) is found out first, step by step, and
    left out, so that all metrics see the same boxes. A box without id is a track of its own. Raises MetricError where
    boxes lack what the match compares.
    """
    held = counted(alike(sequence, group, match), part)
    found = _followed(held, judge_tracks(held))
    left = _left_outside(found)
    return _followed(held, _without(found.judgement, left)) if left.any() else found


def _followed(held: Counted, judgement: Judgement) -> Followed:
    used = (judgement.outcome != Outcome.OUTSIDE) & (judgement.outcome != Outcome.EXCUSED)
    problem = _problem(held.sequence, held, used)
    return Followed(held, judgement, used, problem, clear_pairs(problem, clear_rules(held.match)))


def _left_outside(found: Followed) -> Bool:
    """Tell which estimates (M,) are outside of the region and lost their truth to the pair of the step before."""
    held, partner = found.counted, np.full(len(found.used), -1)
    partner[found.used] = found.pairs.truth_of
    return np.asarray(found.used & (partner < 0) & ~held.inside & ~held.invalid, bool)


def _without(judgement: Judgement, left: Bool) -> Judgement:
    outcome = np.where(left, np.int8(Outcome.OUTSIDE), judgement.outcome)
    return replace(judgement, outcome=outcome, truth_of_estimate=np.where(left, -1, judgement.truth_of_estimate))


def tracking_counts(sequence: Sequence, group: Group, match: Match, part: Part | None = None) -> TrackingCounts:
    """Match and count one class of one sequence, or of a part of it, see `followed`. Raises MetricError where boxes
    lack what the match compares.
    """
    found = followed(sequence, group, match, part)
    held, used, problem, pairs = found.counted, found.used, found.problem, found.pairs
    clear = replace(clear_counts(problem, clear_rules(match), pairs), switches=_switches(held, used, problem, pairs))
    likeness = replace(problem, similarity=_zero_to_one(problem.similarity, match))
    truth, estimates = held.truth, held.estimates
    boxes = replace(found.judgement.counts, tp=clear.tp, fp=clear.fp, fn=clear.fn)
    return TrackingCounts(
        boxes, clear, identity_counts(problem, match.floor), hota_counts(likeness),
        survival_counts(problem, _partner_ids(problem, pairs), truth.visibility, sequence.steps),
        int((truth.track_id >= 0).sum()), int(used.sum()), int((estimates.track_id[used] >= 0).sum()),
    )  # fmt: skip


def require_unique_ids(sequence: Sequence, where: str = "") -> None:
    """Refuse a sequence in which an id occurs twice at one step.

    Raises MetricError naming frame and id (fault GT003).
    """
    for what, objects in (("truth", sequence.truth), ("tracks", sequence.estimates)):
        named = objects.track_id >= 0
        both = np.column_stack([objects.step[named], objects.track_id[named]])
        pairs, times = np.unique(both, axis=0, return_counts=True)
        if (times > 1).any():
            step, twice = pairs[times > 1][0].tolist()
            steps = sequence.steps
            image = f", camera {steps.camera[step]}" if steps.camera else ""
            raise MetricError(
                f"{where or sequence.name}: frame {steps.frame[step]}{image}: {what} has id {twice} twice; "
                "an id names one object of a frame",
                "GT003",
            )


def _problem(sequence: Sequence, held: Counted, used: Bool) -> Problem:
    num_steps, steps = len(sequence.steps), sequence.steps
    estimates = held.estimates[used]
    columns = used[held.similarity.pairs[1]]
    truth_start, estimate_start = held.truth.starts(num_steps), estimates.starts(num_steps)
    sizes = np.diff(truth_start) * np.diff(estimate_start)
    return Problem(
        truth_start, estimate_start, np.concatenate([[0], np.cumsum(sizes)]), held.similarity.values[columns],
        steps.stream, _dense(held.truth.track_id, steps.stream[held.truth.step]),
        _dense(estimates.track_id, steps.stream[estimates.step]), estimates.score, held.truth_row,
        held.estimate_row[used],
    )  # fmt: skip


def _dense(ids: Int64, stream: Int64) -> Int64:
    """Number tracks from 0 on; an id in two streams is two tracks, a box without id one of its own."""
    alone = np.where(ids < 0, np.arange(len(ids)), -1)
    return np.unique(np.column_stack([stream, ids, alone]), axis=0, return_inverse=True)[1].reshape(-1)


def _switches(held: Counted, used: Bool, problem: Problem, pairs: ClearPairs) -> int:
    """Matches of a truth track with another id than at its last match; matches without an id don't count."""
    if (held.estimates.track_id[used] >= 0).all():
        return int(pairs.is_switch.sum())
    rows = np.flatnonzero(pairs.estimate_of >= 0)
    track = held.estimates.track_id[used][pairs.estimate_of[rows]]
    rows, track = rows[track >= 0], track[track >= 0]
    truth = problem.truth_id[rows]
    order = np.argsort(truth, kind="stable")
    return int(((np.diff(truth[order]) == 0) & (np.diff(track[order]) != 0)).sum())


def _partner_ids(problem: Problem, pairs: ClearPairs) -> Int64:
    """(N,) track that each truth box was matched to; -1: none."""
    ids = np.append(problem.estimate_id, -1)
    return np.asarray(ids[pairs.estimate_of], np.int64)


def _zero_to_one(similarity: Float64, match: Match) -> Float64:
    """Distances become 1 - d / threshold, as TrackEval has it for 3D (`_calculate_euclidean_similarity`)."""
    if not match.is_distance:
        return np.maximum(similarity, 0.0)
    return np.asarray(np.maximum(1.0 + similarity / match.threshold, 0.0))


def tracking_rows(n: TrackingCounts, head: Heading, unit: str) -> list[Score]:
    """Return the rows of one class, MOTA first.

    Args:
        n: What was counted.
        head: What it is of.
        unit: Of MOTP: `m` where boxes match by distance, else `iou`.
    """
    nothing = head.reason or (None if n.boxes.gt else "no truth boxes")
    undefined = nothing or _no_ids(n)
    rows = _clear_rows(n, head, nothing, undefined, unit)
    rows += _identity_rows(n, head, undefined)
    rows += _hota_rows(n.hota, head, undefined)
    return rows + survival_rows(n.survival, head.class_, head.matching, undefined, head.slice)


def _clear_rows(
    n: TrackingCounts, head: Heading, nothing: str | None, undefined: str | None, unit: str
) -> list[Score]:  # fmt: skip
    boxes, clear = n.boxes, n.clear
    counts = {**boxes.named(with_predicted=False), "gt": boxes.gt, "idsw": clear.switches, "frames": head.num_frames}
    gt, why = (0 if undefined else boxes.gt), undefined or ""
    found = boxes.gt - boxes.fn - clear.switches
    total = abs(float(clear.similarity)) if unit == "m" else float(clear.similarity)
    of = head.class_, head.matching
    rows = [
        ratio("mota", *of, found - boxes.fp, gt, why, counts, part=head.slice),
        ratio("mota_no_fp", *of, found, gt, why, counts, part=head.slice),
        ratio(
            "motp", *of, total, boxes.tp, nothing or "no matches",
            {**counts, "similarity_sum": float(clear.similarity)}, unit, head.slice,
        ),
    ]  # fmt: skip
    lives = {"mt": clear.mostly_tracked, "pt": clear.partly_tracked, "ml": clear.mostly_lost}
    tracks = {**lives, "tracks": clear.num_tracks}
    rows.append(_count("idsw", clear.switches, head, undefined, counts))
    rows.append(_count("frag", clear.fragmentations, head, undefined, {"frag": clear.fragmentations}))
    return rows + [_count(name, num, head, undefined, tracks) for name, num in lives.items()]


def _count(name: str, num: int, head: Heading, undefined: str | None, counts: dict[str, int]) -> Score:
    value = None if undefined else float(num)
    return Score(name, head.class_, head.slice, head.matching, value, undefined, "1", counts)


def _identity_rows(n: TrackingCounts, head: Heading, undefined: str | None) -> list[Score]:
    i = n.identity
    counts = {"idtp": i.tp, "idfp": i.fp, "idfn": i.fn}
    table = (("idf1", i.tp + i.fp / 2 + i.fn / 2), ("idp", i.tp + i.fp), ("idr", i.tp + i.fn))
    return [
        ratio(
            name, head.class_, head.matching, i.tp, 0 if undefined else bottom, undefined or "no tracks", counts,
            part=head.slice,
        )
        for name, bottom in table
    ]  # fmt: skip


def _hota_rows(n: HotaCounts, head: Heading, undefined: str | None) -> list[Score]:
    """Means over the 19 thresholds."""
    tp, gt, estimates = sum(n.tp), n.tp[0] + n.fn[0], n.tp[0] + n.fp[0]
    counts = {"gt": gt, "estimates": estimates, "tp_sum": tp}
    det = [_share(t, t + fn + fp) for t, fn, fp in zip(n.tp, n.fn, n.fp, strict=True)]
    ass = [_share(a, t) for a, t in zip(n.ass_a, n.tp, strict=True)]
    loc = [_share(s, t) for s, t in zip(n.similarity, n.tp, strict=True) if t]
    values = (
        ("hota", _mean([(d * a) ** 0.5 for d, a in zip(det, ass, strict=True)]), undefined),
        ("deta", _mean(det), undefined),
        ("assa", _mean(ass), undefined),
        ("loca", _mean(loc) if loc else None, undefined or (None if loc else "no matches")),
    )
    return [
        Score(name, head.class_, head.slice, head.matching, None if why else value, why, "1", counts)
        for name, value, why in values
    ]


def _share(top: int | Fraction, bottom: int) -> float:
    return float(top / bottom) if bottom else 0.0


def _mean(values: Sequence_of_abc[float]) -> float:
    return sum(values) / len(values)


def _no_ids(n: TrackingCounts) -> str | None:
    if not n.num_truth_ids:
        return "truth has no track ids"
    return "tracks have no ids" if n.num_estimates and not n.num_estimate_ids else None
