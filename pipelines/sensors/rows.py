"""Rows of frozen dataclasses whose fields are arrays of one length, or have such rows themselves."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, Self

import numpy as np

from fbench.replay.data.arrays import Array


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
