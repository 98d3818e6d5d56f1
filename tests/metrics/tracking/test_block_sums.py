"""Sums of similarities are those of numpy to the last digit: where pairs are equally good, that decides."""

import numpy as np
import pytest

from fbench.metrics.core.similarity import block_starts
from fbench.metrics.core.sums_kernel import block_sums


@pytest.mark.parametrize("most", [12, 300])
def test_sums_are_numpy_s(most):
    rng = np.random.Generator(np.random.PCG64(most))
    shapes = np.concatenate([rng.integers(0, most, (60, 2)), [[9, 1], [1, 9], [200, 1], [8, 8], [129, 257]]])
    rows, columns = (np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64) for sizes in shapes.T)
    start = block_starts(rows, columns)
    values = rng.random(start[-1])
    of_row, of_column = np.zeros(rows[-1]), np.zeros(columns[-1])
    block_sums(rows, columns, start, values, of_row, of_column)
    for s, (n, m) in enumerate(shapes.tolist()):
        block = values[start[s] : start[s + 1]].reshape(n, m)
        assert of_row[rows[s] : rows[s + 1]].tolist() == block.sum(1).tolist()
        assert of_column[columns[s] : columns[s + 1]].tolist() == block.sum(0).tolist()
