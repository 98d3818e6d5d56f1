"""Best F1 and average precision over all score thresholds."""

from dataclasses import replace
from functools import reduce
from itertools import pairwise
from operator import add

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.metrics.standard.made import Box, sequence

from fbench.metrics.core.slices import VEHICLE
from fbench.metrics.detection.scores import Ranking, detection_counts
from fbench.replay.contracts.profiles import Match

Hits = list[tuple[float, bool]]


def ranking(hits: Hits, num_truth: int) -> Ranking:
    return Ranking.of(np.array([s for s, _ in hits], float), np.array([h for _, h in hits], bool), num_truth)


def test_hand_values() -> None:
    """At 0.9 P = 1, R = 1/4; at 0.8 P = 1/2; at 0.7 P = 2/3, R = 1/2; at 0.6 P = 3/4, R = 3/4; at 0.5 P = 3/5."""
    of = ranking([(0.9, True), (0.8, False), (0.7, True), (0.6, True), (0.5, False)], 4)
    assert of.best_f1() == (0.75, 0.6)
    # Precision 1 up to recall 0.25 (26 of 101 points), 3/4 up to 0.75 (50 points), 0 after.
    assert of.average_precision() == pytest.approx((26 * 1 + 50 * 0.75) / 101, abs=1e-15)


def test_the_highest_of_equally_good_thresholds_is_said() -> None:
    of = ranking([(0.9, True), (0.8, False), (0.7, True), (0.6, False), (0.5, False), (0.4, False)], 1)
    assert of.best_f1() == (1.0, 0.9)


def test_equal_scores_are_one_threshold() -> None:
    of = ranking([(0.5, True), (0.5, False), (0.5, False)], 1)
    assert (of.best_f1(), of.average_precision()) == ((0.5, 0.5), pytest.approx(1 / 3))


@pytest.mark.parametrize(
    ("hits", "num", "reason"),
    [([(0.5, True)], 0, "no truth boxes"), ([], 3, "no estimates"), ([(0.0, True)], 1, "results have no scores"),
     ([(0.0, True), (0.1, True)], 2, None)],
)  # fmt: skip
def test_there_is_no_curve_without_truth_estimates_or_scores(hits: Hits, num: int, reason: str | None) -> None:
    assert ranking(hits, num).reason == reason


HITS = st.lists(st.tuples(st.sampled_from([0.1, 0.25, 0.5, 0.75, 1.0]), st.booleans()), min_size=1, max_size=12)


@given(HITS, st.integers(0, 5))
def test_as_a_plain_reference(hits: Hits, more: int) -> None:
    num_truth = max(sum(hit for _, hit in hits) + more, 1)
    points = []
    for threshold in sorted({score for score, _ in hits}, reverse=True):
        kept = [hit for score, hit in hits if score >= threshold]
        points.append((threshold, sum(kept) / len(kept), sum(kept) / num_truth))
    f1 = [(2 * p * r / (p + r) if p + r else 0.0, threshold) for threshold, p, r in points]
    ap = np.mean([max((p for _, p, r in points if r >= at / 100 - 1e-12), default=0.0) for at in range(101)])
    of = ranking(hits, num_truth)
    assert of.best_f1()[0] == pytest.approx(max(f1)[0])
    assert of.average_precision() == pytest.approx(ap)


@given(st.lists(HITS, min_size=1, max_size=5), st.randoms(use_true_random=False))
def test_adding_in_any_grouping_gives_the_same(parts: list[Hits], random) -> None:  # type: ignore[no-untyped-def]
    whole = ranking([hit for part in parts for hit in part], 40)
    own = [ranking(part, 0) for part in parts] + [ranking([], 40)]
    random.shuffle(own)
    cut = random.randint(0, len(own))
    left, right = (reduce(add, part, ranking([], 0)) for part in (own[:cut], own[cut:]))
    for summed in (left + right, right + left):
        assert [a.tolist() for a in (summed.scores, summed.tp, summed.fp)] == [
            a.tolist() for a in (whole.scores, whole.tp, whole.fp)
        ]
        assert (summed.best_f1(), summed.average_precision()) == (whole.best_f1(), whole.average_precision())


@given(st.integers(0, 10_000))
def test_each_threshold_gives_what_scoring_at_it_would(seed: int) -> None:
    """Greedy matching by score is the same above a threshold whatever is below."""
    rng = np.random.Generator(np.random.PCG64(seed))
    truth = [Box(int(s), x) for s, x in zip(rng.integers(0, 2, 5), rng.uniform(5, 15, 5), strict=True)]
    estimates = [
        Box(int(s), x, score=float(c))
        for s, x, c in zip(rng.integers(0, 2, 8), rng.uniform(5, 15, 8), rng.integers(1, 6, 8) / 8, strict=True)
    ]
    match = Match("bev", 2.0)
    curve = detection_counts(sequence(truth, estimates, 2), VEHICLE, match).ranking
    tp, fp = np.cumsum(curve.tp), np.cumsum(curve.fp)
    for at, threshold in enumerate(curve.scores):
        kept = [box for box in estimates if box.score >= threshold]
        boxes = detection_counts(sequence(truth, kept, 2), VEHICLE, match).boxes
        assert (boxes.tp, boxes.fp) == (tp[at], fp[at])
    assert all(a > b for a, b in pairwise(curve.scores.tolist()))


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10_000))
def test_so_does_each_threshold_where_truth_excuses(seed: int) -> None:
    """Who is excused mustn't depend on what the threshold leaves out."""
    rng = np.random.Generator(np.random.PCG64(seed))
    truth, found = (
        [Box(int(s), float(x), score=float(c))
         for s, x, c in zip(rng.integers(0, 2, n), rng.integers(0, 6, n), rng.integers(1, 5, n), strict=True)]
        for n in rng.integers(1, 9, 2)
    )  # fmt: skip
    whole = sequence(truth, found, 2)
    whole = replace(whole, truth=replace(whole.truth, ignore=rng.random(len(truth)) < 0.5))
    counts = detection_counts(whole, VEHICLE, Match("bev", 1.0))
    if counts.ranking.reason is None:
        scores = whole.estimates.score
        parts = [replace(whole, estimates=whole.estimates[scores >= score]) for score in np.unique(scores)]
        each = [detection_counts(part, VEHICLE, Match("bev", 1.0)).boxes for part in parts]
        assert counts.ranking.best_f1()[0] == max(2 * n.tp / (2 * n.tp + n.fp + n.fn) for n in each)
