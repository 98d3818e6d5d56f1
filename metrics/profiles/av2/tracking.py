"""The profile `av2-tracking`: HOTA, MOTA and AMOTA at scores that are tuned by class."""

from dataclasses import asdict, dataclass, replace
from functools import reduce
from operator import add
from typing import ClassVar, NamedTuple, Self

import numpy as np
from scipy.optimize import linear_sum_assignment

from fbench.metrics.core.problem import Problem
from fbench.metrics.profiles.av2.boxes import CLASSES, LeftOut, check_places, select_side
from fbench.metrics.profiles.trackeval import fields as of
from fbench.metrics.profiles.trackeval.fields import LABELS, ClassCounts, Field
from fbench.metrics.profiles.trackeval.prepare import ClassRule, Preparation, problems
from fbench.metrics.tracking.clear import TRACKEVAL_RULES, clear_counts
from fbench.metrics.tracking.hota import HotaCounts, hota_counts
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.arrays import Float64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

_AT_BEST = ("hota", "deta", "assa", "loca", "mota", "motp", "clr_re", "clr_pr", "clr_tp", "clr_fp", "clr_fn", "idsw",
            "frag", "mt", "ml")  # fmt: skip
"""What is said at the score with the best HOTA."""
_TUNED = ("hota_mean", "best_mota", "amota")
_PREPARATION = Preparation(
    tuple(ClassRule(name, frozenset({name})) for name in CLASSES), excuse_floor=None, drops_ignored=True
)
_MATCH = Match("bev", 2.0)  # From this distance on, boxes have no similarity


@dataclass(frozen=True, eq=False)
class Clip:
    """One class of one sequence."""

    sequence: str
    kind: int  # Index in `CLASSES`
    problem: Problem  # Similarities max(0, 1 - distance / limit)
    score: Float64  # (M,) of its estimates; infinite where it isn't finite
    matched: Float64  # (K,) scores of the estimates that a best assignment of each frame takes


@dataclass(frozen=True, eq=False)
class TrackingStatistics:
    """Clips of any number of sequences; their order doesn't matter."""

    clips: tuple[Clip, ...]
    left_out: LeftOut

    def __add__(self, other: "TrackingStatistics") -> "TrackingStatistics":
        return TrackingStatistics(self.clips + other.clips, self.left_out + other.left_out)


class _Tuned(NamedTuple):
    """One class over all sequences: what counts at the score with the best HOTA, and what was tuned."""

    counts: ClassCounts
    threshold: float
    hota_mean: float
    best_mota: float
    amota: float


