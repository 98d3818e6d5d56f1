"""Rows of frozen dataclasses whose fields are arrays of one length, and which of them stay in place of rivals."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, Self

import numpy as np

from fbench.replay.data.arrays import Array, Bool, Int64


def suppress(rivals: Bool) -> Int64:
    """Greedy non-maximum suppression: rows (K,) that stay where each of N, the surest first, gives way to those before
    it that stay and are its `rivals` (N, N).
    """
    stays = np.ones(len(rivals), np.bool_)
    for row in range(1, len(rivals)):
        stays[row] = not (rivals[row, :row] & stays[:row]).any()
    return np.flatnonzero(stays)


class Rows:
    """A frozen dataclass with arrays (N, ...) for fields."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))  # type: ignore[arg-type]

    def __getitem__(self, rows: Array | slice) -> Self:
        """Select rows by mask, index array or slice."""
        chosen: dict[str, Any] = {f.name: getattr(self, f.name)[rows] for f in fields(self)}  # type: ignore[arg-type]
        return replace(self, **chosen)  # type: ignore[type-var]

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Put the rows of at least one part one after the other."""
        names = [f.name for f in fields(cls)]  # type: ignore[arg-type]
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})
