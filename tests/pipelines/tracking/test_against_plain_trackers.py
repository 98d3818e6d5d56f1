"""Trackers against what the thesis says, written down plainly, over thousands of random steps."""

import numpy as np
import pytest
from tests.pipelines.tracking.plain_trackers import Plain2D, Plain3D

from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams
from fbench.pipelines.tracking.trackers import Tracker2D, Tracker3D
from fbench.replay.data.boxes import Boxes2D, Boxes3D

LABELS = np.array(["car", "van", "pedestrian", "bicycle", "other", "moose", "elk"])
STEPS = 12


def instants(rng):
    return np.cumsum(rng.integers(20, 300, STEPS)) * 1_000_000


def boxes_in_images(rng, on_grid):
    """Boxes of a scene, step by step: some on a grid, where many are exactly equally alike."""
    num = int(rng.integers(1, 15))
    center, speed, size = rng.uniform(0, 250, (num, 2)), rng.uniform(-8, 8, (num, 2)), rng.uniform(5, 90, (num, 2))
    for _ in range(STEPS):
        center = center + speed
        rows = rng.permutation(num)[: int(rng.integers(0, num + 1))]
        middle, half = center[rows] + rng.normal(0, 2, (len(rows), 2)), size[rows] / 2
        if on_grid:
            middle, half = np.round(middle / 20) * 20, np.full((len(rows), 2), 16.0)
        label = LABELS[rng.integers(0, 7, len(rows)) * (num % 3 > 0)]
        unknown = rng.random((2, len(rows))) < 0.3
        yield Boxes2D(
            np.array(["front", "rear"])[rng.integers(0, 2, len(rows)) * (num % 2)],
            np.concatenate([middle - half, middle + half], axis=1), label=label,
            score=rng.random(len(rows)) - 0.05, distance_m=np.where(unknown[0], np.nan, rng.uniform(1, 50, len(rows))),
            range_rate_mps=np.where(unknown[1], np.nan, rng.uniform(-9, 9, len(rows))),
        )  # fmt: skip


def boxes_in_space(rng, on_grid):
    num = int(rng.integers(1, 15))
    center, speed = rng.uniform(-15, 15, (num, 3)) * [1, 1, 0.05], rng.uniform(-1, 1, (num, 3)) * [1, 1, 0]
    for _ in range(STEPS):
        center = center + speed
        rows = rng.permutation(num)[: int(rng.integers(0, num + 1))]
        middle = center[rows] + rng.normal(0, 0.2, (len(rows), 3))
        yield Boxes3D(
            np.round(middle) if on_grid else middle, rng.uniform(1, 5, (len(rows), 3)),
            np.zeros(len(rows)) if on_grid else rng.uniform(-3, 3, len(rows)),
            label=LABELS[rng.integers(0, 7, len(rows)) * (num % 3 > 0)], score=rng.random(len(rows)) - 0.05,
        )  # fmt: skip


def choices(rng):
    return {
        "min_hits": int(rng.integers(1, 4)), "max_missed": int(rng.integers(0, 4)),
        "weak_score": float(rng.choice([-1e6, 0.4])), "max_coast_s": float(rng.choice([0.2, 0.5])),
        "max_missed_shown": int(rng.integers(0, 3)), "hits_per_missed": int(rng.integers(0, 3)),
    }  # fmt: skip


def require_equal(shown, expected, place):
    assert shown.track_id.tolist() == [one[0] for one in expected]
    assert shown.label.tolist() == [one[1] for one in expected]
    assert shown.score.tolist() == [one[2] for one in expected]
    assert shown.predicted.tolist() == [one[3] for one in expected]
    if expected:
        np.testing.assert_allclose(place, [one[4] for one in expected], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("association", ["iou", "giou", "mahalanobis"])
def test_thousands_of_steps_in_images(association):
    for seed in range(40):
        rng = np.random.Generator(np.random.Philox(seed))
        params = Tracker2DParams(association=association, **choices(rng))
        tracker, plain = Tracker2D(params), Plain2D(params)
        for boxes, stamp in zip(boxes_in_images(rng, seed % 3 == 0), instants(rng), strict=True):
            shown = tracker.step(boxes, int(stamp))
            place = np.column_stack([shown.xyxy_px, shown.distance_m, shown.range_rate_mps])
            require_equal(shown, plain.step(boxes, int(stamp)), place)


@pytest.mark.parametrize("association", ["distance", "iou", "giou", "mahalanobis"])
def test_thousands_of_steps_in_space(association):
    for seed in range(40):
        rng = np.random.Generator(np.random.Philox(seed))
        params = Tracker3DParams(association=association, **choices(rng))
        tracker, plain = Tracker3D(params), Plain3D(params)
        for boxes, stamp in zip(boxes_in_space(rng, seed % 3 == 0), instants(rng), strict=True):
            shown = tracker.step(boxes, int(stamp), None)
            place = np.column_stack([shown.center_m, shown.velocity_mps, shown.size_lwh_m, shown.yaw_rad])
            require_equal(shown, plain.step(boxes, int(stamp)), place)
