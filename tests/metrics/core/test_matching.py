"""The matcher against hand-made tables and brute force."""

from collections.abc import Callable
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fbench.metrics.core.matching import match_best, match_greedy
from fbench.metrics.core.similarity import Blocks, block_starts
from fbench.replay.data.arrays import Bool, Float64, Int64

THRESHOLD = 0.5


UNIT = st.floats(0, 1)


def similarities(levels: st.SearchStrategy[float] = UNIT) -> st.SearchStrategy[Float64]:
    shapes = st.tuples(st.integers(0, 4), st.integers(0, 4))
    return shapes.flatmap(lambda shape: arrays(float, shape, elements=levels))


def steps(*similarities: Float64) -> Blocks:
    """One step a table."""
    rows, columns = (np.cumsum([0, *(len(s) if axis == 0 else s.shape[1] for s in similarities)]) for axis in (0, 1))
    flat = np.concatenate([np.zeros(0), *(s.ravel() for s in similarities)])
    return Blocks(rows, columns, block_starts(rows, columns), flat)


def greedy(similarity: Float64, score: Float64, late: Bool | None = None) -> Int64:
    return match_greedy(steps(similarity), THRESHOLD, score, late)


def best(similarity: Float64, late: Bool | None = None, threshold: float = THRESHOLD) -> Int64:
    return match_best(steps(similarity), threshold, late)


def pairs(truth_of: Int64) -> list[tuple[int, int]]:
    """Pairs (truth, estimate); no truth box is there twice."""
    found = sorted((int(t), e) for e, t in enumerate(truth_of) if t >= 0)
    assert len({t for t, _ in found}) == len(found)
    return found


def test_greedy_lets_the_best_score_choose() -> None:
    similarity = np.array([[0.9, 0.6], [0.0, 0.0]])
    assert pairs(greedy(similarity, np.array([0.1, 0.9]))) == [(0, 1)]


def test_greedy_gives_an_estimate_its_most_similar_free_truth() -> None:
    similarity = np.array([[0.6, 0.9], [0.7, 0.95]])
    assert pairs(greedy(similarity, np.array([0.2, 0.8]))) == [(0, 0), (1, 1)]


def test_equal_scores_go_by_similarity_then_index() -> None:
    assert pairs(greedy(np.array([[0.6, 0.9]]), np.zeros(2))) == [(0, 1)]
    assert pairs(greedy(np.array([[0.7, 0.7]]), np.zeros(2))) == [(0, 0)]
    assert pairs(greedy(np.array([[0.7], [0.7]]), np.zeros(1))) == [(0, 0)]


def test_best_pairs_more_where_greedy_pairs_less() -> None:
    similarity = np.array([[0.9, 0.8], [0.7, 0.0]])
    assert pairs(greedy(similarity, np.array([0.9, 0.1]))) == [(0, 0)]
    assert pairs(best(similarity)) == [(0, 1), (1, 0)]


def test_a_pair_below_the_threshold_displaces_nothing() -> None:
    # Ungated, the assignment of the highest total is (0, 1), (1, 0) with 0.49 + 0.49 > 0.6 + 0.
    similarity = np.array([[0.6, 0.49], [0.49, 0.0]])
    assert pairs(best(similarity)) == [(0, 0)]


@pytest.mark.parametrize("match", [lambda s: greedy(s, np.zeros(s.shape[1])), best])
def test_the_threshold_is_included_and_nan_and_inf_never_match(match: Callable[[Float64], Int64]) -> None:
    assert pairs(match(np.array([[0.5]]))) == [(0, 0)]
    assert pairs(match(np.array([[np.nextafter(0.5, 0)]]))) == []
    assert pairs(match(np.array([[np.nan, -np.inf]]))) == []


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (3, 0)])
def test_empty_sides_match_nothing(shape: tuple[int, int]) -> None:
    for matches in (greedy(np.zeros(shape), np.zeros(shape[1])), best(np.zeros(shape))):
        assert matches.tolist() == [-1] * shape[1]


def test_late_estimates_come_last() -> None:
    similarity, late = np.array([[0.6, 0.9]]), np.array([False, True])
    assert pairs(greedy(similarity, np.array([0.1, 0.9]), late)) == [(0, 0)]
    assert pairs(best(similarity, late)) == [(0, 0)]


def test_more_pairs_beat_early_ones() -> None:
    similarity = np.array([[0.9, 0.9], [0.9, 0.0]])
    assert pairs(best(similarity, np.array([False, True]))) == [(0, 1), (1, 0)]


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
    assert pairs(greedy(similarity, score)) == sorted(expected)


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
def test_best_equals_brute_force(similarity: Float64, data: st.DataObject) -> None:
    m = similarity.shape[1]
    late = np.array(data.draw(st.lists(st.booleans(), min_size=m, max_size=m)), bool)
    found = pairs(best(similarity, late))
    assert all(similarity[t, e] >= THRESHOLD for t, e in found)
    num, favoured, total = brute_force(similarity, ~late)
    assert (len(found), sum(bool(~late[e]) for _, e in found)) == (num, favoured)
    assert sum(similarity[t, e] for t, e in found) == pytest.approx(total)


@given(similarities())
def test_pairs_dont_depend_on_the_unit(similarity: Float64) -> None:
    scaled = best(similarity * 8 - 3, threshold=THRESHOLD * 8 - 3)
    assert len(pairs(best(similarity))) == len(pairs(scaled))


@given(st.lists(similarities(st.sampled_from([0.0, 0.5, 0.75, 1.0])), max_size=4), st.data())
def test_steps_are_matched_each_for_itself(tables: list[Float64], data: st.DataObject) -> None:
    sizes = [table.shape[1] for table in tables]
    num = sum(sizes)
    score = np.array(data.draw(st.lists(st.sampled_from([0.1, 0.5, 0.9]), min_size=num, max_size=num)), float)
    late = np.array(data.draw(st.lists(st.booleans(), min_size=num, max_size=num)), bool)
    together = steps(*tables)
    found = match_greedy(together, THRESHOLD, score, late), match_best(together, THRESHOLD, late)
    row = column = 0
    for table, size in zip(tables, sizes, strict=True):
        own = slice(column, column + size)
        alone = greedy(table, score[own], late[own]), best(table, late[own])
        for whole, part in zip(found, alone, strict=True):
            assert whole[own].tolist() == [t + row if t >= 0 else -1 for t in part.tolist()]
        row, column = row + len(table), column + size


@given(st.lists(similarities(), min_size=1, max_size=4), st.data())
def test_selected_pairs_are_those_of_the_marked_rows_and_columns(tables: list[Float64], data: st.DataObject) -> None:
    blocks = steps(*tables)
    masks = [np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)), bool) for n in blocks.shape]
    selected = blocks.select(*masks)
    for step, table in enumerate(tables):
        rows = masks[0][blocks.row_start[step] : blocks.row_start[step + 1]]
        columns = masks[1][blocks.column_start[step] : blocks.column_start[step + 1]]
        assert selected.block(step).tolist() == table[rows][:, columns].tolist()