@dataclass(frozen=True)
class Av2Tracking:
    """Argoverse 2's tracking challenge as av2-api 0.3.6 counts it with TrackEval 1.3.0, without its region of interest.

    1. Boxes up to 50 m from the ego in the ground plane count. Two boxes d apart in the ground plane have the
       similarity max(0, 1 - d / 2 m).
    2. Of each class, ten scores are tried: those at which recalls of 1, 0.9 ... 0.1 would be reached. Its quirk: pairs
       that are too far apart for any similarity count as hits here. A recall that isn't reached has the score 0.
    3. `hota` is the best over these scores, `hota_mean` the mean. `best_mota` and `amota` are the same of MOTA, floored
       at 0. All else is at the score with the best HOTA. CLEAR matches from a similarity of 0.5 on, so within 1 m.

    The challenge measures distances in the city's ground plane, fbench in that of the boxes' coordinates: in body
    coordinates they differ by the tilt of the vehicle. Where several pairings are equally good, the order of rows
    decides, as in the tool (`order: as given`).
    """

    preparation: Preparation = _PREPARATION
    match: Match = _MATCH
    range_m: float = 50.0
    num_scores: int = 10
    min_recall: float = 0.1
    name: str = "av2-tracking"
    summary: str = "the tracking challenge of Argoverse 2 as av2-api 0.3.6 counts it: HOTA, MOTA, AMOTA"

    facts: ClassVar[Facts] = Facts(
        judges_tracks=True, space="3d", family="av2",
        headlines=Headlines(("hota", "amota", "mota", "motp", "hota_mean", "best_mota", *_AT_BEST[1:4], *_AT_BEST[6:])),
    )  # fmt: skip

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(CLASSES)

    def with_match(self, match: Match) -> Self:
        """Return the profile with another distance of similarity 0. ConfigError if not of centers on the ground."""
        if match.kind != "bev":
            raise ConfigError(f"{self.name} matches by center distance only, such as bev:2, not {match}")
        return replace(self, match=match)

    def measure(self, sequence: Sequence) -> TrackingStatistics:
        """Return what can be matched in one sequence. Raises MetricError where it can't be scored: an id twice in a
        frame (GT003), boxes without id, or without a place in space.
        """
        check_places(sequence)
        truth, estimates = (
            select_side(sequence, boxes, self.range_m, in_plane=True) for boxes in (sequence.truth, sequence.estimates)
        )
        sound = ~truth.invalid
        ignored = np.zeros(len(sound), bool) if truth.boxes.ignore is None else truth.boxes.ignore
        left_out = LeftOut(
            **estimates.left_out, **{f"{name}_truth": n for name, n in truth.left_out.items()},
            ignored_truth=int(ignored.sum()), invalid=int(estimates.invalid.sum()),
            invalid_truth=int((~sound).sum()) + sequence.num_invalid_truth,
        )  # fmt: skip
        near = replace(sequence, truth=truth.boxes[sound], estimates=estimates.boxes)
        clips = []
        for kind, problem in enumerate(problems(near, self.preparation, self.match)):
            if any(problem.pairs.shape):
                score = near.estimates.score[problem.estimate_row]
                own = problem.overlaps(self.match)
                clips.append(
                    Clip(sequence.name, kind, own, np.where(np.isfinite(score), score, np.inf), _match(own, score))
                )
        return TrackingStatistics(tuple(clips), left_out)

    def scores(self, statistics: TrackingStatistics, part: str) -> list[Score]:
        """Return means over classes with truth (sums of counts), then the numbers of each class."""
        clips = sorted(statistics.clips, key=lambda clip: clip.sequence)
        tuned = {name: self._tune([clip for clip in clips if clip.kind == kind]) for kind, name in enumerate(CLASSES)}
        found = {name: one for name, one in tuned.items() if one.counts.clear.num_truth}
        values = {name: self._fields(one) for name, one in tuned.items()}
        general: dict[str, int | float] = {
            "gt": sum(one.counts.clear.num_truth for one in found.values()),
            "classes_without_truth": len(tuned) - len(found), **asdict(statistics.left_out),
        }  # fmt: skip
        rows = []
        for place, metric in enumerate((*_AT_BEST, *_TUNED)):
            fields = [values[name][place] for name in found]
            if not fields:
                rows.append(Score(metric, "all", part, str(self.match), None, "no truth boxes", "1", general))
                continue
            total = sum(field.printed for field in fields)
            value = total if fields[0].is_count else total / len(fields)
            rows.append(Score(metric, "all", part, str(self.match), value, None, "1", general))
        for name, one in tuned.items():
            counts: dict[str, int | float] = {"gt": one.counts.clear.num_truth, "score": one.threshold}
            counts |= of.clear_raw(one.counts.clear)
            for field in values[name]:
                shown = field if name in found else field._replace(value=None, why="no truth boxes")
                rows.append(shown.score(name, part, str(self.match), counts))
        return rows

    def _fields(self, one: _Tuned) -> list[Field]:
        hota = of.mean_fields([of.alpha_fields(one.counts.hota, a) for a in range(len(LABELS))])
        known = {field.metric: field for field in (*hota, *of.clear_fields(one.counts.clear, is_distance=False))}
        values = (of.plain_field(name, getattr(one, name)) for name in _TUNED)
        return [*(known[name] for name in _AT_BEST), *values]

    def _tune(self, clips: list[Clip]) -> _Tuned:
        nothing = _Tuned(ClassCounts(), 0.0, 0.0, 0.0, 0.0)
        if not clips:
            return nothing
        cache: dict[float, ClassCounts] = {}
        thresholds = self._thresholds(clips)
        for threshold in thresholds.tolist():
            if threshold not in cache:
                cache[threshold] = reduce(add, (_count(clip, threshold) for clip in clips))
        tried = [cache[threshold] for threshold in thresholds.tolist()]
        if not tried[0].clear.num_truth:
            return nothing._replace(counts=tried[0])
        hota = np.array([_hota(n.hota) for n in tried])
        mota = np.array([(n.clear.tp - n.clear.fp - n.clear.switches) / n.clear.num_truth for n in tried])
        best = int(np.argmax(hota))
        mean, amota = float(np.mean(hota)), float(np.mean(np.maximum(mota, 0.0)))
        return _Tuned(tried[best], float(thresholds[best]), mean, max(0.0, float(mota.max())), amota)

    def _thresholds(self, clips: list[Clip]) -> Float64:
        """Scores (10,) for recalls from 1 down (av2-api 0.3.6, `evaluation/tracking/eval.py`, `_recall_to_scores`)."""
        score = np.sort(np.concatenate([clip.matched for clip in clips]))[::-1]
        num_truth = sum(clip.problem.pairs.shape[0] for clip in clips)
        wanted = np.linspace(self.min_recall, 1, self.num_scores).round(12)[::-1]
        if not len(score):
            return np.zeros(len(wanted))
        recall = np.arange(1, len(score) + 1) / num_truth
        threshold = np.interp(wanted, recall, score, right=0)
        return np.where(wanted > recall[-1], 0.0, threshold)


def _match(problem: Problem, score: Float64) -> Float64:
    """Finite scores (K,) of the estimates that the assignment with the best sum takes, also where similarity is 0."""
    found = []
    for step in np.flatnonzero(np.diff(problem.pairs.start)).tolist():
        columns = linear_sum_assignment(-problem.pairs.block(step))[1]
        found.append(score[problem.pairs.column_start[step] + columns])
    scores = np.concatenate([np.zeros(0), *found])
    return np.asarray(scores[np.isfinite(scores)], np.float64)


def _count(clip: Clip, threshold: float) -> ClassCounts:
    """Counts of one sequence with the estimates from a score on."""
    kept, problem = clip.score >= threshold, clip.problem
    all_truth = np.ones(problem.pairs.shape[0], bool)
    ids = np.unique(problem.estimate_id[kept], return_inverse=True)[1]
    own = replace(
        problem, pairs=problem.pairs.select(all_truth, kept), estimate_id=ids, estimate_row=problem.estimate_row[kept]
    )
    return ClassCounts(clear_counts(own, TRACKEVAL_RULES), hota=hota_counts(own))


def _hota(n: HotaCounts) -> float:
    fields = of.mean_fields([of.alpha_fields(n, a) for a in range(len(LABELS))])
    return fields[0].printed
