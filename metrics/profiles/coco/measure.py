"""Statistics and rules of COCO, and the matching of a sequence by them, class by class and image by image."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from fbench.metrics.core.exact import Counts
from fbench.metrics.core.matching import match_greedily, score_order
from fbench.metrics.core.problem import is_valid
from fbench.metrics.core.similarity import image_overlaps
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.sequences import Objects, Sequence


class Outcome(IntEnum):
    """Of an estimate, at one threshold and range of area."""

    FALSE_ALARM = 0
    HIT = 1
    IGNORED = 2


@dataclass(frozen=True, eq=False)
class Ranked:
    """M estimates of one class of one sequence."""

    sequence: str
    place: Int64  # (M, 3) frame, number of the camera, and place in the image by score: no two are equal
    score: Float64  # (M,)
    outcome: Array  # (A, T, M) uint8 `Outcome` for A ranges of area and T thresholds


@dataclass(frozen=True)
class ClassStatistics:
    """One class over some sequences."""

    num_truth: tuple[int, ...]  # Boxes to be found in each range of area
    num_crowds: int
    parts: tuple[Ranked, ...]  # One a sequence, in any order

    def __add__(self, other: "ClassStatistics") -> "ClassStatistics":
        num_truth = tuple(a + b for a, b in zip(self.num_truth, other.num_truth, strict=True))
        return ClassStatistics(num_truth, self.num_crowds + other.num_crowds, self.parts + other.parts)

    def rank(self) -> tuple[Int64, Array]:
        """Place in the image (M,) and outcome (A, T, M) of all estimates, the best score first.

        Equal scores stand by sequence, frame, camera and place in the image, scores that aren't numbers last.
        """
        parts = sorted(self.parts, key=lambda part: part.sequence)
        place, score = np.concatenate([p.place for p in parts]), np.concatenate([p.score for p in parts])
        sequence = np.repeat(np.arange(len(parts)), [len(p.score) for p in parts])
        order = np.lexsort((place[:, 2], place[:, 1], place[:, 0], sequence, -score))
        return place[order, 2], np.concatenate([p.outcome for p in parts], axis=2)[..., order]


@dataclass(frozen=True)
class CocoStatistics(Counts):
    """All classes over some sequences."""

    classes: Mapping[str, ClassStatistics]
    num_images: int
    num_invalid_truth: int  # Boxes that aren't finite or have a negative size; left out
    num_invalid_estimates: int  # Counted as false alarms


@dataclass(frozen=True)
class AreaRange:
    """Sizes of boxes that count; others are ignored."""

    name: str  # As in `aps`: empty for all
    low_px2: float
    high_px2: float  # Both ends belong to it

    def holds(self, area_px2: Float64) -> Bool:
        """Tell which areas (N,) lie in it; unknown ones (NaN) do."""
        inside: Bool = ~((area_px2 < self.low_px2) | (area_px2 > self.high_px2))
        return inside


@dataclass(frozen=True)
class CocoRules:
    """Parameters of pycocotools' `Params` for boxes."""

    thresholds: tuple[float, ...] = tuple(np.linspace(0.5, 0.95, 10).tolist())
    """Least intersection over union; results are averaged over them."""
    num_recalls: int = 101  # Precision is read at as many recalls from 0 to 1
    max_estimates: tuple[int, ...] = (1, 10, 100)  # Of one class in one image, the best scores first; ascending
    areas: tuple[AreaRange, ...] = (
        AreaRange("", 0.0, 1e10),
        AreaRange("s", 0.0, 32.0**2),
        AreaRange("m", 32.0**2, 96.0**2),
        AreaRange("l", 96.0**2, 1e10),
    )
    """All first."""


_ALMOST_ONE = 1 - 1e-10  # Overlap that suffices where the threshold is 1 (pycocotools)


def measure(sequence: Sequence, rules: CocoRules, classes: tuple[str, ...]) -> CocoStatistics:
    """Match all classes of a sequence with boxes in images; each step is an image, truth to be ignored are crowds.

    `classes` are the labels that count; empty: all that occur. Raises MetricError where boxes have no rectangles.
    """
    valid_truth, valid = (is_valid(objects, "iou2d") for objects in (sequence.truth, sequence.estimates))
    truth = sequence.truth[valid_truth]
    # Nothing is like a rectangle that isn't valid, or has no valid score.
    estimates = replace(sequence.estimates, xyxy_px=np.where(valid[:, None], _rectangle(sequence.estimates), np.nan))
    labels = classes or tuple(np.unique(np.concatenate([truth.label, estimates.label])).tolist())
    return CocoStatistics(
        {
            label: _measure_class(sequence, truth[truth.label == label], estimates[estimates.label == label], rules)
            for label in labels
        },
        len(sequence.steps),
        int((~valid_truth & np.isin(sequence.truth.label, labels)).sum()),
        int((~valid & np.isin(estimates.label, labels)).sum()),
    )


def _measure_class(sequence: Sequence, truth: Objects, estimates: Objects, rules: CocoRules) -> ClassStatistics:
    """Match the boxes of one class in S images: N to be found, M estimates, both in the order of choice.

    The outcome (A, T, M) is on counted truth a hit, on other truth ignored, else a false alarm if the area counts.
    """
    steps = sequence.steps
    crowd = np.zeros(len(truth), bool) if truth.ignore is None else truth.ignore
    order = np.lexsort((*_rectangle(truth).T[::-1], crowd, truth.step))
    truth, crowd = truth[order], crowd[order]
    estimates = estimates[score_order(estimates.step, estimates.score, _rectangle(estimates))]
    place = np.arange(len(estimates)) - estimates.starts(len(steps))[estimates.step]
    early = place < rules.max_estimates[-1]
    estimates, place, num = estimates[early], place[early], int(early.sum())

    pairs = image_overlaps(truth, estimates, len(steps), crowd)
    floors = [min(threshold, _ALMOST_ONE) for threshold in rules.thresholds]
    outcome = np.full((len(rules.areas), len(floors), num), Outcome.FALSE_ALARM, np.uint8)
    num_truth = []
    for k, area in enumerate(rules.areas):
        ignored = crowd | ~area.holds(_areas(truth))
        num_truth.append(int((~ignored).sum()))
        partner = match_greedily(pairs, np.arange(num), floors, rank=ignored, shared=crowd)
        matched, on_ignored = partner >= 0, np.append(ignored, False)[partner]  # -1: none, the last
        outcome[k][matched & ~on_ignored] = Outcome.HIT
        outcome[k][on_ignored | (~matched & ~area.holds(_areas(estimates)))] = Outcome.IGNORED
    camera = np.unique(np.array(steps.camera), return_inverse=True)[1] if steps.camera else np.zeros(len(steps))
    places = np.column_stack([steps.frame[estimates.step], camera.astype(np.int64)[estimates.step], place])
    ranked = Ranked(sequence.name, places, estimates.score, outcome)
    return ClassStatistics(tuple(num_truth), int(crowd.sum()), (ranked,))


def _rectangle(objects: Objects) -> Float64:
    return np.zeros((0, 4)) if objects.xyxy_px is None else objects.xyxy_px  # `is_valid` refuses boxes without


def _areas(objects: Objects) -> Float64:
    """Areas (N,) [px2], NaN where a box isn't valid."""
    width, height = (_rectangle(objects)[:, 2:] - _rectangle(objects)[:, :2]).T
    return np.asarray(width * height)
