"""Lorries: box bodies, flatbeds, tankers, and semi-trailers as one rigid body with their tractor."""

from typing import Final

import numpy as np

from fbench.datasets.city.bodies.hull import (
    BRAKELIGHT,
    TAILLIGHT,
    Hull,
    Profile,
    axle,
    door_lines,
    grille,
    handles,
    headlights,
    make_hull,
    mirrors,
    plate,
)
from fbench.datasets.city.bodies.shell import (
    BLACK,
    CHROME,
    DARK,
    LARGE,
    LINE,
    STEEL,
    body,
    both,
    linear,
    pick,
    shell,
    shift,
)
from fbench.datasets.city.mesh import Body, Mesh, Skin, box, cylinder, merge_meshes, quad

WHEEL_M: Final = 0.5
TYRE_M: Final = 0.31
OUTER_M: Final = 1.22  # Where the wheels' outer sides are; lorries are 2.5 to 2.55 m wide
CAB_M: Final = 2.1
FRAME_M: Final = (0.72, 0.98)  # From height to height


def cab(front_m: float, height_m: float, paint: Skin) -> Mesh:
    """Return a cab over the engine, with its front axle's wheels; its nose is at x = `front_m`."""
    hull = make_hull(_cab_profile(height_m))
    p = hull.profile
    x = p.length_m / 2 - p.axles[0]
    mid = box((0, 0, 0.85), (1.9, 1.7, 0.7), BLACK)
    parts = [hull.mesh(paint), mid, *axle(x, OUTER_M, WHEEL_M, TYRE_M, STEEL), *_face(hull), *_cab_sides(hull)]
    return shift(merge_meshes(parts), (front_m - p.length_m / 2, 0.0, 0.0))


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
        *headlights(hull, (0.56, 0.76), 0.66, 0.1),
        grille(hull, 0.75 * half, (0.85, 1.36), 3, CHROME),
        plate(p.length_m / 2 + 0.014, 0.52),
    ]  # fmt: skip


