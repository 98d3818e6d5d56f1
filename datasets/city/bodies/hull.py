"""A vehicle's hull: its surface with windows and arches, and what is put on it."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fbench.datasets.city.bodies.paints import BLACK, GLASS
from fbench.datasets.city.bodies.profile import Profile, Sections, sections
from fbench.datasets.city.bodies.shell import both, shell, skinned
from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.shapes import Skin, quad
from fbench.replay.arrays import Array, Bool, Float64

_PAINT, _GLASS, _BLACK, _SKIRT = range(4)
_WINDOW, _SCREEN = 2, 5
"""Cells of the left half between belt and window's top, and between the pillar's edge and the middle."""
_PROUD_M: Final = 0.006
"""How far what is put on the surface stands out."""


@dataclass(frozen=True, eq=False)
class Hull:
    """A hull whose nose is at x = length / 2."""

    profile: Profile
    sections: Sections

    def mesh(self, paint: Skin, skirt: Skin | None = None) -> Mesh:
        """Return the surface; `skirt` is the skin of its lowest part."""
        half = self.sections.half_m
        ring = np.concatenate([half, half[:, -2::-1] * np.array([-1.0, 1])], axis=1)
        x = np.broadcast_to(self._x(self.sections.s_m)[:, None, None], (*ring.shape[:2], 1))
        return shell(np.concatenate([x, ring], axis=2), self._cells(skirt), [paint, GLASS, BLACK, skirt or paint])

    def side(self, s_m: tuple[float, float], z_m: tuple[float, float], skin: Skin, proud_m: float = _PROUD_M) -> Mesh:
        """Put a patch on both sides, from s to s and from height to height; it follows the surface."""
        return both(self.left(s_m, z_m, skin, proud_m))

    def left(self, s_m: tuple[float, float], z_m: tuple[float, float], skin: Skin, proud_m: float = _PROUD_M) -> Mesh:
        """Put a patch on the left side only."""
        stations = self.sections.s_m
        s = np.array([s_m[1], *stations[(stations > s_m[0] + 1e-3) & (stations < s_m[1] - 1e-3)], s_m[0]])
        mid = self.profile.mid_m
        z = np.array([z_m[0], mid, z_m[1]] if z_m[0] + 0.02 < mid < z_m[1] - 0.02 else z_m)
        rows, num = len(z), len(s)
        points = np.array([(self._x(v), self._y(v, w) + proud_m, w) for v in s for w in z])
        i = (np.arange(num - 1)[:, None] * rows + np.arange(rows - 1)).ravel()
        tri = np.stack([i, i + 1, i + rows + 1, i, i + rows + 1, i + rows], axis=1).reshape(-1, 3)
        return skinned(points, tri, np.zeros(len(tri), int), [skin])

    def front(self, y_m: tuple[float, float], z_m: tuple[float, float], skin: Skin, proud_m: float = _PROUD_M) -> Mesh:
        """Put a patch on the flat of the nose, from y to y and from height to height."""
        x, (y0, y1), (z0, z1) = self.profile.length_m / 2 + proud_m, y_m, z_m
        return quad(np.array([(x, y0, z0), (x, y1, z0), (x, y1, z1), (x, y0, z1)]), skin)

    def rear(self, y_m: tuple[float, float], z_m: tuple[float, float], skin: Skin, proud_m: float = _PROUD_M) -> Mesh:
        """Put a patch on the flat of the tail."""
        x, (y0, y1), (z0, z1) = -self.profile.length_m / 2 - proud_m, y_m, z_m
        return quad(np.array([(x, y1, z0), (x, y0, z0), (x, y0, z1), (x, y1, z1)]), skin)

    def flat_half_m(self, at_nose: bool) -> float:
        """Half the width of the flat of nose or tail."""
        return float(self.sections.half_m[-1 if at_nose else 0, 2, 0])

    def _x(self, s_m: Array) -> Array:
        return self.profile.length_m / 2 - s_m

    def _y(self, s_m: float, z_m: float) -> float:
        """Half width of the sides at a place."""
        s, half = self.sections.s_m[::-1], self.sections.half_m[::-1]
        i = int(np.clip(np.searchsorted(s, s_m, side="right") - 1, 0, len(s) - 2))
        share = (s_m - s[i]) / (s[i + 1] - s[i])
        outline = half[i, :5] * (1 - share) + half[i + 1, :5] * share
        return float(np.interp(z_m, outline[:, 1], outline[:, 0]))

    def _cells(self, skirt: Skin | None) -> Array:
        p, s = self.profile, self.sections.s_m
        middle = (s[:-1] + s[1:]) / 2
        half = np.full((len(middle), 6), _PAINT)
        for pair in p.windows:
            half[_between(middle, pair), _WINDOW] = _GLASS
        for pair in (p.windscreen, p.rear_window):
            half[_between(middle, pair), _SCREEN] = _GLASS
        if skirt is not None:
            half[:, 0] = _SKIRT
        return np.concatenate([half, half[:, ::-1], np.full((len(middle), 1), _BLACK)], axis=1)


def make_hull(profile: Profile) -> Hull:
    """Cut the sections of a profile."""
    return Hull(profile, sections(profile))


def _between(s: Float64, pair: tuple[float, float]) -> Bool:
    inside: Bool = (s > pair[0]) & (s < pair[1])
    return inside
