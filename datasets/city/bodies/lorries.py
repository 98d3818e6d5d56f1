"""Lorries: box bodies, flatbeds, tankers, and semi-trailers as one rigid body with their tractor."""

from typing import Final

import numpy as np

from fbench.datasets.city.bodies.hull import BRAKELIGHT, TAILLIGHT, Profile, axle, make_hull, mirrors, plate
from fbench.datasets.city.bodies.palette import BLACK, CHROME, DARK, LARGE, LINE, STEEL, linear, pick
from fbench.datasets.city.bodies.shell import body, both, shell
from fbench.datasets.city.mesh import Body, Mesh, Skin, box, cylinder, merge_meshes, quad, shift
from fbench.replay.data.arrays import Float64

WHEEL_M, TYRE_M, CAB_M = 0.5, 0.31, 2.1
OUTER_M: Final = 1.22  # Where the wheels' outer sides are; lorries are 2.5 to 2.55 m wide
FRAME_M: Final = (0.72, 0.98)  # From height to height
KINDS: Final = {"box": 0.4, "semi": 0.25, "flatbed": 0.2, "tanker": 0.15}
"""Kinds of lorries and how often they are drawn."""
_FLOOR_M: Final = 1.1
_GAP_M: Final = 0.35  # Between cab and load
_WOOD: Final = Skin("cloth", linear("8a6f4d"))


def cab(front_m: float, height_m: float, paint: Skin) -> Mesh:
    """Return a cab over the engine, with its front axle's wheels; its nose is at x = `front_m`."""
    hull = make_hull(Profile(
        length_m=CAB_M, width_m=2.46,
        top=((0, 1.5), (0.05, 1.58), (0.34, height_m - 0.42), (0.5, height_m - 0.12), (1.0, height_m),
             (CAB_M, height_m)),
        belt=((0, 1.45), (0.3, 1.62), (CAB_M, 1.62)),
        plan=((0, 0.86), (0.05, 0.91), (0.3, 0.98), (0.6, 1), (CAB_M, 1)),
        sill_m=0.36, mid_m=0.95, tumblehome=0.06, windscreen=(0.05, 0.35), rear_window=(0.0, 0.0),
        windows=((0.45, 1.32),), axles=(1.3,), wheel_radius_m=WHEEL_M, crown_m=0.07, rail_m=max(0.12, height_m - 2.62),
        pillar_m=0.1,
    ))  # fmt: skip
    p, half = hull.profile, hull.flat_half_m(at_nose=True)
    parts = [
        hull.mesh(paint), box((0, 0, 0.85), (1.9, 1.7, 0.7), BLACK), *hull.wheels(OUTER_M, TYRE_M, STEEL),
        hull.front((-half, half), (0.4, 0.78), DARK), hull.side((0.0, 0.5), (0.4, 0.7), DARK),
        *hull.headlights((0.56, 0.76), 0.66, 0.1), hull.grille(0.75 * half, (0.85, 1.36), 3, CHROME),
        plate(p.length_m / 2 + 0.014, 0.52),
        *hull.door_lines((0.42, 1.4), (1.15, 2.3)), *hull.handles((1.15,), 1.45, BLACK),
        both(box((p.length_m / 2 - 0.55, 1.14, 0.55), (0.5, 0.12, 0.06), LINE)),
        mirrors(p.length_m / 2 - 0.3, p.width_m / 2 - 0.02, 2.0, (0.14, 0.22, 0.55), BLACK),
    ]  # fmt: skip
    return shift(merge_meshes(parts), (front_m - p.length_m / 2, 0.0, 0.0))


def make_truck(draw: np.random.Generator, kind: str = "") -> Body:
    """Draw a lorry, of a kind of `KINDS` where it is named; as long as 6 to 9 m, semi-trailers 13 to 16 m."""
    at = int(np.searchsorted(np.cumsum(list(KINDS.values()))[:-1], draw.random(), side="right"))
    name = kind or list(KINDS)[at]
    length = float(draw.uniform(13.0, 16.0) if name == "semi" else draw.uniform(6.2, 9.0))
    height = float(draw.uniform(3.4, 3.9) if name in ("semi", "box") else draw.uniform(2.9, 3.2))
    paint = Skin("paint", pick(draw, LARGE))
    cover = Skin("paint", linear("e6e6e2") if draw.random() < 0.5 else pick(draw, LARGE))
    load = (-length / 2, length / 2 - CAB_M - _GAP_M)
    parts = [cab(length / 2, min(height - 0.25, 3.3), paint), *_chassis(name, *load)]
    if name == "tanker":
        parts += _tank(*load, height)
    else:
        parts += _flatbed(*load) if name == "flatbed" else _box(*load, height, cover)
    return body("truck", [parts])


