"""Parts of lorries: cab, frame, wheels, guards, lamps at the end."""

from typing import Final

import numpy as np

from fbench.datasets.city.bodies import trim
from fbench.datasets.city.bodies.hull import Hull, make_hull
from fbench.datasets.city.bodies.paints import BLACK, CHROME, DARK, LINE, STEEL
from fbench.datasets.city.bodies.profile import Profile
from fbench.datasets.city.bodies.shell import both, shifted
from fbench.datasets.city.bodies.wheels import axle
from fbench.datasets.city.mesh import Mesh, merged
from fbench.datasets.city.shapes import Skin, box, quad

WHEEL_M: Final = 0.5
TYRE_M: Final = 0.31
OUTER_M: Final = 1.22
"""Where the wheels' outer sides are; lorries are 2.5 to 2.55 m wide."""
CAB_M: Final = 2.1
FRAME_M: Final = (0.72, 0.98)
"""From height to height."""


def cab(front_m: float, height_m: float, paint: Skin) -> Mesh:
    """Return a cab over the engine, with its front axle's wheels; its nose is at x = `front_m`."""
    hull = make_hull(_cab_profile(height_m))
    p = hull.profile
    x = p.length_m / 2 - p.axles[0]
    mid = box((0, 0, 0.85), (1.9, 1.7, 0.7), BLACK)
    parts = [hull.mesh(paint), mid, *axle(x, OUTER_M, WHEEL_M, TYRE_M, STEEL), *_face(hull), *_cab_sides(hull)]
    return shifted(merged(parts), (front_m - p.length_m / 2, 0.0, 0.0))


def _cab_profile(height_m: float) -> Profile:
    return Profile(
        length_m=CAB_M, width_m=2.46,
        top=((0, 1.5), (0.05, 1.58), (0.34, height_m - 0.42), (0.5, height_m - 0.12), (1.0, height_m),
             (CAB_M, height_m)),
        belt=((0, 1.45), (0.3, 1.62), (CAB_M, 1.62)),
        plan=((0, 0.86), (0.05, 0.91), (0.3, 0.98), (0.6, 1), (CAB_M, 1)),
        sill_m=0.36, mid_m=0.95, tumblehome=0.06, windscreen=(0.05, 0.35), rear_window=(0.0, 0.0),
        windows=((0.45, 1.32),), axles=(1.3,), wheel_radius_m=WHEEL_M, crown_m=0.07, rail_m=max(0.12, height_m - 2.62),
        pillar_m=0.1,
    )  # fmt: skip


def _face(hull: Hull) -> list[Mesh]:
    p, half = hull.profile, hull.flat_half_m(at_nose=True)
    return [
        hull.front((-half, half), (0.4, 0.78), DARK), hull.side((0.0, 0.5), (0.4, 0.7), DARK),
        *trim.headlights(hull, (0.56, 0.76), 0.66, 0.1),
        trim.grille(hull, 0.75 * half, (0.85, 1.36), 3, CHROME),
        trim.plate(p.length_m / 2 + 0.014, 0.52),
    ]  # fmt: skip


def _cab_sides(hull: Hull) -> list[Mesh]:
    p = hull.profile
    return [
        *trim.door_lines(hull, (0.42, 1.4), (1.15, 2.3)),
        *trim.handles(hull, (1.15,), 1.45, BLACK),
        both(box((p.length_m / 2 - 0.55, 1.14, 0.55), (0.5, 0.12, 0.06), LINE)),
        trim.mirrors(p.length_m / 2 - 0.3, p.width_m / 2 - 0.02, 2.0, (0.14, 0.22, 0.55), BLACK),
    ]


def frame(start_m: float, end_m: float) -> Mesh:
    """Return the frame's beams from x to x."""
    center, length = (start_m + end_m) / 2, end_m - start_m
    low, high = FRAME_M
    return both(box((center, 0.42, (low + high) / 2), (length, 0.16, high - low), BLACK))


def bogie(x_m: tuple[float, ...]) -> list[Mesh]:
    """Return wheels, axles and mudguards at some x."""
    parts = []
    for x in x_m:
        parts += [*axle(x, OUTER_M, WHEEL_M, TYRE_M + 0.22, STEEL),
                  both(box((x, OUTER_M - 0.27, 2 * WHEEL_M + 0.06), (0.95, 0.52, 0.03), BLACK))]  # fmt: skip
    return parts


def guards(start_m: float, end_m: float) -> list[Mesh]:
    """Return a tank and the bars that keep others from under the sides, from x to x."""
    center, length = (start_m + end_m) / 2, end_m - start_m
    bars = [box((center, 1.19, z), (length, 0.04, 0.1), STEEL) for z in (0.5, 0.75)]
    tank = box((end_m - 0.45, 0.92, 0.66), (0.8, 0.5, 0.5), STEEL)
    return [both(merged([*bars, tank] if length > 1.5 else bars))]


def rear_end(x_m: float) -> list[Mesh]:
    """Return the bar that keeps others from under the rear, with lamps and plate; all within x_m and the frame."""
    bar = box((x_m + 0.1, 0.0, 0.56), (0.1, 2.3, 0.14), DARK)
    beam = box((x_m + 0.08, 0.0, 0.82), (0.1, 2.36, 0.22), BLACK)
    lamps = [_facing_back(x_m + 0.025, rows, (0.73, 0.93), skin)
             for rows, skin in (((0.72, 0.95), trim.TAILLIGHT), ((0.96, 1.15), trim.BRAKELIGHT))]  # fmt: skip
    return [bar, beam, *lamps, trim.plate(x_m + 0.02, 0.82)]


def _facing_back(x: float, y: tuple[float, float], z: tuple[float, float], skin: Skin) -> Mesh:
    corners = [(x, y[1], z[0]), (x, y[0], z[0]), (x, y[0], z[1]), (x, y[1], z[1])]
    return both(quad(np.array(corners), skin))