def _cab_sides(hull: Hull) -> list[Mesh]:
    p = hull.profile
    return [
        *door_lines(hull, (0.42, 1.4), (1.15, 2.3)),
        *handles(hull, (1.15,), 1.45, BLACK),
        both(box((p.length_m / 2 - 0.55, 1.14, 0.55), (0.5, 0.12, 0.06), LINE)),
        mirrors(p.length_m / 2 - 0.3, p.width_m / 2 - 0.02, 2.0, (0.14, 0.22, 0.55), BLACK),
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
    return [both(merge_meshes([*bars, tank] if length > 1.5 else bars))]


def rear_end(x_m: float) -> list[Mesh]:
    """Return the bar that keeps others from under the rear, with lamps and plate; all within x_m and the frame."""
    bar = box((x_m + 0.1, 0.0, 0.56), (0.1, 2.3, 0.14), DARK)
    beam = box((x_m + 0.08, 0.0, 0.82), (0.1, 2.36, 0.22), BLACK)
    lamps = [_facing_back(x_m + 0.025, rows, (0.73, 0.93), skin)
             for rows, skin in (((0.72, 0.95), TAILLIGHT), ((0.96, 1.15), BRAKELIGHT))]  # fmt: skip
    return [bar, beam, *lamps, plate(x_m + 0.02, 0.82)]


def _facing_back(x: float, y: tuple[float, float], z: tuple[float, float], skin: Skin) -> Mesh:
    corners = [(x, y[1], z[0]), (x, y[0], z[0]), (x, y[0], z[1]), (x, y[1], z[1])]
    return both(quad(np.array(corners), skin))


KINDS: Final = {"box": 0.4, "semi": 0.25, "flatbed": 0.2, "tanker": 0.15}
"""Kinds of lorries and how often they are drawn."""
_FLOOR_M: Final = 1.1
_GAP_M: Final = 0.35  # Between cab and load
_WOOD: Final = Skin("cloth", linear("8a6f4d"))


def make_truck(draw: np.random.Generator, kind: str = "") -> Body:
    """Draw a lorry, of a kind of `KINDS` where it is named; as long as 6 to 9 m, semi-trailers 13 to 16 m."""
    at = int(np.searchsorted(np.cumsum(list(KINDS.values()))[:-1], draw.random(), side="right"))
    name = kind or list(KINDS)[at]
    length = float(draw.uniform(13.0, 16.0) if name == "semi" else draw.uniform(6.2, 9.0))
    height = float(draw.uniform(3.4, 3.9) if name in ("semi", "box") else draw.uniform(2.9, 3.2))
    paint = Skin("paint", pick(draw, LARGE))
    white = bool(draw.random() < 0.5)
    cover = Skin("paint", linear("e6e6e2")) if white else Skin("paint", pick(draw, LARGE))
    half = length / 2
    load = (-half, half - CAB_M - _GAP_M)
    parts = [cab(half, min(height - 0.25, 3.3), paint), *_chassis(name, load)]
    return body("truck", [[*parts, *_load(name, load, height, cover)]])


def _chassis(name: str, load: tuple[float, float]) -> list[Mesh]:
    rear, front = load
    if name == "semi":
        axles: tuple[float, ...] = (rear + 1.5, rear + 2.8, rear + 4.1)
        drive = front - 1.3
        return [frame(rear + 0.1, front + 1.5), *bogie((*axles, drive)), *guards(axles[-1] + 0.8, drive - 0.9),
                *rear_end(rear)]  # fmt: skip
    axles = (rear + 1.5, rear + 2.8) if front - rear > 5.5 else (rear + 1.4,)
    return [frame(rear + 0.1, front + 1.5), *bogie(axles), *guards(axles[-1] + 0.7, front - 0.05), *rear_end(rear)]


def _load(name: str, load: tuple[float, float], height: float, cover: Skin) -> list[Mesh]:
    if name == "tanker":
        return _tank(load, height)
    return _flatbed(load) if name == "flatbed" else _box(load, height, cover)


def _box(load: tuple[float, float], height: float, cover: Skin) -> list[Mesh]:
    rear, front = load
    center, length, middle = (rear + front) / 2, front - rear, (_FLOOR_M + height) / 2
    ribs = [box((x, 1.275, middle), (0.05, 0.02, height - _FLOOR_M - 0.1), STEEL)
            for x in np.linspace(rear + 0.03, front - 0.03, 2 + int(length / 2.4)).tolist()]  # fmt: skip
    bars = [box((center, 1.275, z), (length, 0.024, 0.1), STEEL) for z in (_FLOOR_M + 0.05, height - 0.05)]
    doors = [box((rear - 0.006, y, middle), (0.012, 0.02, height - _FLOOR_M - 0.1), LINE) for y in (-0.45, 0.0, 0.45)]
    return [box((center, 0.0, middle), (length, 2.54, height - _FLOOR_M), cover), *map(both, [*ribs, *bars]), *doors]


def _flatbed(load: tuple[float, float]) -> list[Mesh]:
    """A deck with low sides, a headboard, and crates on it."""
    rear, front = load
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


def _tank(load: tuple[float, float], height: float) -> list[Mesh]:
    rear, front = load
    angle = np.arange(16) * (np.pi / 8) + np.pi / 16
    middle, tall = (_FLOOR_M + 0.05 + height) / 2, (height - _FLOOR_M - 0.05) / 2
    ends = [(rear + 0.1, 0.7), (rear + 0.25, 0.96), (rear + 0.5, 1.0), (front - 0.45, 1.0), (front - 0.2, 0.96),
            (front - 0.05, 0.7)]  # fmt: skip
    ring = np.stack([
        np.column_stack([np.full(16, x), 1.22 * share * np.cos(angle), middle + tall * share * np.sin(angle)])
        for x, share in ends
    ])  # fmt: skip
    bands = [_band(x, middle, tall) for x in np.linspace(rear + 0.8, front - 0.8, 4)]
    hatches = [cylinder((x, 0, height - 0.05), (x, 0, height + 0.08), 0.25, 8, STEEL)
               for x in np.linspace(rear + 1.2, front - 1.2, 3)]  # fmt: skip
    skirt = box(((rear + front) / 2, 0.0, _FLOOR_M + 0.05), (front - rear - 0.4, 2.2, 0.14), BLACK)
    return [shell(ring, np.zeros((5, 16), int), [Skin("metal", linear("c4c8cb"))]), *bands, *hatches, skirt]


def _band(x: float, middle: float, tall: float) -> Mesh:
    angle = np.arange(16) * (np.pi / 8) + np.pi / 16
    ring = np.stack([
        np.column_stack([np.full(16, x + dx), 1.24 * np.cos(angle), middle + (tall + 0.02) * np.sin(angle)])
        for dx in (-0.04, 0.04)
    ])  # fmt: skip
    return shell(ring, np.zeros((1, 16), int), [STEEL])
