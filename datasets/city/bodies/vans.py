"""Vans: delivery vans without windows in the back, and minibuses."""

import numpy as np

from fbench.datasets.city.actor import Body
from fbench.datasets.city.bodies import trim
from fbench.datasets.city.bodies.finish import body
from fbench.datasets.city.bodies.hull import Hull, make_hull
from fbench.datasets.city.bodies.paints import BLACK, CHROME, DARK, GLASS, STEEL, VANS, pick
from fbench.datasets.city.bodies.profile import Profile
from fbench.datasets.city.bodies.wheels import axle
from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.shapes import Skin

_TYRE_M = 0.225


def make_van(draw: np.random.Generator) -> Body:
    """Draw a van, two in three of them for goods."""
    minibus = bool(draw.random() < 0.33)
    hull = make_hull(_profile(draw, minibus))
    paint = Skin("paint", pick(draw, VANS))
    rim = CHROME if draw.random() < 0.3 else STEEL
    return body("van", [[hull.mesh(paint), *_chassis(hull, rim), *_front(hull), *_rear(hull), *_sides(hull, minibus)]])


def _profile(draw: np.random.Generator, minibus: bool) -> Profile:
    """Sizes are typical of vans from 2.8 to 3.5 t."""
    length = float(draw.uniform(4.9, 5.4 if minibus else 6.0))
    width = float(draw.uniform(1.92, 2.02))
    height = float(draw.uniform(1.92, 2.1) if minibus else draw.uniform(1.95, 2.6))
    cowl, belt = 0.72, 0.58 * min(height, 2.2)
    roof = cowl + 0.62 * (height - belt)
    door = roof + 0.95
    windows = [(cowl + 0.42, door)]
    if minibus:
        windows += [(door + 0.1, (door + length) / 2 - 0.1), ((door + length) / 2, length - 0.28)]
    return Profile(
        length_m=length, width_m=width,
        top=((0, 0.86), (0.07, 0.95), (0.35, 1.06), (cowl, belt + 0.09), (roof, height - 0.09),
             (roof + 0.5, height - 0.01), (length - 0.6, height), (length - 0.08, height - 0.05),
             (length, height - 0.13)),
        belt=((0, 0.8), (0.3, 0.93), (cowl, belt), (length, belt)),
        plan=((0, 0.8), (0.07, 0.89), (0.25, 0.96), (0.7, 1), (length - 0.3, 1), (length - 0.08, 0.985),
              (length, 0.95)),
        sill_m=0.2, mid_m=0.72, tumblehome=0.11, windscreen=(cowl + 0.03, roof - 0.03), rear_window=(0.0, 0.0),
        windows=tuple(windows), axles=(0.92, length - 1.0), wheel_radius_m=0.345, rail_m=0.16,
    )  # fmt: skip


def _chassis(hull: Hull, rim: Skin) -> list[Mesh]:
    p = hull.profile
    outer = p.width_m / 2 - 0.03
    wheels = [part for s in p.axles for part in axle(p.length_m / 2 - s, outer, p.wheel_radius_m, _TYRE_M, rim)]
    return [trim.underbody(p, outer - _TYRE_M - 0.02, p.mid_m), *wheels]


def _front(hull: Hull) -> list[Mesh]:
    p, half = hull.profile, hull.flat_half_m(at_nose=True)
    top = p.top[0][1]
    return [
        *trim.headlights(hull, (top - 0.22, top - 0.05), 0.64, 0.3),
        trim.grille(hull, 0.58 * half, (top - 0.2, top - 0.05), 2, CHROME),
        hull.front((-half, half), (0.24, 0.46), DARK),
        hull.side((0.0, 0.4), (0.24, 0.46), DARK),
        trim.plate(p.length_m / 2 + 0.014, 0.5),
    ]


def _rear(hull: Hull) -> list[Mesh]:
    p, half = hull.profile, hull.flat_half_m(at_nose=False)
    belt, top = p.belt[-1][1], p.top[-1][1]
    pane = ((0.05, 0.8 * half), (belt, min(top - 0.12, belt + 0.6)))
    sides = [hull.rear((min(a, b), max(a, b)), pane[1], GLASS) for a, b in (pane[0], (-pane[0][1], -pane[0][0]))]
    return [
        *sides, *trim.tail_lamps(hull, (0.72, 1.2), 0.86, 0.07),
        hull.rear((-0.012, 0.012), (0.5, top - 0.05), BLACK, 0.004),
        hull.rear((-half, half), (0.27, 0.46), DARK, 0.05), hull.rear((-half, half), (0.46, 0.47), BLACK),
        trim.plate(-p.length_m / 2 - 0.016, 0.78),
    ]  # fmt: skip


def _sides(hull: Hull, minibus: bool) -> list[Mesh]:
    p = hull.profile
    front, door = p.windows[0]
    belt = p.belt[2][1]
    back = p.windows[1][1] if minibus else door + 1.2
    x = p.length_m / 2 - front - 0.05
    low = p.sill_m + 0.12
    return [
        *trim.door_lines(hull, (front - 0.03, door + 0.04, back + 0.04), (low, belt - 0.01)),
        hull.side((1.4, back), (low - 0.014, low + 0.006), BLACK, 0.004),
        hull.side((1.35, p.length_m - 1.45), (p.mid_m - 0.09, p.mid_m - 0.01), DARK, 0.02),
        *trim.handles(hull, (door - 0.2, door + 0.12), belt - 0.14, BLACK),
        trim.mirrors(x, p.width_m / 2 - 0.06, belt + 0.16, (0.14, 0.24, 0.3), BLACK),
    ]
