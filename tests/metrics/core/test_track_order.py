"""Boxes and tracks in an order that no id and no order of rows decides."""

import numpy as np
import pytest

from fbench.metrics.core.ordering import content_ranks, life_ranks


def test_equal_rows_have_one_rank_and_the_first_column_counts_most():
    ranks = content_ranks([np.array([2, 1, 1, 1]), np.array([0.0, 5.0, 4.0, 5.0]), np.array(["a", "b", "b", "b"])])
    assert ranks.tolist() == [2, 1, 0, 1]


def test_unknown_values_are_equal_and_come_last():
    assert content_ranks([np.array([np.nan, 1.0, np.nan])]).tolist() == [1, 0, 1]


def test_nothing_has_no_ranks():
    nothing = np.zeros(0, np.int64)
    assert not len(life_ranks(content_ranks([nothing]), nothing))


def test_tracks_are_compared_from_their_first_box_on_and_end_last():
    # by time: track 7 is at 0, 1; track 3 at 0, 2; track 5 at 0
    box, track = np.array([0, 0, 0, 1, 2]), np.array([7, 3, 5, 7, 3])
    assert life_ranks(box, track).tolist() == [0, 1, 2, 0, 1]


@pytest.mark.parametrize("seed", range(5))
def test_neither_names_nor_rows_matter(seed):
    rng = np.random.default_rng(seed)
    track = np.repeat(np.arange(6), 4)
    box = np.tile(np.arange(4), 6) * 2 + rng.integers(0, 2, 24)
    names, rows = rng.permutation(100)[:6], rng.permutation(24)

    def lives(boxes: np.ndarray, ranks: np.ndarray) -> list[list[int]]:
        return [boxes[ranks == k].tolist() for k in range(6)]

    again = life_ranks(box[rows], names[track[rows]])
    own = lives(box, life_ranks(box, track))
    assert own == [sorted(life) for life in lives(box[rows], again)]
    assert own == sorted(own)
