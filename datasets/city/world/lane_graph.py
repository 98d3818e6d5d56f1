"""How a network is written down: lanes that name those around them, before any of them has an index."""

from collections.abc import Hashable
from dataclasses import dataclass

from fbench.datasets.city.world.city_map import Lane, LaneKind
from fbench.replay.arrays import Float64


@dataclass(frozen=True, eq=False)
class Draft:
    """One lane; other lanes are named by their keys."""

    key: Hashable
    points_m: Float64
    """(P, 3)."""
    kind: LaneKind
    width_m: float
    speed_mps: float
    successors: tuple[Hashable, ...]
    left: Hashable | None = None
    right: Hashable | None = None
    signal: int | None = None
    in_junction: bool = False
    longest_m: float = float("inf")


def joined(drafts: list[Draft]) -> tuple[Lane, ...]:
    """Number the lanes in their order.

    Raises:
        KeyError: where a lane names one that isn't there.
    """
    index = {draft.key: i for i, draft in enumerate(drafts)}
    return tuple(_lane(draft, index) for draft in drafts)


def _lane(draft: Draft, index: dict[Hashable, int]) -> Lane:
    return Lane(
        draft.points_m, draft.width_m, draft.speed_mps, draft.kind,
        tuple(index[key] for key in draft.successors),
        None if draft.left is None else index[draft.left],
        None if draft.right is None else index[draft.right],
        draft.signal, draft.in_junction, draft.longest_m,
    )  # fmt: skip
