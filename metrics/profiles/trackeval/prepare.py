"""From a sequence to the boxes of one class that count, by the rules of each benchmark."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fbench.metrics.core.ordering import content_order
from fbench.metrics.core.problem import Problem
from fbench.metrics.core.similarity import blocks, image_overlaps, pairs_of
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.sequences import Objects, Sequence


@dataclass(frozen=True)
class ClassRule:
    """One class that is scored."""

    name: str
    labels: frozenset[str] = frozenset()  # Labels that belong to it; empty: all
    distractors: frozenset[str] = frozenset()
    """Labels of truth that results may take for it: those are neither hits nor false alarms."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", frozenset(self.labels))
        object.__setattr__(self, "distractors", frozenset(self.distractors))


@dataclass(frozen=True)
class Preparation:
    """What is excused and left out before anything is counted."""

    classes: tuple[ClassRule, ...]
    drops_missing_ids: bool = False  # Boxes with an id below 0 are left out; else they are an error
    matches_all_truth: bool = False
    """Results are matched with truth of any label before distractors excuse them; else with class and distractors."""
    excuse_floor: float | None = 0.5
    """Results that match a distractor, or truth too hard to count, with this intersection over union are left out
    (other likenesses: with the threshold of the match); `None`: no result is excused."""
    max_truncation: float | None = None  # Truth beyond this level, rounded towards 0, is too hard to count
    max_occlusion: float | None = None
    drops_ignored: bool = False  # Truth marked `ignore` doesn't count, and excuses nothing
    min_height_px: float | None = None  # Unmatched results up to this height are left out
    region_label: str = ""
    """Truth of this label is regions: unmatched results of which more than `region_share` lies in one are left out."""
    region_share: float = 0.5
    only_labels: frozenset[str] = field(default_factory=frozenset)
    """Results of other labels are an error; empty: they are left out where they aren't of the class."""
    known_labels: frozenset[str] = field(default_factory=frozenset)
    """Truth of other labels is an error; empty: it isn't looked at."""
    order: Literal["as given", "by content"] = "as given"
    """Which rows of a step go first where several pairings are equally good: those given first, as in the reference
    tools, or those with the smaller box, which doesn't depend on how results are written down."""

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored; empty: any are."""
        return self.only_labels or frozenset().union(*(rule.labels for rule in self.classes))


HALF = Match("iou2d", 0.5)  # What all of these benchmarks match by

KITTI = Preparation(
    (
        ClassRule("car", frozenset({"car", "car_2"}), frozenset({"van"})),
        ClassRule("pedestrian", frozenset({"pedestrian"}), frozenset({"person", "person_sitting"})),
    ),
    drops_missing_ids=True, max_truncation=0, max_occlusion=2, min_height_px=25, region_label="dontcare",
)  # fmt: skip
"""TrackEval 1.3.0, `datasets/kitti_2d_box.py`, where 'car_2' is a car too; its 'person' is KITTI's sitting person under
one of two names."""

_MOT_DISTRACTORS = frozenset({"person on vehicle", "static person", "distractor", "reflection"})
_MOT_OTHERS = frozenset(
    {"pedestrian", "car", "bicycle", "motorbike", "non motorized vehicle", "occluder", "occluder on the ground",
     "occluder full", "crowd"}
)  # fmt: skip
_MOT_RESULTS = frozenset({"pedestrian", "", "0", "-1"})

MOT17 = Preparation(
    (ClassRule("pedestrian", frozenset({"pedestrian"}), _MOT_DISTRACTORS),),
    matches_all_truth=True, drops_ignored=True, only_labels=_MOT_RESULTS, known_labels=_MOT_DISTRACTORS | _MOT_OTHERS,
)  # fmt: skip
"""TrackEval 1.3.0, `datasets/mot_challenge_2d_box.py`, benchmarks MOT16 and MOT17."""
MOT20 = Preparation(
    (ClassRule("pedestrian", frozenset({"pedestrian"}), _MOT_DISTRACTORS | {"non motorized vehicle"}),),
    matches_all_truth=True, drops_ignored=True, only_labels=_MOT_RESULTS, known_labels=_MOT_DISTRACTORS | _MOT_OTHERS,
)  # fmt: skip
MOT15 = Preparation((ClassRule("pedestrian"),), excuse_floor=None, drops_ignored=True, only_labels=_MOT_RESULTS)
"""Its truth has no classes, so that nothing is excused."""
EVERYTHING = Preparation((ClassRule("object"),), excuse_floor=None, drops_ignored=True)
"""All boxes as one class: what a tool that knows nothing of benchmarks counts."""


_EPS = float(np.finfo(float).eps)


def problems(sequence: Sequence, preparation: Preparation, match: Match) -> Iterator[Problem]:
    """Yield what counts of each class. Raises MetricError where an id is missing or twice in a step (GT003), or labels
    are of another benchmark.
    """
    _check_labels(sequence, preparation)
    truth, estimates = _select_tracked(sequence, preparation)
    regions = sequence.truth[_select_labels(sequence.truth, {preparation.region_label})]
    for rule in preparation.classes:
        rows = _of_class(truth, estimates, sequence, rule, preparation)
        yield _Prepared(sequence, rule, preparation, match, *rows).problem(regions)


class _Prepared:
    """Truth and estimates that have to do with one class, and how alike they are."""

    def __init__(
        self, sequence: Sequence, rule: ClassRule, preparation: Preparation, match: Match, truth: Int64,
        estimates: Int64,
    ) -> None:  # fmt: skip
        self._sequence, self._rule, self._preparation, self._match = sequence, rule, preparation, match
        self._rows = truth, estimates
        self._truth = _columns(sequence.truth, truth, match)
        self._estimates = _columns(sequence.estimates, estimates, match)
        self._starts = self._truth.starts(len(sequence.steps)), self._estimates.starts(len(sequence.steps))
        self._similarity, self._block_start = blocks(
            self._truth, self._estimates, *self._starts, match.likeness, sequence.ego_m
        )

    def problem(self, regions: Objects) -> Problem:
        """Leave out what is excused."""
        counts = self._counts()
        return self._keep(counts, ~self._excuse(counts, regions))

    def _counts(self) -> Bool:
        """Which truth (N,) is to be found."""
        truth, p = self._truth, self._preparation
        counts = _select_labels(truth, self._rule.labels) if self._rule.labels else np.ones(len(truth), bool)
        for level, limit in ((truth.truncation, p.max_truncation), (truth.occlusion, p.max_occlusion)):
            if level is not None and limit is not None:
                counts &= ~(np.trunc(np.nan_to_num(level)) > limit)
        if p.drops_ignored and truth.ignore is not None:
            counts &= ~truth.ignore
        return counts

    def _excuse(self, counts: Bool, regions: Objects) -> Bool:
        """Which estimates (M,) neither count as hits nor as false alarms."""
        from fbench.metrics.core.assignment_kernel import partners  # numba takes a while to import

        p, estimates = self._preparation, self._estimates
        if p.excuse_floor is None or not len(estimates):
            return np.zeros(len(estimates), bool)
        floor, offset = (p.excuse_floor, 0.0) if self._match.likeness == "iou2d" else _floor_of(self._match)
        truth_of = partners(
            *self._starts, np.array(self._block_start), np.array(self._similarity), floor - _EPS, offset
        )
        excuses = np.append(self._excuses(counts), False)
        return np.where(truth_of < 0, self._excuse_alone(regions), excuses[truth_of])

    def _excuse_alone(self, regions: Objects) -> Bool:
        """Which estimates (M,) are left out where they match nothing; what isn't finite never is (fault PRD001)."""
        p, estimates = self._preparation, self._estimates
        excused = np.zeros(len(estimates), bool)
        if estimates.xyxy_px is None:
            return excused
        if p.min_height_px is not None:
            excused |= _up_to(p.min_height_px, estimates.xyxy_px)
        if p.region_label:
            excused |= _within(regions, estimates, len(self._sequence.steps), p.region_share)
        return excused

    def _excuses(self, counts: Bool) -> Bool:
        """Which truth (N,) excuses results that match it; of all that doesn't count, `ignore`d truth doesn't."""
        is_distractor = _select_labels(self._truth, self._rule.distractors)
        return is_distractor if self._preparation.matches_all_truth else is_distractor | ~counts

    def _keep(self, truth: Bool, estimates: Bool) -> Problem:
        row, column = pairs_of(*self._starts)
        kept = truth[row] & estimates[column]
        sides = self._side(0, self._truth, truth), self._side(1, self._estimates, estimates)
        size = np.diff(sides[0][0]) * np.diff(sides[1][0])
        return Problem(
            sides[0][0], sides[1][0], np.concatenate([[0], np.cumsum(size)]), self._similarity[kept],
            self._sequence.steps.stream, sides[0][1], sides[1][1], self._estimates.score[estimates], sides[0][2],
            sides[1][2],
        )  # fmt: skip

    def _side(self, side: int, objects: Objects, kept: Bool) -> tuple[Int64, Int64, Int64]:
        """Offsets of steps, ids from 0, rows of the sequence."""
        step = objects.step[kept]
        starts = np.searchsorted(step, np.arange(len(self._sequence.steps) + 1))
        ids = _renumbered(objects.track_id[kept], self._sequence.steps.stream[step])
        _check_unique(self._sequence, step, ids, objects.track_id[kept], ("truth", "results")[side])
        return starts, ids, self._rows[side][kept]


