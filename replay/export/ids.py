"""Track ids that other tools can read."""

from collections.abc import Callable, Iterable

from fbench.replay.boxes import Boxes2D, Boxes3D

_LIMIT = 2**31
"""Tools read ids as int32, or as float64 that don't tell larger ones apart."""


def small_ids(parts: Iterable[Boxes2D | Boxes3D]) -> Callable[[int], int]:
    """Return what gives each id its number: its own where all of a sequence are small, else 0, 1 ... in the order in
    which they come; -1 stays.
    """
    ids = [id_ for boxes in parts if boxes.track_id is not None for id_ in boxes.track_id.tolist() if id_ >= 0]
    if max(ids, default=0) < _LIMIT:
        return lambda id_: id_
    numbers = {id_: number for number, id_ in enumerate(dict.fromkeys(ids))}
    return lambda id_: numbers.get(id_, -1)
