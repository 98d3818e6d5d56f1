"""Boxes of many frames in one struct of arrays."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from fbench.replay.arrays import Array
from fbench.replay.boxes import Boxes2D, Boxes3D

B = TypeVar("B", Boxes2D, Boxes3D)
_UNKNOWN = {"f": np.nan, "i": -1, "u": 0, "b": False, "U": ""}
"""What stands for 'unknown' where a frame lacks what others have."""


def stacked(parts: Sequence[B], nothing: B) -> B:
    """Join boxes one after the other; what only some tell is unknown in the others."""
    full = [part for part in parts if len(part)]
    if not full:
        return nothing
    joined: dict[str, Any] = {}
    for own in fields(full[0]):
        columns = [getattr(part, own.name) for part in full]
        example = next((column for column in columns if column is not None), None)
        if example is not None:
            joined[own.name] = np.concatenate([
                _unknown(len(part), example) if column is None else column
                for part, column in zip(full, columns, strict=True)
            ])  # fmt: skip
    return type(nothing)(**joined)


def _unknown(num: int, like: Array) -> Array:
    return np.full((num, *like.shape[1:]), _UNKNOWN[like.dtype.kind], like.dtype)