def _columns(objects: Objects, rows: Int64, match: Match) -> Objects:
    """Rows (K,) of the columns that are looked at: copying all takes longer than counting."""
    names = ["xyxy_px", "occlusion", "truncation", "ignore"]
    names += [] if match.likeness == "iou2d" else ["center_m", "size_lwh_m", "yaw_rad"]
    found = {name: getattr(objects, name) for name in names}
    return Objects(
        step=objects.step[rows],
        label=objects.label[rows],
        track_id=objects.track_id[rows],
        score=objects.score[rows],
        **{name: column[rows] for name, column in found.items() if column is not None},
    )


def _floor_of(match: Match) -> tuple[float, float]:
    """Floor of a likeness, and what makes similarities of pairs above it positive."""
    return match.floor, 2 * match.threshold if match.is_distance else 0.0


def _select_labels(objects: Objects, labels: set[str] | frozenset[str]) -> Bool:
    found = np.zeros(len(objects), bool)
    for label in sorted(labels):
        found |= objects.label == label
    return found


def _select_tracked(sequence: Sequence, preparation: Preparation) -> tuple[Bool, Bool]:
    """Which truth (N,) and estimates (M,) have ids."""
    has_id = sequence.truth.track_id >= 0, sequence.estimates.track_id >= 0
    if not preparation.drops_missing_ids:
        for side, has, what in zip((sequence.truth, sequence.estimates), has_id, ("truth", "results"), strict=True):
            fine = has if side.ignore is None or not preparation.drops_ignored else has | side.ignore
            if not fine.all():
                frame = sequence.steps.frame[side.step[np.argmin(fine)]]
                raise MetricError(f"{sequence.name}, frame {frame}: {what} without an id can't be scored as tracks")
    return has_id


