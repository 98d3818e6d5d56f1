"""From a sequence to COCO's statistics: matching, class by class and image by image."""

from dataclasses import replace

import numpy as np

from fbench.metrics.core.matching import match_greedily, score_order
from fbench.metrics.core.problem import is_valid
from fbench.metrics.core.similarity import image_overlaps
from fbench.metrics.profiles.coco.statistics import ClassStatistics, CocoRules, CocoStatistics, Outcome, Ranked
from fbench.replay.data.arrays import Float64
from fbench.replay.data.sequences import Objects, Sequence

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
