"""Checks of the arrays inside the data types: shape and dtype, once, with an error that names the field."""

from collections.abc import Sequence
from dataclasses import is_dataclass
from itertools import islice
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from fbench.replay.contracts.errors import DataError

Array = NDArray[Any]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]
Text = NDArray[np.str_]

Shape = tuple[int | str, ...]
DIGESTED = "digested"  # Key of a field's metadata: `False` where other fields determine it, so that no digest needs it
MAX_TEXT = 1000  # Characters of a text in an array, where each takes the room of the longest


def check_array(owner: str, field: str, value: object, dtype: DTypeLike, shape: Shape, sizes: dict[str, int]) -> Array:
    """Return `value` as a read-only array of `dtype` and `shape`. A letter in `shape` stands for a size that must agree
    between all fields of one object; `sizes` holds those met so far and is extended. Casts that lose nothing are made,
    others refused. Raises DataError naming field, expected and got.
    """
    array, wanted, num_known = np.asarray(value), np.dtype(dtype), len(sizes)
    is_text = wanted.kind == "U"
    is_same = array.dtype.kind == "U" if is_text else array.dtype == wanted
    fits = array.ndim == len(shape)
    if fits and not is_same:
        fits = array.size == 0 or (not is_text and np.can_cast(array.dtype, wanted, "safe"))
    if fits:
        for want, have in zip(shape, array.shape, strict=True):
            fixed = sizes.setdefault(want, have) if isinstance(want, str) else want
            fits = fits and fixed == have
    if not fits:
        known = dict(islice(sizes.items(), num_known))
        expected = f"{wanted.name} ({', '.join(str(known.get(str(s), s)) for s in shape)})"
        raise DataError(f"{owner}.{field}: expected {expected}, got {array.dtype.name} {array.shape}")
    view = (array if is_same else array.astype(wanted, copy=False)).view()
    view.flags.writeable = False
    return view


def text_array(texts: Sequence[str]) -> Text:
    """Return texts of others as an array (N,). Raises DataError where one is longer than `MAX_TEXT`."""
    longest = max(map(len, texts), default=0)
    if longest > MAX_TEXT:
        raise DataError(f"a text has {longest} characters, more than {MAX_TEXT}")
    return np.array(texts, np.str_)


def freeze_fields(owner: object, **specs: tuple[str, Shape]) -> None:
    """Check the named array fields of a frozen dataclass and make them read-only; `None` stays `None`."""
    sizes: dict[str, int] = {}
    for name, (dtype, shape) in specs.items():
        value = getattr(owner, name)
        if value is not None:
            array = check_array(type(owner).__name__, name, value, dtype, shape, sizes)
            object.__setattr__(owner, name, array)


T = TypeVar("T")


def own_arrays(value: T) -> T:
    """Return a frozen dataclass with copies of its arrays, those of dataclasses in it too; anything else as it is.

    What a plug-in hands over may be views of a buffer that it fills again for the next frame.
    """
    if isinstance(value, np.ndarray):
        array = value.copy()
        array.setflags(write=False)
        return array
    if value is None or isinstance(value, type) or not is_dataclass(value):
        return value
    own = object.__new__(type(value))
    vars(own).update({name: own_arrays(part) for name, part in vars(value).items()})
    return own
