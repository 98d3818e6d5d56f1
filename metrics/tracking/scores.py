"""CLEAR MOT, identity, HOTA and survival of occlusions, all of the same boxes."""

from dataclasses import dataclass, field, replace

import numpy as np

from fbench.metrics.core.exact import Counts
from fbench.metrics.core.matching import match_best
from fbench.metrics.core.ordering import find_twice, number_tracks
from fbench.metrics.core.problem import Problem
from fbench.metrics.core.slices import Group, Part, ScoreKey
from fbench.metrics.detection.outcomes import BoxCounts, Judgement, Outcome, compare_class, judge
from fbench.metrics.tracking.clear import ClearCounts, ClearPairs, ClearRules, clear_counts, clear_pairs
from fbench.metrics.tracking.clear_events import SWITCH
from fbench.metrics.tracking.hota import HotaCounts, hota_counts
from fbench.metrics.tracking.identity import IdentityCounts, identity_counts
from fbench.metrics.tracking.survival import SurvivalCounts, survival_counts, survival_rows
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Int64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence


@dataclass(frozen=True)
class TrackingCounts(Counts):
    """Sufficient statistics of one class."""

    boxes: BoxCounts = field(default_factory=BoxCounts)
    clear: ClearCounts = field(default_factory=ClearCounts)
    identity: IdentityCounts = field(default_factory=IdentityCounts)
    hota: HotaCounts = field(default_factory=HotaCounts)
    survival: SurvivalCounts = field(default_factory=SurvivalCounts)
    num_truth_ids: int = 0  # Truth boxes with an id
    num_estimates: int = 0
    num_estimate_ids: int = 0  # Estimates with an id


def follow_tracks(
    sequence: Sequence, group: Group, match: Match, part: Part | None = None
) -> tuple[Judgement, Problem, ClearPairs]:
    """Match one class of one sequence, or of a part of it, step by step: most pairs, then most estimates inside the
    region, then the best total. What doesn't count (outside the region, or on truth that needn't be found) is found out
    first, each step alone, and left out, so that all metrics see the same boxes; a box without id is a track of its
    own. Returns what became of each box, and the problem of those that count with its pairs. Raises MetricError where
    boxes lack what the match compares.
    """
    c = compare_class(sequence, group, match)
    c = c if part is None else c.select(part)
    judgement = judge(c, match_best(c.similarity, match.floor, ~c.inside), by_score=False)
    problem, pairs, partner = _follow(judgement)
    # Estimates outside of the region that lost their truth to the pair of the step before are no false alarms.
    left = judgement.is_used & (partner < 0) & ~c.inside & ~c.invalid
    if left.any():
        judgement = replace(judgement, outcome=np.where(left, np.int8(Outcome.OUTSIDE), judgement.outcome))
        problem, pairs, partner = _follow(judgement)
    made = np.where(partner >= 0, Outcome.HIT, np.where(c.invalid, Outcome.INVALID, Outcome.FALSE_ALARM))
    return Judgement(c, partner, np.where(judgement.is_used, made, judgement.outcome).astype(np.int8)), problem, pairs


def _clear_rules(match: Match) -> ClearRules:
    """A pair of the previous step stays while inside the threshold; the rest: most pairs, then best total."""
    offset = match.threshold if match.is_distance else 0.0
    return ClearRules(floor=match.floor, margin=0.0, offset=offset, settle_first=True, most_pairs=True)


def _follow(judgement: Judgement) -> tuple[Problem, ClearPairs, Int64]:
    """The problem of the estimates that count, its pairs, and the truth box (M,) of each estimate; -1: none."""
    candidates, used = judgement.candidates, judgement.is_used
    sequence, rows = candidates.sequence, (candidates.truth_row, candidates.estimate_row[used])
    stream, similarity = sequence.steps.stream, candidates.similarity.select(np.ones(len(rows[0]), bool), used)
    sides = tuple(zip((sequence.truth, sequence.estimates), rows, strict=True))
    ids = (objects.track_id[own] for objects, own in sides)
    # Those without an id are tracks of their own.
    alone = (np.where(own < 0, np.arange(len(own)) - len(own), own) for own in ids)
    truth_id, estimate_id = map(number_tracks, alone, (stream[objects.step[own]] for objects, own in sides))
    problem = Problem(similarity, stream, truth_id, estimate_id, *rows)
    pairs, partner = clear_pairs(problem, _clear_rules(candidates.match)), np.full(len(used), -1)
    partner[used] = pairs.truth_of
    return problem, pairs, partner


