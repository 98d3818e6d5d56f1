import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fbench.metrics.core.matching import match_greedily, score_order
from fbench.metrics.core.similarity import Blocks

ONE_STEP = (np.array([0, 2]), np.array([0, 3]), np.array([0, 6]))
SIMILARITY = np.array([[0.6, 0.7, 0.5], [0.5, 0.65, 0.9]])


def match(similarity: np.ndarray, floors: list[float], order: list[int], **kinds: object) -> list[list[int]]:
    starts = np.array([0, len(similarity)]), np.array([0, similarity.shape[1]]), np.array([0, similarity.size])
    return match_greedily(Blocks(*starts, similarity.ravel()), np.array(order), floors, **kinds).tolist()


def test_the_first_chooses_and_each_truth_goes_once() -> None:
    assert match(SIMILARITY, [0.5], [1, 0, 2]) == [[1, 0, -1]]
    assert match(SIMILARITY, [0.5], [0, 1, 2]) == [[0, 1, -1]]
    assert match(SIMILARITY, [0.5], [2, 1, 0]) == [[-1, 0, 1]]


def test_each_floor_is_matched_for_itself_and_may_be_strict() -> None:
    assert match(SIMILARITY, [0.5, 0.7, 0.95], [1, 0, 2]) == [[1, 0, -1], [-1, 0, 1], [-1, -1, -1]]
    assert match(SIMILARITY, [0.7], [1, 0, 2], strict=True) == [[-1, -1, 1]]


def test_ignored_truth_gets_what_counted_truth_does_not_want() -> None:
    rank = np.array([1, 0])
    assert match(SIMILARITY, [0.5], [1, 0, 2], rank=rank) == [[0, 1, -1]]
    shared = np.array([True, False])
    assert match(SIMILARITY, [0.5], [1, 0, 2], rank=rank, shared=shared) == [[0, 1, 0]]


def test_what_is_not_a_number_never_matches() -> None:
    assert match(np.array([[np.nan, -np.inf, -3.0]]), [-2.0], [0, 1, 2]) == [[-1, -1, -1]]


def test_equal_similarities_take_the_lower_row() -> None:
    assert match(np.array([[0.5], [0.5]]), [0.5], [0]) == [[0]]


def test_steps_are_apart() -> None:
    starts = np.array([0, 1, 1, 2]), np.array([0, 1, 2, 4]), np.array([0, 1, 1, 3])
    found = match_greedily(Blocks(*starts, np.array([0.9, 0.4, 0.8])), np.array([0, 1, 3, 2]), [0.3])
    assert found.tolist() == [[0, -1, -1, 1]]


def test_without_boxes() -> None:
    zeros = np.zeros(3, np.int64)
    nothing = Blocks(zeros, zeros, zeros, np.zeros(0))
    assert match_greedily(nothing, np.zeros(0, np.int64), [0.5]).shape == (1, 0)


def test_order_is_by_step_score_and_content() -> None:
    step, score = np.array([0, 0, 0, 0, 1]), np.array([0.5, np.nan, 0.5, 0.9, 0.1])
    content = np.array([[2.0, 0], [0, 0], [1, 5], [9, 9], [0, 0]])
    assert score_order(step, score, content).tolist() == [3, 2, 0, 1, 4]


@given(st.integers(0, 10_000))
def test_as_a_plain_loop_does(seed: int) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    n, m = rng.integers(0, 6, 2)
    similarity, rank, shared = rng.integers(0, 5, (n, m)) / 4, rng.integers(0, 2, n), rng.random(n) < 0.3
    order = rng.permutation(m)
    expected, taken = [-1] * int(m), set()
    for e in order.tolist():
        free = [t for t in range(n) if similarity[t, e] >= 0.5 and (shared[t] or t not in taken)]
        if free:
            expected[e] = min(free, key=lambda t: (rank[t], -similarity[t, e], t))
            taken.add(expected[e])
    assert match(similarity, [0.5], order.tolist(), rank=rank, shared=shared) == [expected]
