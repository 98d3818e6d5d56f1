"""Lorries: box bodies, flatbeds, tankers, and semi-trailers as one rigid body with their tractor."""

from typing import Final

import numpy as np

from fbench.datasets.city.actor import Body
from fbench.datasets.city.bodies.finish import body
from fbench.datasets.city.bodies.lorry_parts import CAB_M, bogie, cab, frame, guards, rear_end
from fbench.datasets.city.bodies.paints import BLACK, LARGE, LINE, STEEL, linear, pick
from fbench.datasets.city.bodies.shell import both, shell
from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.shapes import Skin, box, cylinder

KINDS: Final = {"box": 0.4, "semi": 0.25, "flatbed": 0.2, "tanker": 0.15}
"""Kinds of lorries and how often they are drawn."""
_FLOOR_M: Final = 1.1
_GAP_M: Final = 0.35
"""Between cab and load."""
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