def _of_class(
    truth: Bool, estimates: Bool, sequence: Sequence, rule: ClassRule, preparation: Preparation
) -> tuple[Int64, Int64]:
    """Rows that have to do with a class, in the order in which ties are broken."""
    if rule.labels and not preparation.matches_all_truth:
        truth = truth & _select_labels(sequence.truth, rule.labels | rule.distractors)
    if rule.labels and not preparation.only_labels:
        estimates = estimates & _select_labels(sequence.estimates, rule.labels)
    rows = np.flatnonzero(truth), np.flatnonzero(estimates)
    if preparation.order == "as given":
        return rows
    truth_order, estimate_order = content_order(sequence.truth[rows[0]]), content_order(sequence.estimates[rows[1]])
    return rows[0][truth_order], rows[1][estimate_order]


def _up_to(height_px: float, xyxy: Float64) -> Bool:
    """Which rectangles (M, 4) are no higher: also those that stand upside down, and results that have none."""
    height = xyxy[:, 3] - xyxy[:, 1]
    is_none = np.isnan(xyxy).all(axis=1)
    return np.asarray(is_none | (np.isfinite(xyxy).all(axis=1) & (height <= height_px + _EPS)))


def _within(regions: Objects, estimates: Objects, num_steps: int, share: float) -> Bool:
    """Which estimates (M,) lie in one of the regions of their step, to more than a share."""
    if not len(regions):
        return np.zeros(len(estimates), bool)
    starts = regions.starts(num_steps), estimates.starts(num_steps)
    covered, _ = image_overlaps(regions, estimates, *starts, np.ones(len(regions), bool))
    inside = np.zeros(len(estimates), bool)
    inside[pairs_of(*starts)[1][covered > share + _EPS]] = True
    return inside


def _renumbered(ids: Int64, stream: Int64) -> Int64:
    """Number ids from 0; an id in two streams is two."""
    if not len(ids):
        return np.zeros(0, np.int64)
    numbers = np.unique(ids, return_inverse=True)[1]
    if stream[0] != stream[-1] or (stream != stream[0]).any():
        numbers = np.unique(stream * (int(numbers.max()) + 1) + numbers, return_inverse=True)[1]
    return np.asarray(numbers, np.int64)


def _check_unique(sequence: Sequence, step: Int64, ids: Int64, names: Int64, what: str) -> None:
    order = np.lexsort((ids, step))
    twice = np.flatnonzero((np.diff(step[order]) == 0) & (np.diff(ids[order]) == 0))
    if len(twice):
        row = order[twice[0]]
        where = f"{sequence.name}, frame {sequence.steps.frame[step[row]]}"
        raise MetricError(f"{where}: {what} have id {names[row]} twice", code="GT003")


def _check_labels(sequence: Sequence, preparation: Preparation) -> None:
    """Refuse results and truth of another benchmark."""
    sides = (
        (sequence.truth, preparation.known_labels, "truth"),
        (sequence.estimates, preparation.only_labels, "results"),
    )
    for objects, allowed, what in sides:
        if allowed and len(objects):
            strange: Array = ~_select_labels(objects, allowed)
            if strange.any():
                row = int(np.argmax(strange))
                where = f"{sequence.name}, frame {sequence.steps.frame[objects.step[row]]}"
                raise MetricError(
                    f"{where}: {what} of class '{objects.label[row]}', expected {', '.join(sorted(allowed - {''}))}"
                )


def overlaps(problem: Problem, match: Match) -> Float64:
    """Similarity (B,) of 0 to 1 as HOTA needs it: distances become max(0, 1 - distance / threshold)."""
    if not match.is_distance:
        return problem.similarity
    return np.maximum(0.0, 1 + problem.similarity / match.threshold)
