from itertools import permutations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fbench.pipelines.tracking.association import associate, nearness


def test_the_sum_counts_not_the_best_pair() -> None:
    rows, columns = associate(np.array([[0.9, 0.8], [0.8, 0.1]]), 0.2)
    assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == [(0, 1), (1, 0)]


def test_low_similarity_is_rejected_and_pushes_no_pair_out() -> None:
    # Taking 0.19 for row 1 would force row 0 onto column 1; it isn't allowed, so row 0 keeps its best.
    rows, columns = associate(np.array([[0.5, 0.4], [0.19, 0.0]]), 0.2)
    assert (rows.tolist(), columns.tolist()) == ([0], [0])
    assert len(associate(np.array([[0.1]]), 0.2)[0]) == 0
    assert len(associate(np.array([[0.0]]), 0.0)[0]) == 0


def test_nothing_to_pair() -> None:
    for shape in ((0, 3), (3, 0), (0, 0)):
        assert len(associate(np.zeros(shape), 0.1)[0]) == 0


@given(arrays(np.float64, (3, 3), elements=st.floats(0, 1)), st.floats(0.01, 0.9))
def test_no_assignment_is_better(similarity: np.ndarray, least: float) -> None:
    rows, columns = associate(similarity, least)
    worth = np.where(similarity >= least, similarity, 0)
    best = max(sum(worth[i, j] for i, j in enumerate(order)) for order in permutations(range(3)))
    np.testing.assert_allclose(similarity[rows, columns].sum(), best)
    assert (similarity[rows, columns] >= least).all()


def test_nearness_falls_to_zero_at_the_gate() -> None:
    got = nearness(np.array([[0.0, 1.0, 2.0, 9.0], [0.0, 1.0, 2.0, 9.0]]), np.array([2.0, 4.0]))
    assert got.tolist() == [[1, 0.5, 0, 0], [1, 0.75, 0.5, 0]]
