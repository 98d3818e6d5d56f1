"""Boxes of one class in one sequence of the object benchmark, matched as its rules have it."""

from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np

from fbench.metrics.profiles.kitti.rows import (
    Pairs,
    by_content,
    fill_unknown,
    has_label,
    outside,
    pairs_within,
    rectangles,
    share_in_regions,
    sound_results,
    sound_truth,
)
from fbench.replay.contracts.profiles import Likeness, Match
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, freeze_fields
from fbench.replay.data.sequences import Objects, Sequence


@dataclass(frozen=True)
class Difficulty:
    """Which truth must be found; results lower than the height are excused."""

    name: str
    min_height_px: float  # Truth must be higher
    max_occlusion: int
    max_truncation: float


@dataclass(frozen=True)
class ObjectClass:
    """A class, its neighbor that is neither a hit nor a miss, and from which overlap on boxes match."""

    label: str
    neighbor: str
    matches: tuple[Match, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of truth that can take a result."""
        return (self.label, self.neighbor) if self.neighbor else (self.label,)


def _matches(strict: float, loose: float) -> tuple[Match, ...]:
    """The benchmark's overlaps, then the loose ones, which are the same in the image."""
    return (
        Match("iou2d", strict), Match("ioubev", strict), Match("iou3d", strict),
        Match("ioubev", loose), Match("iou3d", loose),
    )  # fmt: skip


CLASSES = (
    ObjectClass("car", "van", _matches(0.7, 0.5)),
    ObjectClass("pedestrian", "person_sitting", _matches(0.5, 0.25)),
    ObjectClass("cyclist", "", _matches(0.5, 0.25)),
)
DIFFICULTIES = (
    Difficulty("easy", 40.0, 0, 0.15),
    Difficulty("moderate", 25.0, 1, 0.3),
    Difficulty("hard", 25.0, 2, 0.5),
)


COUNTS, IGNORED, LEFT_OUT = 0, 1, -1
"""What a result is for a class and difficulty; as in `metrics/profiles/kitti/kernels.py`."""


@dataclass(frozen=True, eq=False)
class ObjectTable:
    """N truth boxes and M results at D difficulties."""

    pairs: Pairs
    truth_ignored: Array  # (D, N) bool: of a neighboring class, or too low, occluded or truncated for the difficulty
    state: Array  # (D, M) int64: `COUNTS`, `IGNORED` or `LEFT_OUT`
    score: Float64  # (M,)
    covered: Float64  # (M,) share that a "don't care" region covers; 0 where they don't matter
    truth_alpha: Float64  # (N,) observation angle [rad], NaN where unknown
    alpha: Float64  # (M,)
    num_bad_truth: int  # Left out; what the source left out already is of any class
    num_bad_results: int  # They are false positives at every threshold
    missing: str  # What the boxes lack, so that they can't be matched in this way; empty where nothing

    def __post_init__(self) -> None:
        truth, results = ("N",), ("M",)
        freeze_fields(
            self, truth_ignored=("?", ("D", "N")), state=("i8", ("D", "M")), score=("f8", results),
            covered=("f8", results), truth_alpha=("f8", truth), alpha=("f8", results),
        )  # fmt: skip


def object_table(
    sequence: Sequence, kind: ObjectClass, difficulties: Many[Difficulty], likeness: Likeness, least: float, sort: bool
) -> ObjectTable:
    """Select what counts for one class and likeness; pairs are kept from the overlap `least` on."""
    missing = _missing(sequence, likeness)
    truth = sequence.truth[has_label(sequence.truth, kind.labels) & (not missing)]
    results = sequence.estimates[_may_match(sequence.estimates, kind, difficulties) & (not missing)]
    if sort:
        truth, results = by_content(truth, sequence), by_content(results, sequence)
    sound = sound_truth(truth, likeness), sound_results(results, likeness)
    num_bad = int((~sound[0]).sum()), int((~sound[1] & (results.label == kind.label)).sum())
    truth, results = truth[sound[0]], results[sound[1]]
    num_steps = len(sequence.steps)
    return ObjectTable(
        pairs=pairs_within(truth, results, num_steps, likeness, least),
        truth_ignored=np.stack([_ignored(truth, kind, one) for one in difficulties]),
        state=np.stack([_states(results, kind, one) for one in difficulties]),
        score=results.score,
        covered=_covered(results, sequence, likeness),
        truth_alpha=_angles(truth, likeness),
        alpha=_angles(results, likeness),
        num_bad_truth=num_bad[0] + sequence.num_invalid_truth,
        num_bad_results=num_bad[1],
        missing=missing,
    )


def _angles(objects: Objects, likeness: Likeness) -> Float64:
    """Orientation is compared in the image only."""
    return observation_angles(objects) if likeness == "iou2d" else np.full(len(objects), np.nan)


def observation_angles(objects: Objects) -> Float64:
    """Return KITTI's alpha (N,) [rad]: as given, else from the solids, NaN where there is neither."""
    if objects.alpha_rad is not None:
        return objects.alpha_rad
    if objects.center_m is None or objects.yaw_rad is None:
        return np.full(len(objects), np.nan)
    bearing: Float64 = np.arctan2(objects.center_m[:, 1], objects.center_m[:, 0])
    return bearing - objects.yaw_rad - np.pi / 2


def _missing(sequence: Sequence, likeness: Likeness) -> str:
    """Which side has boxes and none of the kind that is compared."""
    for side, objects in (("truth", sequence.truth), ("results", sequence.estimates)):
        boxes = objects.xyxy_px if likeness == "iou2d" else objects.center_m
        if len(objects) and (boxes is None or np.isnan(boxes).all()):
            return f"{side} of {sequence.name}: no {'boxes in images' if likeness == 'iou2d' else '3D boxes'}"
    return ""


def _heights(objects: Objects) -> Float64:
    rectangle = rectangles(objects)
    return rectangle[:, 3] - rectangle[:, 1]


def _may_match(results: Objects, kind: ObjectClass, difficulties: Many[Difficulty]) -> Bool:
    """Results of the class, and low ones of any class: the devkit looks at the height first and excuses them."""
    highest = max(one.min_height_px for one in difficulties)
    chosen: Bool = (results.label == kind.label) | (np.abs(_heights(results)) < highest)
    return chosen


def _ignored(truth: Objects, kind: ObjectClass, difficulty: Difficulty) -> Bool:
    ignored: Bool = (truth.label == kind.neighbor) | (_heights(truth) <= difficulty.min_height_px)
    ignored |= fill_unknown(truth.occlusion, truth, -1.0) > difficulty.max_occlusion
    ignored |= fill_unknown(truth.truncation, truth, -1.0) > difficulty.max_truncation
    return ignored | outside(truth)


def _states(results: Objects, kind: ObjectClass, difficulty: Difficulty) -> Int64:
    ignored = (np.abs(_heights(results)) < difficulty.min_height_px) | outside(results)
    return np.where(ignored, IGNORED, np.where(results.label == kind.label, COUNTS, LEFT_OUT)).astype(np.int64)


def _covered(results: Objects, sequence: Sequence, likeness: Likeness) -> Float64:
    """The devkit excuses results in "don't care" regions in the image only."""
    if likeness != "iou2d":
        return np.zeros(len(results))
    return share_in_regions(results, sequence.truth, len(sequence.steps))
