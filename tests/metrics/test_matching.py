"""The matcher against hand-made tables and brute force."""

from collections.abc import Callable
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fbench.metrics.matching import Matches, match_greedy, match_hungarian
from fbench.replay.arrays import Bool, Float64

THRESHOLD = 0.5


UNIT = st.floats(0, 1)


def similarities(levels: st.SearchStrategy[float] = UNIT) -> st.SearchStrategy[Float64]:
    shapes = st.tuples(st.integers(0, 4), st.integers(0, 4))
    return shapes.flatmap(lambda shape: arrays(float, shape, elements=levels))


def pairs(matches: Matches) -> list[tuple[int, int]]:
    """Pairs (truth, estimate); both directions must say the same."""
    forth = [(t, int(e)) for t, e in enumerate(matches.estimate_of_truth) if e >= 0]
    back = [(int(t), e) for e, t in enumerate(matches.truth_of_estimate) if t >= 0]
    assert sorted(back) == forth
    return forth


def test_greedy_lets_the_best_score_choose() -> None:
    similarity = np.array([[0.9, 0.6], [0.0, 0.0]])
    assert pairs(match_greedy(similarity, THRESHOLD, np.array([0.1, 0.9]))) == [(0, 1)]


def test_greedy_gives_an_estimate_its_most_similar_free_truth() -> None:
    similarity = np.array([[0.6, 0.9], [0.7, 0.95]])
    assert pairs(match_greedy(similarity, THRESHOLD, np.array([0.2, 0.8]))) == [(0, 0), (1, 1)]


def test_equal_scores_go_by_similarity_then_index() -> None:
    assert pairs(match_greedy(np.array([[0.6, 0.9]]), THRESHOLD, np.zeros(2))) == [(0, 1)]
    assert pairs(match_greedy(np.array([[0.7, 0.7]]), THRESHOLD, np.zeros(2))) == [(0, 0)]
    assert pairs(match_greedy(np.array([[0.7], [0.7]]), THRESHOLD, np.zeros(1))) == [(0, 0)]


def test_hungarian_pairs_more_where_greedy_pairs_less() -> None:
    similarity = np.array([[0.9, 0.8], [0.7, 0.0]])
    assert pairs(match_greedy(similarity, THRESHOLD, np.array([0.9, 0.1]))) == [(0, 0)]
    assert pairs(match_hungarian(similarity, THRESHOLD)) == [(0, 1), (1, 0)]


def test_a_pair_below_the_threshold_displaces_nothing() -> None:
    # Ungated, the assignment of the highest total is (0, 1), (1, 0) with 0.49 + 0.49 > 0.6 + 0.
    similarity = np.array([[0.6, 0.49], [0.49, 0.0]])
    assert pairs(match_hungarian(similarity, THRESHOLD)) == [(0, 0)]


@pytest.mark.parametrize("match", [lambda s: match_greedy(s, THRESHOLD, np.zeros(s.shape[1])),
                                   lambda s: match_hungarian(s, THRESHOLD)])  # fmt: skip
def test_the_threshold_is_included_and_nan_and_inf_never_match(match: Callable[[Float64], Matches]) -> None:
    assert pairs(match(np.array([[0.5]]))) == [(0, 0)]
    assert pairs(match(np.array([[np.nextafter(0.5, 0)]]))) == []
    assert pairs(match(np.array([[np.nan, -np.inf]]))) == []


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (3, 0)])
def test_empty_sides_match_nothing(shape: tuple[int, int]) -> None:
    for matches in (
        match_greedy(np.zeros(shape), THRESHOLD, np.zeros(shape[1])),
        match_hungarian(np.zeros(shape), THRESHOLD),
    ):
        assert matches.estimate_of_truth.tolist() == [-1] * shape[0]
        assert matches.truth_of_estimate.tolist() == [-1] * shape[1]


def test_preferred_estimates_come_first() -> None:
    similarity, preferred = np.array([[0.6, 0.9]]), np.array([True, False])
    assert pairs(match_greedy(similarity, THRESHOLD, np.array([0.1, 0.9]), preferred)) == [(0, 0)]
    assert pairs(match_hungarian(similarity, THRESHOLD, preferred)) == [(0, 0)]


def test_more_pairs_beat_preferred_pairs() -> None:
    similarity = np.array([[0.9, 0.9], [0.9, 0.0]])
    assert pairs(match_hungarian(similarity, THRESHOLD, np.array([True, False]))) == [(0, 1), (1, 0)]


@given(similarities(), st.data())
def test_greedy_equals_the_rule_spelt_out(similarity: Float64, data: st.DataObject) -> None:
    n, m = similarity.shape
    score = np.array(data.draw(st.lists(st.floats(0, 1), min_size=m, max_size=m, unique=True)))
    free, expected = set(range(n)), []
    for e in sorted(range(m), key=lambda e: -score[e]):
        near = [t for t in sorted(free) if similarity[t, e] >= THRESHOLD]
        if near:
            best = max(near, key=lambda t: (similarity[t, e], -t))
            free.remove(best)
            expected.append((best, e))
    assert pairs(match_greedy(similarity, THRESHOLD, score)) == sorted(expected)


def brute_force(similarity: Float64, preferred: Bool) -> tuple[int, int, float]:
    """Best (number of pairs, number of preferred, total) over all assignments."""
    n, m = similarity.shape
    best = (0, 0, 0.0)
    for choice in permutations([*range(m), *[-1] * n], n):
        chosen = [(t, e) for t, e in enumerate(choice) if e >= 0 and similarity[t, e] >= THRESHOLD]
        total = sum(similarity[t, e] for t, e in chosen)
        best = max(best, (len(chosen), sum(bool(preferred[e]) for _, e in chosen), total))
    return best


@given(similarities() | similarities(st.sampled_from([0.0, 0.5, 0.75, 1.0])), st.data())
def test_hungarian_equals_brute_force(similarity: Float64, data: st.DataObject) -> None:
    m = similarity.shape[1]
    preferred = np.array(data.draw(st.lists(st.booleans(), min_size=m, max_size=m)), bool)
    found = pairs(match_hungarian(similarity, THRESHOLD, preferred))
    assert all(similarity[t, e] >= THRESHOLD for t, e in found)
    num, favoured, total = brute_force(similarity, preferred)
    assert (len(found), sum(bool(preferred[e]) for _, e in found)) == (num, favoured)
    assert sum(similarity[t, e] for t, e in found) == pytest.approx(total)


@given(similarities())
def test_pairs_of_one_frame_dont_depend_on_the_unit(similarity: Float64) -> None:
    found = match_hungarian(similarity, THRESHOLD)
    scaled = match_hungarian(similarity * 8 - 3, THRESHOLD * 8 - 3)
    assert len(pairs(found)) == len(pairs(scaled))
