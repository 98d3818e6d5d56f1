"""Control variates: hand-checked values, coverage on known populations, and what gives no gain."""

import numpy as np
import pytest

from fbench.metrics.comparison.control import control
from fbench.metrics.comparison.counts import RATIOS
from fbench.replay.contracts.errors import MetricError

RECALL = RATIOS["detection"]["recall"]


def population(share, seed=1, num=200):
    """Counts of frames with 10 objects, and of an agreement that has `share` of the spread of hits in common."""
    random = np.random.default_rng(seed)
    common, alone, other = random.integers(-3, 4, (3, num))
    hits = np.clip(6 + np.where(random.random(num) < share, common, alone), 0, 10)
    agreed = np.clip(6 + np.where(random.random(num) < share, common, other), 0, 10)
    counts, agreement = (np.column_stack([n, 0 * n, 10 - n]) for n in (hits, agreed))
    return counts, agreement


def test_a_perfect_control_knows_all_frames():
    counts, _ = population(1.0)
    is_labeled = np.arange(200) % 5 == 0
    found = control(counts[is_labeled], [counts], is_labeled, RECALL)
    assert found.plain.value == pytest.approx(counts[is_labeled, 0].mean() / 10)
    assert found.narrow.value == pytest.approx(counts[:, 0].mean() / 10)
    assert found.narrow.width == pytest.approx(0.0, abs=1e-9)
    assert found.gain == pytest.approx(1.0)
    assert (found.num_labeled, found.num_frames) == (40, 200)


def test_with_equal_denominators_it_is_the_regression_estimator():
    """Of equally many objects a frame, recall is a mean: Cochran 1977, 7.3, by hand."""
    counts, agreement = population(0.8)
    is_labeled = np.arange(200) < 50
    found = control(counts[is_labeled], [agreement], is_labeled, RECALL)
    y, x = counts[:50, 0] / 10, agreement[:, 0] / 10
    slope = np.cov(x[:50], y)[0, 1] / np.var(x[:50], ddof=1)
    assert found.narrow.value == pytest.approx(y.mean() - slope * (x[:50].mean() - x.mean()))
    assert found.plain.width == pytest.approx(2 * 2.009575 * np.sqrt(np.var(y, ddof=1) * (1 / 50 - 1 / 200)), rel=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.9])
def test_intervals_hold_as_often_as_they_say(share):
    counts, agreement = population(share)
    true, random = counts[:, 0].mean() / 10, np.random.default_rng(7)
    held, widths = np.zeros(2), np.zeros(2)
    for _ in range(300):
        is_labeled = np.zeros(200, bool)
        is_labeled[random.permutation(200)[:40]] = True
        found = control(counts[is_labeled], [agreement], is_labeled, RECALL)
        for at, one in enumerate((found.plain, found.narrow)):
            held[at] += one.low <= true <= one.high
            widths[at] += one.width
    assert (held >= 0.92 * 300).all()
    gain = 1 - widths[1] / widths[0]
    assert gain > 0.3 if share else gain < 0.03


def test_a_control_that_says_nothing_is_not_used():
    counts, _ = population(0.0)
    is_labeled = np.arange(200) < 40
    same = np.tile([6, 0, 4], (200, 1))
    found = control(counts[is_labeled], [same], is_labeled, RECALL)
    assert found.gain < 0


def test_a_number_that_hangs_on_one_frame_has_no_interval():
    counts = np.tile([0, 0, 4], (40, 1))
    counts[7] = [2, 1, 2]
    is_labeled = np.arange(200) < 40
    agreement, _ = population(0.5)
    precision = RATIOS["detection"]["precision"]
    assert control(counts, [agreement], is_labeled, precision) == "undefined without one of the labeled frames"
    assert control(0 * counts, [agreement], is_labeled, precision) == "undefined over the labeled frames"


@pytest.mark.parametrize(("num", "said"), [(10, "10 labeled frames, at least 11"), (0, "0 labeled frames")])
def test_too_few_labels_are_refused(num, said):
    counts, agreement = population(0.5)
    with pytest.raises(MetricError, match=said):
        control(counts[:num], [agreement], np.arange(200) < num, RECALL)
