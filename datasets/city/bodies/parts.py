"""Parts of vehicles: lamps, plates, mirrors, handles, wheels."""

from typing import Final

import numpy as np

from fbench.datasets.city.bodies.hull import Hull, Profile
from fbench.datasets.city.bodies.shell import BLACK, GLASS, LINE, PLATE, TYRE, both, linear, mirrored, shell, shifted
from fbench.datasets.city.mesh import Mesh, Skin, Three, box, merged
from fbench.datasets.city.motion import BRAKE, HEAD, TAIL

HEADLIGHT = Skin("headlight", linear("eef0ea"), HEAD)
TAILLIGHT = Skin("taillight", linear("9c1116"), TAIL)
BRAKELIGHT = Skin("taillight", linear("b8161b"), BRAKE)
TURN = Skin("plastic", linear("c8641a"))
_PLATE_M = (0.52, 0.11)
"""Width and height of a European licence plate (520 mm x 110 mm)."""


def headlights(hull: Hull, z_m: tuple[float, float], inner: float, back_m: float) -> list[Mesh]:
    """Put headlights on the nose's outer part, from `inner` of its half width, and around its corners."""
    half = hull.flat_half_m(at_nose=True)
    frame = hull.front((inner * half - 0.02, half), (z_m[0] - 0.02, z_m[1] + 0.015), LINE, 0.009)
    front = hull.front((inner * half, 0.99 * half), z_m, HEADLIGHT, 0.013)
    return [both(frame), both(front), hull.side((0.0, back_m), (z_m[0] + 0.02, z_m[1]), HEADLIGHT, 0.013)]


def tail_lamps(hull: Hull, z_m: tuple[float, float], inner: float, round_m: float) -> list[Mesh]:
    """Put tail lights and, in their upper part, brake lights on the tail's outer part and around its corners."""
    half, length = hull.flat_half_m(at_nose=False), hull.profile.length_m
    z = 0.45 * z_m[0] + 0.55 * z_m[1]
    parts = [both(hull.rear((inner * half, 0.99 * half), rows, skin))
             for rows, skin in (((z_m[0], z), TAILLIGHT), ((z, z_m[1]), BRAKELIGHT))]  # fmt: skip
    return [*parts, hull.side((length - round_m, length), z_m, TAILLIGHT)] if round_m else parts


def plate(x_m: float, z_m: float) -> Mesh:
    """Return a licence plate at `x_m`, which looks forward where that is positive."""
    return box((x_m, 0.0, z_m), (0.012, *_PLATE_M), PLATE)


def mirrors(x_m: float, y_m: float, z_m: float, size_lwh_m: Three, skin: Skin) -> Mesh:
    """Return mirrors on both sides, whose inner ends are at `y_m`; their glass looks back."""
    length, width, height = size_lwh_m
    ring = np.array([(-1.0, -1.0), (1, -1), (1, 1), (-1, 1)]) / 2
    rings = [np.column_stack([np.full(4, x), scale * ring * (width, height)])
             for x, scale in ((-0.5, 1.0), (0.1, 1.0), (0.5, 0.7))]  # fmt: skip
    rings_m = np.stack(rings) * np.array([length, 1, 1])
    cells = np.zeros((2, 4), int)
    left = shell(rings_m, cells, [skin, GLASS], (1, 0))
    return both(shifted(left, (x_m, y_m + width / 2, z_m)))


def door_lines(hull: Hull, at_m: tuple[float, ...], z_m: tuple[float, float]) -> list[Mesh]:
    """Draw the gaps between doors and wings: thin dark lines from height to height."""
    return [hull.side((s, s + 0.018), z_m, LINE, 0.004) for s in at_m]


def handles(hull: Hull, at_m: tuple[float, ...], z_m: float, skin: Skin) -> list[Mesh]:
    """Put handles on the doors."""
    return [hull.side((s, s + 0.19), (z_m, z_m + 0.035), skin, 0.022) for s in at_m]


def underbody(profile: Profile, inner_m: float, top_m: float) -> Mesh:
    """Fill the hull between the wheels, so that nobody sees through its arches."""
    length = profile.length_m - 0.3
    return box((0.0, 0.0, (profile.sill_m + top_m) / 2 + 0.01), (length, 2 * inner_m, top_m - profile.sill_m), BLACK)


def grille(hull: Hull, half_m: float, z_m: tuple[float, float], bars: int, skin: Skin) -> Mesh:
    """Put a dark grille with bars on the nose."""
    parts = [hull.front((-half_m, half_m), z_m, LINE)]
    step = (z_m[1] - z_m[0]) / (bars + 1)
    for i in range(bars):
        z = z_m[0] + (i + 1) * step
        parts.append(hull.front((-half_m, half_m), (z - 0.008, z + 0.008), skin, 0.01))
    return merged(parts)


_SIDES: Final = 15
_RIM_SHARE: Final = 0.66
"""Of the wheel's radius."""
_GAP: Final = 3
"""Every so manyth sector of the rim is a gap between spokes."""


def wheel(radius_m: float, width_m: float, rim: Skin) -> Mesh:
    """Return a wheel that stands on the ground under the origin, its outer side towards +y."""
    angle = np.arange(_SIDES) * (2 * np.pi / _SIDES) - np.pi / 2
    half = width_m / 2
    rows = [(1.0, -half), (1.0, 0.8 * half), (_RIM_SHARE, half)]
    rings = np.stack([
        np.column_stack([-share * radius_m * np.cos(angle), np.full(_SIDES, y), share * radius_m * np.sin(angle)])
        for share, y in rows
    ])  # fmt: skip
    cells = np.zeros((len(rows) - 1, _SIDES), int)
    sectors = np.where(np.arange(_SIDES) % _GAP == 0, 2, 1)
    return shifted(shell(rings, cells, [TYRE, rim, LINE, BLACK], (3, sectors)), (0.0, 0.0, radius_m))


def axle(x_m: float, outer_m: float, radius_m: float, width_m: float, rim: Skin) -> list[Mesh]:
    """Return the two wheels at `x_m` whose outer sides are `outer_m` from the middle."""
    left = shifted(wheel(radius_m, width_m, rim), (x_m, outer_m - width_m / 2, 0.0))
    return [left, mirrored(left)]
