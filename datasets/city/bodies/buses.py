"""City buses, coaches, delivery vans and minibuses."""

from itertools import pairwise

import numpy as np

from fbench.datasets.city.bodies.hull import Hull, Profile, make_hull, mirrors, plate
from fbench.datasets.city.bodies.palette import BLACK, BUSES, CHROME, DARK, GLASS, LINE, STEEL, VANS, linear, pick
from fbench.datasets.city.bodies.shell import body, mirror
from fbench.datasets.city.mesh import Body, Mesh, Skin, box

_SIGN, _WHITE = Skin("plastic", linear("f09a1e")), Skin("paint", linear("e4e4e0"))


def make_bus(draw: np.random.Generator) -> Body:
    """Draw a bus with doors on the right, typical of a 12 m low-floor bus and its 10.5 m sister: 2.55 m wide, which is
    the most that EU law allows.
    """
    length, height = float(draw.uniform(10.5, 12.0)), float(draw.uniform(2.9, 3.15))
    bounds = np.linspace(0.75, length - 0.35, int(draw.integers(5, 7)) + 1)
    hull = make_hull(Profile(
        length_m=length, width_m=2.55,
        top=((0, 1.0), (0.06, 1.12), (0.3, height - 0.42), (0.42, height - 0.12), (0.9, height), (length - 1.0, height),
             (length - 0.12, height - 0.08), (length, height - 0.25)),
        belt=((0, 0.95), (0.2, 1.15), (length, 1.15)),
        plan=((0, 0.86), (0.06, 0.92), (0.3, 0.985), (0.7, 1), (length - 0.3, 1), (length - 0.1, 0.98), (length, 0.93)),
        sill_m=0.3, mid_m=0.75, tumblehome=0.04, windscreen=(0.07, 0.31), rear_window=(0.0, 0.0),
        windows=tuple((a + 0.05, b - 0.05) for a, b in pairwise(bounds.tolist())), axles=(2.7, length - 3.3),
        wheel_radius_m=0.48, crown_m=0.07, rail_m=0.34, pillar_m=0.1,
    ))  # fmt: skip
    paint = Skin("paint", pick(draw, BUSES))
    striped = draw.random() < 0.5
    return body("bus", [[hull.mesh(paint, _WHITE if striped else None), *_bus_parts(hull)]])


def _bus_parts(hull: Hull) -> list[Mesh]:
    p, front, back = hull.profile, hull.flat_half_m(at_nose=True), hull.flat_half_m(at_nose=False)
    x, high, tail = p.length_m / 2 - 0.3, p.top[2][1], p.top[-1][1]
    parts = [
        hull.underbody(0.9, 1.0),
        *hull.wheels(1.24, 0.29, STEEL),
        box((-0.3, 0.0, p.top[4][1] + 0.1), (3.0, 1.7, 0.22), _WHITE),
        *hull.headlights((0.62, 0.82), 0.62, 0.14),
        hull.front((-0.55 * front, 0.55 * front), (0.66, 0.78), LINE),
        hull.front((-front, front), (0.32, 0.5), DARK),
        plate(p.length_m / 2 + 0.014, 0.44),
        box((x - 0.12, 0.0, high + 0.14), (0.3, 1.9, 0.26), LINE),
        box((x - 0.11, 0.0, high + 0.14), (0.3, 1.3, 0.13), _SIGN),
        mirrors(p.length_m / 2 + 0.02, front - 0.02, high - 0.35, (0.14, 0.24, 0.4), BLACK),
        hull.rear((-0.8 * back, 0.8 * back), (1.65, tail - 0.12), GLASS),
        *hull.tail_lamps((0.75, 1.25), 0.88, 0.06),
        hull.rear((-0.6 * back, 0.6 * back), (0.85, 1.3), DARK),
        *(hull.rear((-0.58 * back, 0.58 * back), (z, z + 0.03), LINE, 0.01) for z in (0.92, 1.02, 1.12, 1.22)),
        hull.rear((-back, back), (0.34, 0.55), DARK),
        plate(-p.length_m / 2 - 0.014, 0.68),
        hull.side((p.axles[0] + 0.7, p.axles[1] - 0.7), (0.36, 0.385), LINE, 0.004),
    ]
    for start, width in ((0.8, 1.15), (p.length_m / 2 - 0.7, 1.3)):  # doors on the right
        leaf, frame = width / 2 - 0.06, hull.left((start, start + width), (0.36, 2.5), LINE, 0.008)
        panes = [hull.left((s, s + leaf), (0.5, 2.42), GLASS, 0.014) for s in (start + 0.04, start + width / 2 + 0.02)]
        parts += [mirror(part) for part in (frame, *panes)]
    return parts


