"""Taking pairs in a given order."""

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.kernels import kernel


@kernel
def first_come(rows: Int64, columns: Int64, num_rows: int, num_columns: int) -> Int64:
    """Return the row (M,) of each column, -1 where it has none: a pair (P,) is taken where both are still free."""
    taken = np.zeros(num_rows, np.bool_)
    row_of = np.full(num_columns, -1, np.int64)
    for k in range(len(rows)):
        row, column = rows[k], columns[k]
        if not taken[row] and row_of[column] < 0:
            taken[row] = True
            row_of[column] = row
    return row_of
