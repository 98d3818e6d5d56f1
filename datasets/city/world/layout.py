"""What stands where: the plan from which the static world's mesh is built."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

from fbench.datasets.city.world.city_map import CityMap
from fbench.replay.arrays import Float64

GROUND_Z_M = -0.02
"""Height of the meadow all around, just below roads."""
Kind: TypeAlias = Literal[
    "building", "tree", "bush", "lamp_post", "signal", "sign", "bench", "bin", "hydrant", "barrier", "gantry", "fence"
]


@dataclass(frozen=True, eq=False)
class Patch:
    """A flat piece of ground: a road, a sidewalk, a marking."""

    material: str
    """Name in `MATERIALS`."""
    points_m: Float64
    """(P, 2) outline in the world, counter-clockwise, not closed, without holes; may be concave."""
    z_m: float
    """Its height; where it is above the ground and has a kerb, its sides go down to 0."""
    has_kerb: bool = False
    shade: float = 1.0
    """Factor on the material's usual colour."""


@dataclass(frozen=True)
class Placement:
    """One thing that stands."""

    kind: Kind
    position_m: tuple[float, float, float]
    """The middle of its foot."""
    yaw_rad: float
    """Where its front looks; along a barrier or fence."""
    size_lwh_m: tuple[float, float, float]
    """Length along its front's direction, width, height; a tree's crown is as wide as it is.

    A lamp post's length is the reach of its arm from the foot, a barrier's or fence's how far it goes on both sides of
    its foot together; a gantry spans the road by its width.
    """
    variant: int = 0
    """Seed of its looks."""
    signal: int | None = None
    """Group of signals that a signal shows: its lamps are 3 * group + 0 red, 1 yellow, 2 green."""


@dataclass(frozen=True, eq=False)
class Layout:
    """A whole world."""

    map: CityMap
    patches: tuple[Patch, ...]
    placements: tuple[Placement, ...]