_TYRE_M = 0.225


def make_van(draw: np.random.Generator) -> Body:
    """Draw a van, two in three of them for goods. Sizes are typical of vans from 2.8 to 3.5 t."""
    minibus = bool(draw.random() < 0.33)
    length = float(draw.uniform(4.9, 5.4 if minibus else 6.0))
    width = float(draw.uniform(1.92, 2.02))
    height = float(draw.uniform(1.92, 2.1) if minibus else draw.uniform(1.95, 2.6))
    cowl, belt = 0.72, 0.58 * min(height, 2.2)
    roof = cowl + 0.62 * (height - belt)
    door = roof + 0.95
    windows = [(cowl + 0.42, door)]
    if minibus:
        windows += [(door + 0.1, (door + length) / 2 - 0.1), ((door + length) / 2, length - 0.28)]
    hull = make_hull(Profile(
        length_m=length, width_m=width,
        top=((0, 0.86), (0.07, 0.95), (0.35, 1.06), (cowl, belt + 0.09), (roof, height - 0.09),
             (roof + 0.5, height - 0.01), (length - 0.6, height), (length - 0.08, height - 0.05),
             (length, height - 0.13)),
        belt=((0, 0.8), (0.3, 0.93), (cowl, belt), (length, belt)),
        plan=((0, 0.8), (0.07, 0.89), (0.25, 0.96), (0.7, 1), (length - 0.3, 1), (length - 0.08, 0.985),
              (length, 0.95)),
        sill_m=0.2, mid_m=0.72, tumblehome=0.11, windscreen=(cowl + 0.03, roof - 0.03), rear_window=(0.0, 0.0),
        windows=tuple(windows), axles=(0.92, length - 1.0), wheel_radius_m=0.345, rail_m=0.16,
    ))  # fmt: skip
    paint = Skin("paint", pick(draw, VANS))
    rim = CHROME if draw.random() < 0.3 else STEEL
    return body("van", [[hull.mesh(paint), *_van_parts(hull, rim, minibus)]])


def _van_parts(hull: Hull, rim: Skin, minibus: bool) -> list[Mesh]:
    p, front, back = hull.profile, hull.flat_half_m(at_nose=True), hull.flat_half_m(at_nose=False)
    outer, low = p.width_m / 2 - 0.03, p.sill_m + 0.12
    nose, tail, belt, sill = p.top[0][1], p.top[-1][1], p.belt[2][1], p.belt[-1][1]
    begin, door = p.windows[0]
    end = p.windows[1][1] if minibus else door + 1.2
    inner, corner, pane = 0.05, 0.8 * back, (sill, min(tail - 0.12, sill + 0.6))
    return [
        hull.underbody(outer - _TYRE_M - 0.02, p.mid_m), *hull.wheels(outer, _TYRE_M, rim),
        *hull.headlights((nose - 0.22, nose - 0.05), 0.64, 0.3),
        hull.grille(0.58 * front, (nose - 0.2, nose - 0.05), 2, CHROME),
        hull.front((-front, front), (0.24, 0.46), DARK), hull.side((0.0, 0.4), (0.24, 0.46), DARK),
        plate(p.length_m / 2 + 0.014, 0.5),
        hull.rear((inner, corner), pane, GLASS), hull.rear((-corner, -inner), pane, GLASS),
        *hull.tail_lamps((0.72, 1.2), 0.86, 0.07), hull.rear((-0.012, 0.012), (0.5, tail - 0.05), BLACK, 0.004),
        hull.rear((-back, back), (0.27, 0.46), DARK, 0.05), hull.rear((-back, back), (0.46, 0.47), BLACK),
        plate(-p.length_m / 2 - 0.016, 0.78),
        *hull.door_lines((begin - 0.03, door + 0.04, end + 0.04), (low, belt - 0.01)),
        hull.side((1.4, end), (low - 0.014, low + 0.006), BLACK, 0.004),
        hull.side((1.35, p.length_m - 1.45), (p.mid_m - 0.09, p.mid_m - 0.01), DARK, 0.02),
        *hull.handles((door - 0.2, door + 0.12), belt - 0.14, BLACK),
        mirrors(p.length_m / 2 - begin - 0.05, p.width_m / 2 - 0.06, belt + 0.16, (0.14, 0.24, 0.3), BLACK),
    ]  # fmt: skip