def tracking_counts(sequence: Sequence, group: Group, match: Match, part: Part | None = None) -> TrackingCounts:
    """Match and count one class, see `follow_tracks`. MetricError where boxes lack what the match compares."""
    judgement, problem, pairs = follow_tracks(sequence, group, match, part)
    truth, track_id = judgement.candidates.truth, judgement.candidates.estimates.track_id[judgement.is_used]
    switches = pairs.count(SWITCH)
    if (track_id < 0).any():  # matches without an id don't count
        rows = np.flatnonzero(np.append(track_id, -1)[pairs.estimate_of] >= 0)
        rows = rows[np.argsort(problem.truth_id[rows], kind="stable")]
        is_same, track = np.diff(problem.truth_id[rows]) == 0, track_id[pairs.estimate_of[rows]]
        switches = int((is_same & (np.diff(track) != 0)).sum())
    partner_id = np.append(problem.estimate_id, -1)[pairs.estimate_of]
    return TrackingCounts(
        judgement.counts, replace(clear_counts(problem, _clear_rules(match), pairs), switches=switches),
        identity_counts(problem, match.floor), hota_counts(problem.overlaps(match)),
        survival_counts(problem, partner_id, truth.visibility, sequence.steps),
        int((truth.track_id >= 0).sum()), len(track_id), int((track_id >= 0).sum()),
    )  # fmt: skip


def require_unique_ids(sequence: Sequence, where: str = "") -> None:
    """Refuse a sequence in which an id occurs twice at one step.

    Raises MetricError naming frame and id (fault GT003).
    """
    for what, objects in (("truth", sequence.truth), ("tracks", sequence.estimates)):
        named, steps = np.flatnonzero(objects.track_id >= 0), sequence.steps
        if (row := find_twice(objects.step[named], objects.track_id[named])) is not None:
            step = objects.step[named[row]]
            image = f", camera {steps.camera[step]}" if steps.camera else ""
            raise MetricError(
                f"{where or sequence.name}: frame {steps.frame[step]}{image}: {what} has id "
                f"{objects.track_id[named[row]]} twice; an id names one object of a frame",
                "GT003",
            )


def tracking_rows(n: TrackingCounts, head: ScoreKey, unit: str) -> list[Score]:
    """Return the rows of one class, MOTA first, those of HOTA as means over its 19 thresholds.

    `unit` is that of MOTP: `m` where boxes match by distance, else `iou`.
    """
    boxes, clear, i, h = n.boxes, n.clear, n.identity, n.hota
    nothing = undefined = head.reason or (None if boxes.gt else "no truth boxes")
    if nothing is None and not n.num_truth_ids:
        undefined = "truth has no track ids"
    elif nothing is None and n.num_estimates and not n.num_estimate_ids:
        undefined = "tracks have no ids"
    why, gt, found = undefined or "", 0 if undefined else boxes.gt, boxes.gt - boxes.fn - clear.switches
    counts = {**boxes.as_dict(), "gt": boxes.gt, "idsw": clear.switches, "frames": head.num_frames}
    similarity = float(clear.similarity)
    total, with_sum = abs(similarity) if unit == "m" else similarity, {**counts, "similarity_sum": similarity}
    lives = {"mt": clear.mostly_tracked, "pt": clear.partly_tracked, "ml": clear.mostly_lost}
    of_lives = {**lives, "tracks": clear.num_tracks}

    of_ids = {"idtp": i.tp, "idfp": i.fp, "idfn": i.fn}
    bottoms = {"idf1": i.tp + i.fp / 2 + i.fn / 2, "idp": i.tp + i.fp, "idr": i.tp + i.fn}

    of_hota = {"gt": h.tp[0] + h.fn[0], "estimates": h.tp[0] + h.fp[0], "tp_sum": sum(h.tp)}
    det = [float(t / (t + fn + fp)) if t + fn + fp else 0.0 for t, fn, fp in zip(h.tp, h.fn, h.fp, strict=True)]
    ass = [float(a / t) if t else 0.0 for a, t in zip(h.ass_a, h.tp, strict=True)]
    loc = [float(s / t) for s, t in zip(h.similarity, h.tp, strict=True) if t]
    means = {"hota": [(d * a) ** 0.5 for d, a in zip(det, ass, strict=True)], "deta": det, "assa": ass}
    loca, no_loca = (sum(loc) / len(loc), undefined or "") if loc else (None, undefined or "no matches")
    return [
        head.ratio("mota", found - boxes.fp, gt, why, counts),
        head.ratio("mota_no_fp", found, gt, why, counts),
        head.ratio("motp", total, boxes.tp, nothing or "no matches", with_sum, unit),
        head.score("idsw", float(clear.switches), undefined, counts),
        head.score("frag", float(clear.fragmentations), undefined, {"frag": clear.fragmentations}),
        *(head.score(name, float(num), undefined, of_lives) for name, num in lives.items()),
        *(head.ratio(m, i.tp, 0 if undefined else own, undefined or "no tracks", of_ids) for m, own in bottoms.items()),
        *(head.score(name, sum(own) / len(own), undefined, of_hota) for name, own in means.items()),
        head.score("loca", loca, no_loca, of_hota),
        *survival_rows(n.survival, head, undefined),
    ]
