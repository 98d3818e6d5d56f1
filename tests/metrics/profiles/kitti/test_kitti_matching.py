"""The gated assignment of a frame against scipy, with ties."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from fbench.metrics.profiles.kitti.kernels import match_frame


def solved(block: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimate and similarity of each row; pairs with NaN can't match."""
    row, column = np.nonzero(~np.isnan(block))
    start = np.searchsorted(row, np.arange(len(block) + 1))
    matched, similarity = np.full(len(block), 7), np.full(len(block), 7.0)
    sizes = 0, len(block), 0, block.shape[1]
    match_frame(*sizes, start, column, block[row, column], kept, matched, similarity)
    return matched, similarity


@pytest.mark.parametrize("levels", [3, 10**9])
def test_most_pairs_match_and_of_these_the_nearest(levels):
    rng = np.random.default_rng(levels)
    for _ in range(1500):
        n, m = rng.integers(1, 9, 2)
        block = rng.integers(1, levels, (n, m), endpoint=True) / levels
        block[rng.random((n, m)) < rng.random()] = np.nan
        kept = rng.random(m) < 0.8
        matched, similarity = solved(block, kept)
        cost = np.where(np.isnan(block) | ~kept, 1e3, 1 - block)
        i, j = linear_sum_assignment(cost)
        possible = cost[i, j] < 1e3
        hits = np.flatnonzero(matched >= 0)
        assert len(hits) == possible.sum()
        assert len(set(matched[hits])) == len(hits)
        assert similarity[hits] == pytest.approx(block[hits, matched[hits]], abs=1e-15)
        assert similarity.sum() == pytest.approx((1 - cost[i, j])[possible].sum(), abs=1e-9)
        assert kept[matched[hits]].all()
