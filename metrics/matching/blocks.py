"""Values of pairs, step by step, in one flat array."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fbench.replay.arrays import Bool, Float64, Int64


@dataclass(frozen=True, eq=False)
class Blocks:
    """One value for each pair of a row and a column of the same step: N rows, M columns, S steps.

    Those of step s are `values[start[s]:start[s + 1]]`, row-major.
    """

    row_start: Int64
    """(S + 1,) step s has rows `row_start[s]:row_start[s + 1]`."""
    column_start: Int64
    """(S + 1,)"""
    start: Int64
    """(S + 1,)"""
    values: Float64
    """(B,)"""

    @property
    def shape(self) -> tuple[int, int]:
        """N and M."""
        return int(self.row_start[-1]), int(self.column_start[-1])

    def block(self, step: int) -> Float64:
        """Values (n, m) of one step."""
        n, m = (int(start[step + 1] - start[step]) for start in (self.row_start, self.column_start))
        block: Float64 = self.values[self.start[step] : self.start[step + 1]].reshape(n, m)
        return block

    @cached_property
    def pairs(self) -> tuple[Int64, Int64]:
        """Row and column (B,) of each value."""
        return pairs_of(self.row_start, self.column_start)

    def select(self, rows: Bool, columns: Bool) -> "Blocks":
        """Return the pairs of the marked rows (N,) and columns (M,), numbered from 0 on."""
        row, column = self.pairs
        starts = [_before(mask)[start] for mask, start in ((rows, self.row_start), (columns, self.column_start))]
        return Blocks(starts[0], starts[1], block_starts(*starts), self.values[rows[row] & columns[column]])


def _before(mask: Bool) -> Int64:
    """(N + 1,) how many are marked before each place."""
    return np.concatenate([[0], np.cumsum(mask)]).astype(np.int64)


def block_starts(row_start: Int64, column_start: Int64) -> Int64:
    """Offsets (S + 1,) of the blocks in a flat array."""
    return np.concatenate([[0], np.cumsum(np.diff(row_start) * np.diff(column_start))]).astype(np.int64)


def pairs_of(row_start: Int64, column_start: Int64) -> tuple[Int64, Int64]:
    """Row and column (B,) of each value of a flat array of blocks."""
    num_rows, num_columns = np.diff(row_start), np.diff(column_start)
    of_row = np.repeat(num_columns, num_rows)
    row = np.repeat(np.arange(len(of_row)), of_row)
    first = np.repeat(np.repeat(column_start[:-1], num_rows), of_row)
    within = np.arange(len(row)) - np.repeat(np.cumsum(of_row) - of_row, of_row)
    return row.astype(np.int64), (first + within).astype(np.int64)