def _chassis(name: str, rear: float, front: float) -> list[Mesh]:
    """Frame, wheels with mudguards, and what keeps others from under the sides (bars and, where there is room, a tank)
    and from under the rear (a bar with lamps and plate, all behind `rear`).
    """
    axles: tuple[float, ...] = (rear + 1.5, rear + 2.8) if front - rear > 5.5 else (rear + 1.4,)
    guard, guard_end, drive = axles[-1] + 0.7, front - 0.05, tuple[float, ...]()
    if name == "semi":
        axles, drive = (rear + 1.5, rear + 2.8, rear + 4.1), (front - 1.3,)
        guard, guard_end = axles[-1] + 0.8, drive[0] - 0.9
    start, end, (low, high) = rear + 0.1, front + 1.5, FRAME_M
    parts = [both(box(((start + end) / 2, 0.42, (low + high) / 2), (end - start, 0.16, high - low), BLACK))]
    for x in (*axles, *drive):
        parts += [*axle(x, OUTER_M, WHEEL_M, TYRE_M + 0.22, STEEL),
                  both(box((x, OUTER_M - 0.27, 2 * WHEEL_M + 0.06), (0.95, 0.52, 0.03), BLACK))]  # fmt: skip
    sides = [box(((guard + guard_end) / 2, 1.19, z), (guard_end - guard, 0.04, 0.1), STEEL) for z in (0.5, 0.75)]
    if guard_end - guard > 1.5:
        sides.append(box((guard_end - 0.45, 0.92, 0.66), (0.8, 0.5, 0.5), STEEL))
    parts += [both(merge_meshes(sides)), box((rear + 0.1, 0.0, 0.56), (0.1, 2.3, 0.14), DARK),
              box((rear + 0.08, 0.0, 0.82), (0.1, 2.36, 0.22), BLACK)]  # fmt: skip
    for y0, y1, skin in ((0.72, 0.95, TAILLIGHT), (0.96, 1.15, BRAKELIGHT)):
        corners = [(rear + 0.025, y, z) for y, z in ((y1, 0.73), (y0, 0.73), (y0, 0.93), (y1, 0.93))]
        parts.append(both(quad(np.array(corners), skin)))
    return [*parts, plate(rear + 0.02, 0.82)]


def _box(rear: float, front: float, height: float, cover: Skin) -> list[Mesh]:
    center, length, middle = (rear + front) / 2, front - rear, (_FLOOR_M + height) / 2
    ribs = [box((x, 1.275, middle), (0.05, 0.02, height - _FLOOR_M - 0.1), STEEL)
            for x in np.linspace(rear + 0.03, front - 0.03, 2 + int(length / 2.4)).tolist()]  # fmt: skip
    bars = [box((center, 1.275, z), (length, 0.024, 0.1), STEEL) for z in (_FLOOR_M + 0.05, height - 0.05)]
    doors = [box((rear - 0.006, y, middle), (0.012, 0.02, height - _FLOOR_M - 0.1), LINE) for y in (-0.45, 0.0, 0.45)]
    return [box((center, 0.0, middle), (length, 2.54, height - _FLOOR_M), cover), *map(both, [*ribs, *bars]), *doors]


def _flatbed(rear: float, front: float) -> list[Mesh]:
    """A deck with low sides, a headboard, and crates on it."""
    center, length = (rear + front) / 2, front - rear
    sides = [box((center, sign * 1.24, _FLOOR_M + 0.32), (length, 0.05, 0.4), STEEL) for sign in (1, -1)]
    posts = [box((x, 1.27, _FLOOR_M + 0.32), (0.06, 0.02, 0.4), BLACK) for x in np.linspace(rear + 0.1, front - 0.1, 5)]
    crates = [box((rear + share * length, 0.0, _FLOOR_M + 0.12 + tall / 2), (0.22 * length, 2.1, tall), _WOOD)
              for share, tall in ((0.18, 0.7), (0.45, 1.05), (0.75, 0.85))]  # fmt: skip
    return [
        box((center, 0.0, _FLOOR_M + 0.06), (length, 2.5, 0.12), BLACK), *sides, *map(both, posts), *crates,
        box((rear + 0.03, 0.0, _FLOOR_M + 0.32), (0.05, 2.48, 0.4), STEEL),
        box((front - 0.04, 0.0, _FLOOR_M + 0.75), (0.08, 2.45, 1.3), STEEL),
    ]  # fmt: skip


def _tank(rear: float, front: float, height: float) -> list[Mesh]:
    middle, tall = (_FLOOR_M + 0.05 + height) / 2, (height - _FLOOR_M - 0.05) / 2
    ends = [(rear + 0.1, 0.7), (rear + 0.25, 0.96), (rear + 0.5, 1.0), (front - 0.45, 1.0), (front - 0.2, 0.96),
            (front - 0.05, 0.7)]  # fmt: skip
    rings = [_oval(x, 1.22 * share, middle, tall * share) for x, share in ends]
    bands = []
    for x in np.linspace(rear + 0.8, front - 0.8, 4):
        band = np.stack([_oval(x + dx, 1.24, middle, tall + 0.02) for dx in (-0.04, 0.04)])
        bands.append(shell(band, np.zeros((1, 16), int), [STEEL]))
    hatches = [cylinder((x, 0, height - 0.05), (x, 0, height + 0.08), 0.25, 8, STEEL)
               for x in np.linspace(rear + 1.2, front - 1.2, 3)]  # fmt: skip
    skirt = box(((rear + front) / 2, 0.0, _FLOOR_M + 0.05), (front - rear - 0.4, 2.2, 0.14), BLACK)
    tank = shell(np.stack(rings), np.zeros((5, 16), int), [Skin("metal", linear("c4c8cb"))])
    return [tank, *bands, *hatches, skirt]


def _oval(x: float, wide: float, middle: float, tall: float) -> Float64:
    angle = np.arange(16) * (np.pi / 8) + np.pi / 16
    return np.column_stack([np.full(16, x), wide * np.cos(angle), middle + tall * np.sin(angle)])
