"""A body that takes part: its shape and what it is called."""

from dataclasses import dataclass

from fbench.datasets.city.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Body:
    """The shape of one road user, in its own coordinates: x forward, y left, z up from the ground, the origin in the
    middle of its footprint.
    """

    label: str
    """One of `LABELS`."""
    size_lwh_m: tuple[float, float, float]
    """Length, width, height of the box that holds all phases: |x| <= l/2, |y| <= w/2, 0 <= z <= h."""
    phases: tuple[Mesh, ...]
    """One mesh, or those of a gait, evenly over one cycle."""

    def mesh_at(self, phase: float) -> int:
        """Index of the mesh at a phase from 0 to below 1."""
        return int(phase * len(self.phases)) % len(self.phases)


@dataclass(frozen=True, eq=False)
class Actor:
    """One road user in the world; the first is the ego vehicle."""

    body: Body
    parked: bool = False
