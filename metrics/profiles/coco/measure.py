"""From a sequence to COCO's statistics: matching, class by class and image by image."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fbench.metrics.core.matching import match_greedily, score_order
from fbench.metrics.core.problem import is_valid
from fbench.metrics.core.similarity import image_overlaps
from fbench.metrics.profiles.coco.statistics import ClassStatistics, CocoRules, CocoStatistics, Outcome, Ranked
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.sequences import Objects, Sequence, Steps

_ALMOST_ONE = 1 - 1e-10  # Overlap that suffices where the threshold is 1 (pycocotools)


def measure(sequence: Sequence, rules: CocoRules, classes: tuple[str, ...]) -> CocoStatistics:
    """Match all classes of a sequence; each step is an image.

    Args:
        sequence: With boxes in images; truth to be ignored are crowds.
        rules: What counts.
        classes: Labels that count; empty: all that occur.

    Raises:
        MetricError: where boxes have no rectangles.
    """
    valid_truth, valid = (is_valid(objects, "iou2d") for objects in (sequence.truth, sequence.estimates))
    truth, estimates = sequence.truth[valid_truth], _blank(sequence.estimates, valid)
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


@dataclass(frozen=True, eq=False)
class _Images:
    """Boxes of one class in S images: N to be found, M estimates, both in the order of choice."""

    num_steps: int
    truth: Objects
    estimates: Objects

    @cached_property
    def starts(self) -> tuple[Int64, Int64]:
        """Offsets (S + 1,) of the images in both."""
        return self.truth.starts(self.num_steps), self.estimates.starts(self.num_steps)

    @cached_property
    def areas_px2(self) -> tuple[Float64, Float64]:
        """Of both, (N,) and (M,), NaN where a box isn't valid."""
        return _areas(self.truth), _areas(self.estimates)

    @cached_property
    def crowd(self) -> Bool:
        """(N,) truth that holds any number of objects."""
        return np.zeros(len(self.truth), bool) if self.truth.ignore is None else self.truth.ignore


def _measure_class(sequence: Sequence, truth: Objects, estimates: Objects, rules: CocoRules) -> ClassStatistics:
    crowd = np.zeros(len(truth), bool) if truth.ignore is None else truth.ignore
    truth = truth[np.lexsort((*_rectangle(truth).T[::-1], crowd, truth.step))]
    estimates = estimates[score_order(estimates.step, estimates.score, _rectangle(estimates))]
    place = np.arange(len(estimates)) - estimates.starts(len(sequence.steps))[estimates.step]
    early = place < rules.max_estimates[-1]
    images = _Images(len(sequence.steps), truth, estimates[early])
    return ClassStatistics(
        tuple(int((area.holds(images.areas_px2[0]) & ~images.crowd).sum()) for area in rules.areas),
        int(images.crowd.sum()),
        (
            Ranked(
                sequence.name,
                _places(sequence.steps, images.estimates.step, place[early]),
                images.estimates.score,
                _outcomes(images, rules),
            ),
        ),
    )


def _outcomes(images: _Images, rules: CocoRules) -> Array:
    """Outcome (A, T, M): on counted truth a hit, on other truth ignored, else a false alarm if its area counts."""
    num = len(images.estimates)
    similarity, block_start = image_overlaps(images.truth, images.estimates, *images.starts, images.crowd)
    floors = [min(threshold, _ALMOST_ONE) for threshold in rules.thresholds]
    outcome = np.full((len(rules.areas), len(floors), num), Outcome.FALSE_ALARM, np.uint8)
    for k, area in enumerate(rules.areas):
        ignored = images.crowd | ~area.holds(images.areas_px2[0])
        partner = match_greedily(
            similarity, *images.starts, block_start, np.arange(num), floors, rank=ignored, shared=images.crowd
        )
        matched, on_ignored = partner >= 0, np.append(ignored, False)[partner]  # -1: none, the last
        outcome[k][matched & ~on_ignored] = Outcome.HIT
        outcome[k][on_ignored | (~matched & ~area.holds(images.areas_px2[1]))] = Outcome.IGNORED
    return outcome


def _places(steps: Steps, step: Int64, place: Int64) -> Int64:
    """Frame, camera and place in the image (M, 3)."""
    camera = np.unique(np.array(steps.camera), return_inverse=True)[1] if steps.camera else np.zeros(len(steps))
    return np.column_stack([steps.frame[step], camera.astype(np.int64)[step], place])


def _blank(objects: Objects, valid: Bool) -> Objects:
    """The same with rectangles that nothing is like where they, or the score, aren't valid."""
    return replace(objects, xyxy_px=np.where(valid[:, None], _rectangle(objects), np.nan))


def _rectangle(objects: Objects) -> Float64:
    return np.zeros((0, 4)) if objects.xyxy_px is None else objects.xyxy_px  # `is_valid` refuses boxes without


def _areas(objects: Objects) -> Float64:
    width, height = (_rectangle(objects)[:, 2:] - _rectangle(objects)[:, :2]).T
    areas: Float64 = width * height
    return areas
