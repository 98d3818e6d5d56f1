"""Taking pairs in a given order."""

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.kernels import kernel


@kernel
def first_come(rows: Int64, columns: Int64, num_rows: int, num_columns: int) -> Int64:
    """Return the row (M,) of each column, -1 where it has none: a pair (P,) is taken where both are still free."""
    taken, row_of = np.empty(num_rows, np.bool_), np.empty(num_columns, np.int64)
    for i in range(num_rows):
        taken[i] = False
    for j in range(num_columns):
        row_of[j] = -1
    for k in range(len(rows)):
        row, column = rows[k], columns[k]
        if not taken[row] and row_of[column] < 0:
            taken[row] = True
            row_of[column] = row
    return row_of
