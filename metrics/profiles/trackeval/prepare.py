"""From a sequence to the boxes of one class that count, by the rules of each benchmark."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from fbench.metrics.core.ordering import content_order, find_twice, number_tracks
from fbench.metrics.core.problem import Problem
from fbench.metrics.core.similarity import Blocks, blocks, image_overlaps
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.data.sequences import Objects, Sequence


@dataclass(frozen=True)
class ClassRule:
    """One class that is scored."""

    name: str
    labels: frozenset[str] = frozenset()  # Labels that belong to it; empty: all
    distractors: frozenset[str] = frozenset()
    """Labels of truth that results may take for it: those are neither hits nor false alarms."""


@dataclass(frozen=True)
class Preparation:
    """What is excused and left out before anything is counted."""

    classes: tuple[ClassRule, ...]
    drops_missing_ids: bool = False  # Boxes with an id below 0 are left out; else they are an error
    matches_all_truth: bool = False
    """Results are matched with truth of any label before distractors excuse them; else with class and distractors."""
    excuse_floor: float | None = 0.5
    """Results that match a distractor, or truth too hard to count, with this intersection over union are left out
    (other similarities: with the threshold of the match); `None`: no result is excused."""
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
"""TrackEval 1.3.0, `datasets/kitti_2d_box.py`: 'car_2' is a car too; 'person' is one name of KITTI's sitting person."""

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
_MOT20_CLASS = replace(MOT17.classes[0], distractors=_MOT_DISTRACTORS | {"non motorized vehicle"})
MOT20 = replace(MOT17, classes=(_MOT20_CLASS,))
MOT15 = Preparation((ClassRule("pedestrian"),), excuse_floor=None, drops_ignored=True, only_labels=_MOT_RESULTS)
"""Its truth has no classes, so that nothing is excused."""
EVERYTHING = Preparation((ClassRule("object"),), excuse_floor=None, drops_ignored=True)
"""All boxes as one class: what a tool that knows nothing of benchmarks counts."""


_EPS = float(np.finfo(float).eps)


def problems(sequence: Sequence, preparation: Preparation, match: Match) -> Iterator[Problem]:
    """Yield what counts of each class. MetricError: an id is missing or twice in a step (GT003), labels of others."""
    sides = ((sequence.truth, "truth"), (sequence.estimates, "results"))
    for (objects, what), allowed in zip(sides, (preparation.known_labels, preparation.only_labels), strict=True):
        strange = ~_select_labels(objects, allowed)
        if allowed and strange.any():
            row = int(np.argmax(strange))
            where = f"{sequence.name}, frame {sequence.steps.frame[objects.step[row]]}"
            names = ", ".join(sorted(allowed - {""}))
            raise MetricError(f"{where}: {what} of class '{objects.label[row]}', expected {names}")
    has_id = sequence.truth.track_id >= 0, sequence.estimates.track_id >= 0
    for (objects, what), has in zip(sides, has_id, strict=True):
        fine = has if objects.ignore is None or not preparation.drops_ignored else has | objects.ignore
        if not preparation.drops_missing_ids and not fine.all():
            frame = sequence.steps.frame[objects.step[np.argmin(fine)]]
            raise MetricError(f"{sequence.name}, frame {frame}: {what} without an id can't be scored as tracks")
    for rule in preparation.classes:
        yield _problem(sequence, rule, preparation, match, _of_class(*has_id, sequence, rule, preparation))


