"""Cars: hatchbacks, sedans, estates and SUVs."""

from typing import Final

import numpy as np

from fbench.datasets.city.actor import Body
from fbench.datasets.city.bodies import trim
from fbench.datasets.city.bodies.car_profile import STYLES, car_profile
from fbench.datasets.city.bodies.finish import body
from fbench.datasets.city.bodies.hull import Hull, make_hull
from fbench.datasets.city.bodies.paints import BLACK, CARS, CHROME, DARK, STEEL, linear, pick
from fbench.datasets.city.bodies.wheels import axle
from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.shapes import Skin, box

_OFTEN: Final = {"hatchback": 0.34, "sedan": 0.22, "estate": 0.16, "suv": 0.28}
"""How often a style is drawn."""
_TYRE_M: Final = 0.215


def make_car(draw: np.random.Generator, style: str = "") -> Body:
    """Draw a car, of a style where it is named."""
    names = list(_OFTEN)
    name = style or names[int(np.searchsorted(np.cumsum(list(_OFTEN.values()))[:-1], draw.random(), side="right"))]
    hull = make_hull(car_profile(STYLES[name], draw))
    paint = Skin("paint", pick(draw, CARS))
    rim = CHROME if draw.random() < 0.6 else STEEL
    skirt = DARK if name == "suv" and draw.random() < 0.7 else None
    parts = [hull.mesh(paint, skirt), *_chassis(hull, rim), *_front(hull), *_rear(hull), *_sides(hull, paint)]
    if name in ("estate", "suv"):
        parts += _rails(hull)
    return body("car", [parts])


def _chassis(hull: Hull, rim: Skin) -> list[Mesh]:
    p = hull.profile
    outer = p.width_m / 2 - 0.025
    wheels = [wheel for s in p.axles for wheel in axle(p.length_m / 2 - s, outer, p.wheel_radius_m, _TYRE_M, rim)]
    return [trim.underbody(p, outer - _TYRE_M - 0.02, p.mid_m), *wheels]


def _front(hull: Hull) -> list[Mesh]:
    p = hull.profile
    top, half = p.top[0][1], hull.flat_half_m(at_nose=True)
    low = p.sill_m + 0.06
    return [
        *trim.headlights(hull, (top - 0.165, top - 0.055), 0.6, 0.34),
        trim.grille(hull, 0.54 * half, (top - 0.17, top - 0.06), 1, CHROME),
        hull.front((-0.8 * half, 0.8 * half), (low, low + 0.15), BLACK),
        hull.side((0.0, 0.16), (low, low + 0.12), BLACK),
        trim.plate(p.length_m / 2 + 0.012, low + 0.2),
    ]


def _rear(hull: Hull) -> list[Mesh]:
    p = hull.profile
    top, half = p.top[-1][1], hull.flat_half_m(at_nose=False)
    lamps = (top - 0.25, top - 0.08)
    return [
        *trim.tail_lamps(hull, lamps, 0.62, 0.2),
        hull.rear((-0.85 * half, 0.85 * half), (p.sill_m + 0.03, p.sill_m + 0.16), BLACK),
        hull.rear((-0.95 * half, 0.95 * half), (top - 0.31, top - 0.298), BLACK, 0.004),
        trim.plate(-p.length_m / 2 - 0.012, top - 0.2),
    ]


def _sides(hull: Hull, paint: Skin) -> list[Mesh]:
    p = hull.profile
    (front, pillar), (_, rear) = p.windows[0], p.windows[1]
    belt = p.belt[2][1]
    low, high = p.sill_m + 0.1, belt - 0.01
    x = p.length_m / 2 - front - 0.02
    side = trim.mirrors(x, p.width_m / 2 - 0.05, belt + 0.07, (0.13, 0.19, 0.13), paint)
    return [
        *trim.door_lines(hull, (front - 0.03, pillar + 0.03, rear + 0.02), (low, high)),
        hull.side((front - 0.03, rear + 0.03), (low - 0.012, low + 0.006), BLACK, 0.004),
        *trim.handles(hull, (pillar - 0.2, rear - 0.2), belt - 0.11, paint),
        side,
    ]


def _rails(hull: Hull) -> list[Mesh]:
    p = hull.profile
    start, end = p.windscreen[1] + 0.35, p.rear_window[0] - 0.25
    height = max(z for _, z in p.top)
    y = float(hull.sections.half_m[:, 4, 0][hull.sections.s_m < p.windscreen[1] + 0.6].min())
    skin = Skin("metal", linear("4a4d50"))
    x = p.length_m / 2 - (start + end) / 2
    return [box((x, sign * (y - 0.06), height - 0.005), (end - start, 0.04, 0.05), skin) for sign in (1, -1)]
