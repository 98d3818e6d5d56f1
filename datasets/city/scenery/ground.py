"""The ground: patches of road, sidewalk and marking, their kerbs, and grass to the horizon."""

from collections.abc import Sequence

import numpy as np

from fbench.datasets.city.materials import INDEX
from fbench.datasets.city.mesh import Mesh, merged
from fbench.datasets.city.scenery.quads import Quads, joined, quads_mesh, shaded
from fbench.datasets.city.scenery.triangulation import is_convex, surface
from fbench.datasets.city.shapes import Rgb, Skin, mesh, quad
from fbench.datasets.city.world.layout import GROUND_Z_M, Patch
from fbench.replay.arrays import Array, Float64

GROUND_SIDE_M = 4000.0
COLORS: dict[str, Rgb] = {
    "asphalt": (0.085, 0.085, 0.09),
    "marking": (0.72, 0.72, 0.7),
    "sidewalk": (0.3, 0.29, 0.275),
    "grass": (0.07, 0.125, 0.035),
    "soil": (0.14, 0.1, 0.065),
    "concrete": (0.33, 0.32, 0.3),
}
"""Albedo, linear: asphalt and grass as published for dry road surfaces and lawns, the rest by eye."""
_OTHER: Rgb = (0.3, 0.3, 0.3)
_KERB: Rgb = (0.4, 0.39, 0.37)


def ground(patches: Sequence[Patch]) -> Mesh:
    """Return all patches, seen from above, with the sides of kerbs, and the ground plane around their middle."""
    is_quad = np.array([len(patch.points_m) == 4 and bool(is_convex(patch.points_m)) for patch in patches], bool)
    quads = [patch for patch, simple in zip(patches, is_quad, strict=True) if simple]
    others = [(patch, *surface(patch.points_m)) for patch, simple in zip(patches, is_quad, strict=True) if not simple]
    parts = [_plane(patches), quads_mesh(joined([_flat_quad(patch) for patch in quads]))]
    parts += [_flat(patch, outline, triangles) for patch, outline, triangles in others]
    kerbs = [_kerb(patch.z_m, patch.points_m) for patch in quads if patch.has_kerb]
    kerbs += [_kerb(patch.z_m, outline) for patch, outline, _ in others if patch.has_kerb]
    return merged([*parts, quads_mesh(joined(kerbs))])


def _flat_quad(patch: Patch) -> Quads:
    skin = _skin(patch)
    corners = np.column_stack([patch.points_m, np.full(4, patch.z_m)])[None]
    return Quads(corners, np.array([INDEX[skin.material]], np.uint8), np.array([skin.color], np.float32))


def _flat(patch: Patch, outline: Float64, triangles: Array) -> Mesh:
    return mesh(np.column_stack([outline, np.full(len(outline), patch.z_m)]), triangles, _skin(patch))


def _skin(patch: Patch) -> Skin:
    return Skin(patch.material, shaded(COLORS.get(patch.material, _OTHER), patch.shade))


def _kerb(z_m: float, outline: Float64) -> Quads:
    """Walls from 0 up to a patch along its whole outline."""
    nearest = np.roll(outline, -1, axis=0)
    num = len(outline)
    low, high = np.zeros(num), np.full(num, z_m)
    corners = [np.column_stack([p, z]) for p, z in ((outline, low), (nearest, low), (nearest, high), (outline, high))]
    return Quads(np.stack(corners, axis=1), np.full(num, INDEX["concrete"], np.uint8),
                 np.tile(np.asarray(_KERB, np.float32), (num, 1)))  # fmt: skip


def _plane(patches: Sequence[Patch]) -> Mesh:
    points = np.concatenate([np.zeros((0, 2)), *(patch.points_m for patch in patches)])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2 if len(points) else np.zeros(2)
    half = GROUND_SIDE_M / 2
    corners = np.array([(-half, -half), (half, -half), (half, half), (-half, half)]) + middle
    return quad(np.column_stack([corners, np.full(4, GROUND_Z_M)]), Skin("grass", COLORS["grass"]))
