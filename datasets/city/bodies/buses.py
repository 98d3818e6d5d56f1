"""City buses and coaches."""

from itertools import pairwise

import numpy as np

from fbench.datasets.city.actor import Body
from fbench.datasets.city.bodies import trim
from fbench.datasets.city.bodies.finish import body
from fbench.datasets.city.bodies.hull import Hull, make_hull
from fbench.datasets.city.bodies.paints import BLACK, BUSES, DARK, GLASS, LINE, STEEL, linear, pick
from fbench.datasets.city.bodies.profile import Profile
from fbench.datasets.city.bodies.shell import mirrored
from fbench.datasets.city.bodies.wheels import axle
from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.shapes import Skin, box

_SIGN = Skin("plastic", linear("f09a1e"))
_WHITE = Skin("paint", linear("e4e4e0"))


def make_bus(draw: np.random.Generator) -> Body:
    """Draw a bus with doors on the right."""
    hull = make_hull(_profile(draw))
    color = pick(draw, BUSES)
    striped = draw.random() < 0.5
    paint = Skin("paint", color)
    parts = [hull.mesh(paint, _WHITE if striped else None), *_chassis(hull), *_front(hull), *_rear(hull), *_sides(hull)]
    return body("bus", [parts])


def _profile(draw: np.random.Generator) -> Profile:
    """Typical of a 12 m low-floor bus and its 10.5 m sister: 2.55 m wide, which is the most that EU law allows."""
    length, height = float(draw.uniform(10.5, 12.0)), float(draw.uniform(2.9, 3.15))
    num = int(draw.integers(5, 7))
    bounds = np.linspace(0.75, length - 0.35, num + 1)
    windows = tuple((a + 0.05, b - 0.05) for a, b in pairwise(bounds.tolist()))
    return Profile(
        length_m=length, width_m=2.55,
        top=((0, 1.0), (0.06, 1.12), (0.3, height - 0.42), (0.42, height - 0.12), (0.9, height), (length - 1.0, height),
             (length - 0.12, height - 0.08), (length, height - 0.25)),
        belt=((0, 0.95), (0.2, 1.15), (length, 1.15)),
        plan=((0, 0.86), (0.06, 0.92), (0.3, 0.985), (0.7, 1), (length - 0.3, 1), (length - 0.1, 0.98), (length, 0.93)),
        sill_m=0.3, mid_m=0.75, tumblehome=0.04, windscreen=(0.07, 0.31), rear_window=(0.0, 0.0), windows=windows,
        axles=(2.7, length - 3.3), wheel_radius_m=0.48, crown_m=0.07, rail_m=0.34, pillar_m=0.1,
    )  # fmt: skip


def _chassis(hull: Hull) -> list[Mesh]:
    p = hull.profile
    wheels = [part for s in p.axles for part in axle(p.length_m / 2 - s, 1.24, p.wheel_radius_m, 0.29, STEEL)]
    return [trim.underbody(p, 0.9, 1.0), *wheels, box((-0.3, 0.0, p.top[4][1] + 0.1), (3.0, 1.7, 0.22), _WHITE)]


def _front(hull: Hull) -> list[Mesh]:
    p, half = hull.profile, hull.flat_half_m(at_nose=True)
    x, top = p.length_m / 2 - 0.3, p.top[2][1]
    return [
        *trim.headlights(hull, (0.62, 0.82), 0.62, 0.14),
        hull.front((-0.55 * half, 0.55 * half), (0.66, 0.78), LINE),
        hull.front((-half, half), (0.32, 0.5), DARK),
        trim.plate(p.length_m / 2 + 0.014, 0.44),
        box((x - 0.12, 0.0, top + 0.14), (0.3, 1.9, 0.26), LINE),
        box((x - 0.11, 0.0, top + 0.14), (0.3, 1.3, 0.13), _SIGN),
        trim.mirrors(p.length_m / 2 + 0.02, half - 0.02, top - 0.35, (0.14, 0.24, 0.4), BLACK),
    ]


def _rear(hull: Hull) -> list[Mesh]:
    p, half = hull.profile, hull.flat_half_m(at_nose=False)
    top = p.top[-1][1]
    return [
        hull.rear((-0.8 * half, 0.8 * half), (1.65, top - 0.12), GLASS),
        *trim.tail_lamps(hull, (0.75, 1.25), 0.88, 0.06),
        hull.rear((-0.6 * half, 0.6 * half), (0.85, 1.3), DARK),
        *(hull.rear((-0.58 * half, 0.58 * half), (z, z + 0.03), LINE, 0.01) for z in (0.92, 1.02, 1.12, 1.22)),
        hull.rear((-half, half), (0.34, 0.55), DARK),
        trim.plate(-p.length_m / 2 - 0.014, 0.68),
    ]


def _sides(hull: Hull) -> list[Mesh]:
    """Doors on the right; lines along the sides."""
    p = hull.profile
    parts = [hull.side((p.axles[0] + 0.7, p.axles[1] - 0.7), (0.36, 0.385), LINE, 0.004)]
    for start, width in ((0.8, 1.15), (p.length_m / 2 - 0.7, 1.3)):
        frame = hull.left((start, start + width), (0.36, 2.5), LINE, 0.008)
        leaf = width / 2 - 0.06
        panes = [hull.left((s, s + leaf), (0.5, 2.42), GLASS, 0.014) for s in (start + 0.04, start + width / 2 + 0.02)]
        parts += [mirrored(part) for part in (frame, *panes)]
    return parts
