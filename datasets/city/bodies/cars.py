"""Cars: hatchbacks, sedans, estates and SUVs."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from fbench.datasets.city.bodies.hull import Hull, Profile, make_hull, mirrors, plate
from fbench.datasets.city.bodies.palette import BLACK, CARS, CHROME, DARK, STEEL, linear, pick
from fbench.datasets.city.bodies.shell import body
from fbench.datasets.city.mesh import Body, Mesh, Skin, box

Range = tuple[float, float]


@dataclass(frozen=True)
class Style:
    """Ranges of sizes [m] and the shape as shares of the length."""

    length_m: Range
    width_m: Range
    height_m: Range
    cowl: float  # Where the windscreen begins
    roof_from: float
    roof_to: float  # Where the rear window begins
    deck: float  # Where it ends
    boot: float  # Height of the boot lid, or of the rear window's lower edge, as a share of the height
    doors: tuple[float, ...]  # Where the side windows begin, are divided by pillars, and end
    axles: tuple[float, float]
    sill_m: float = 0.17
    wheel_m: float = 0.315


STYLES: Final = {
    "hatchback": Style((3.7, 4.3), (1.70, 1.80), (1.44, 1.53), 0.235, 0.42, 0.865, 0.98, 0.66,
                       (0.315, 0.525, 0.735, 0.83), (0.185, 0.815)),
    "sedan": Style((4.4, 4.9), (1.76, 1.86), (1.42, 1.48), 0.265, 0.42, 0.70, 0.855, 0.70,
                   (0.325, 0.505, 0.685, 0.775), (0.19, 0.79)),
    "estate": Style((4.4, 4.85), (1.76, 1.85), (1.45, 1.52), 0.255, 0.405, 0.925, 0.988, 0.65,
                    (0.315, 0.49, 0.675, 0.905), (0.19, 0.78)),
    "suv": Style((4.25, 4.75), (1.82, 1.90), (1.62, 1.74), 0.245, 0.39, 0.90, 0.985, 0.645,
                 (0.315, 0.50, 0.69, 0.87), (0.185, 0.80), 0.22, 0.355),
}  # fmt: skip
"""Sizes are typical of the European classes from supermini to large SUV."""


_OFTEN: Final = {"hatchback": 0.34, "sedan": 0.22, "estate": 0.16, "suv": 0.28}  # How often a style is drawn
_TYRE_M: Final = 0.215


def make_car(draw: np.random.Generator, style: str = "") -> Body:
    """Draw a car, of a style where it is named."""
    names = list(_OFTEN)
    name = style or names[int(np.searchsorted(np.cumsum(list(_OFTEN.values()))[:-1], draw.random(), side="right"))]
    of = STYLES[name]
    length, width, height = (float(draw.uniform(*sizes)) for sizes in (of.length_m, of.width_m, of.height_m))
    belt, bonnet = 0.62 * height, (0.505 if of.sill_m < 0.2 else 0.54) * height
    cowl, roof, rear, deck = (share * length for share in (of.cowl, of.roof_from, of.roof_to, of.deck))
    boot = of.boot * height
    hull = make_hull(Profile(
        length_m=length, width_m=width,
        top=((0, bonnet), (0.07, bonnet + 0.06), (0.32, bonnet + 0.13), (cowl, belt + 0.1), (roof, height - 0.035),
             (0.55 * roof + 0.45 * rear, height), (rear, height - 0.05), (deck, boot + 0.02), (length - 0.05, boot),
             (length, boot - 0.07)),
        belt=((0, bonnet - 0.05), (0.25, bonnet + 0.02), (cowl, belt), (length, belt + 0.05)),
        plan=((0, 0.77), (0.06, 0.87), (0.17, 0.94), (0.45, 0.99), (0.7, 1), (length - 0.6, 1), (length - 0.3, 0.975),
              (length - 0.08, 0.92), (length, 0.84)),
        sill_m=of.sill_m, mid_m=(0.36 if of.sill_m < 0.2 else 0.29) * height, tumblehome=0.36,
        windscreen=(cowl + 0.03, roof - 0.02), rear_window=(rear + 0.05, deck - 0.04),
        windows=tuple((a * length + 0.04, b * length - 0.04) for a, b in pairwise(of.doors)),
        axles=tuple(share * length for share in of.axles),
        wheel_radius_m=of.wheel_m * (0.97 + 0.06 * draw.random()),
    ))  # fmt: skip
    paint = Skin("paint", pick(draw, CARS))
    rim = CHROME if draw.random() < 0.6 else STEEL
    skirt = DARK if name == "suv" and draw.random() < 0.7 else None
    parts = [hull.mesh(paint, skirt), *_parts(hull, paint, rim)]
    return body("car", [[*parts, *_rails(hull)] if name in ("estate", "suv") else parts])


def _parts(hull: Hull, paint: Skin, rim: Skin) -> list[Mesh]:
    p, outer, x = hull.profile, hull.profile.width_m / 2 - 0.025, hull.profile.length_m / 2
    nose, front = p.top[0][1], hull.flat_half_m(at_nose=True)
    tail, back = p.top[-1][1], hull.flat_half_m(at_nose=False)
    low, sill, belt = p.sill_m + 0.06, p.sill_m + 0.1, p.belt[2][1]
    (begin, pillar), (_, end) = p.windows[0], p.windows[1]
    return [
        hull.underbody(outer - _TYRE_M - 0.02, p.mid_m),
        *hull.wheels(outer, _TYRE_M, rim),
        *hull.headlights((nose - 0.165, nose - 0.055), 0.6, 0.34),
        hull.grille(0.54 * front, (nose - 0.17, nose - 0.06), 1, CHROME),
        hull.front((-0.8 * front, 0.8 * front), (low, low + 0.15), BLACK),
        hull.side((0.0, 0.16), (low, low + 0.12), BLACK),
        plate(x + 0.012, low + 0.2),
        *hull.tail_lamps((tail - 0.25, tail - 0.08), 0.62, 0.2),
        hull.rear((-0.85 * back, 0.85 * back), (p.sill_m + 0.03, p.sill_m + 0.16), BLACK),
        hull.rear((-0.95 * back, 0.95 * back), (tail - 0.31, tail - 0.298), BLACK, 0.004),
        plate(-x - 0.012, tail - 0.2),
        *hull.door_lines((begin - 0.03, pillar + 0.03, end + 0.02), (sill, belt - 0.01)),
        hull.side((begin - 0.03, end + 0.03), (sill - 0.012, sill + 0.006), BLACK, 0.004),
        *hull.handles((pillar - 0.2, end - 0.2), belt - 0.11, paint),
        mirrors(x - begin - 0.02, p.width_m / 2 - 0.05, belt + 0.07, (0.13, 0.19, 0.13), paint),
    ]


def _rails(hull: Hull) -> list[Mesh]:
    p = hull.profile
    start, end = p.windscreen[1] + 0.35, p.rear_window[0] - 0.25
    height = max(z for _, z in p.top)
    y = float(hull.half_m[:, 4, 0][hull.s_m < p.windscreen[1] + 0.6].min())
    skin = Skin("metal", linear("4a4d50"))
    x = p.length_m / 2 - (start + end) / 2
    return [box((x, sign * (y - 0.06), height - 0.005), (end - start, 0.04, 0.05), skin) for sign in (1, -1)]