def _problem(
    sequence: Sequence, rule: ClassRule, preparation: Preparation, match: Match, rows: tuple[Int64, Int64]
) -> Problem:
    """Leave out of truth and estimates that have to do with one class what is excused."""
    steps = sequence.steps
    truth, estimates = _columns(sequence.truth, rows[0], match), _columns(sequence.estimates, rows[1], match)
    pairs = blocks(truth, estimates, len(steps), match.kind, sequence.ego_m)
    counts = _select_labels(truth, rule.labels) if rule.labels else np.ones(len(truth), bool)  # is to be found
    limits = (truth.truncation, preparation.max_truncation), (truth.occlusion, preparation.max_occlusion)
    for level, limit in limits:
        if level is not None and limit is not None:
            counts &= ~(np.trunc(np.nan_to_num(level)) > limit)
    if preparation.drops_ignored and truth.ignore is not None:
        counts &= ~truth.ignore
    kept = counts, ~_excuse(sequence, pairs, truth, estimates, counts, rule, preparation, match)
    ids = []
    for objects, own, what in ((truth, kept[0], "truth"), (estimates, kept[1], "results")):
        step, names = objects.step[own], objects.track_id[own]
        if (row := find_twice(step, names)) is not None:
            where = f"{sequence.name}, frame {steps.frame[step[row]]}"
            raise MetricError(f"{where}: {what} have id {names[row]} twice", code="GT003")
        ids.append(number_tracks(names, steps.stream[step]))
    (truth_id, estimate_id), left = ids, pairs.select(*kept)
    return Problem(left, steps.stream, truth_id, estimate_id, rows[0][kept[0]], rows[1][kept[1]])


def _excuse(
    sequence: Sequence, pairs: Blocks, truth: Objects, estimates: Objects, counts: Bool, rule: ClassRule,
    preparation: Preparation, match: Match,
) -> Bool:  # fmt: skip
    """Which estimates (M,) neither count as hits nor as false alarms.

    Of truth that doesn't count, `ignore`d truth excuses nothing. What isn't finite is never left out (fault PRD001).
    """
    from fbench.metrics.core.assignment_kernel import partners  # numba takes a while to import

    p, alone = preparation, np.zeros(len(estimates), bool)
    if p.excuse_floor is None or not len(estimates):
        return alone
    floor = p.excuse_floor if match.kind == "iou2d" else match.floor
    offset = 2 * match.threshold if match.is_distance else 0.0  # makes similarities of pairs above the floor positive
    truth_of = partners(pairs, floor - _EPS, offset)
    excuses = _select_labels(truth, rule.distractors)
    if not p.matches_all_truth:
        excuses |= ~counts
    if estimates.xyxy_px is not None and p.min_height_px is not None:
        # Also rectangles that stand upside down, and results that have none.
        height, is_none = estimates.xyxy_px[:, 3] - estimates.xyxy_px[:, 1], np.isnan(estimates.xyxy_px).all(axis=1)
        is_low = np.isfinite(estimates.xyxy_px).all(axis=1) & (height <= p.min_height_px + _EPS)
        alone |= is_none | is_low
    regions = sequence.truth[_select_labels(sequence.truth, {p.region_label})]
    if estimates.xyxy_px is not None and p.region_label and len(regions):
        covered = image_overlaps(regions, estimates, len(sequence.steps), np.ones(len(regions), bool))
        alone[covered.locate(np.flatnonzero(covered.values > p.region_share + _EPS))[1]] = True
    return np.where(truth_of < 0, alone, np.append(excuses, False)[truth_of])


def _columns(objects: Objects, rows: Int64, match: Match) -> Objects:
    """Rows (K,) of the columns that are looked at: copying all takes longer than counting."""
    names = ["step", "label", "track_id", "score", "xyxy_px", "occlusion", "truncation", "ignore"]
    names += [] if match.kind == "iou2d" else ["center_m", "size_lwh_m", "yaw_rad"]
    found = ((name, getattr(objects, name)) for name in names)
    return Objects(**{name: column[rows] for name, column in found if column is not None})


def _select_labels(objects: Objects, labels: set[str] | frozenset[str]) -> Bool:
    found = np.zeros(len(objects), bool)
    for label in sorted(labels):
        found |= objects.label == label
    return found


def _of_class(
    truth: Bool, estimates: Bool, sequence: Sequence, rule: ClassRule, preparation: Preparation
) -> tuple[Int64, Int64]:
    """Rows that have to do with a class, in the order in which ties are broken."""
    if rule.labels and not preparation.matches_all_truth:
        truth = truth & _select_labels(sequence.truth, rule.labels | rule.distractors)
    if rule.labels and not preparation.only_labels:
        estimates = estimates & _select_labels(sequence.estimates, rule.labels)
    rows, others = np.flatnonzero(truth), np.flatnonzero(estimates)
    if preparation.order == "as given":
        return rows, others
    return rows[content_order(sequence.truth[rows])], others[content_order(sequence.estimates[others])]
