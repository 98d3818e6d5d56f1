"""Objects in streets and beside roads: rails, walls, gantries, signs, lamp posts, benches, hydrants, signals."""

import numpy as np

from fbench.datasets.city.mesh import (
    Mesh,
    Quads,
    Rgb,
    Skin,
    Three,
    blocks,
    box,
    cylinder,
    join_quads,
    loft,
    merge_meshes,
    mesh,
    on_wall,
    quads_mesh,
    upright,
)
from fbench.replay.data.arrays import Float64

_RAIL = Skin("barrier", (0.34, 0.35, 0.36))
_POST = Skin("pole", (0.25, 0.26, 0.27))
_WAVE = np.array([(0.0, 0.1), (0.28, 1.0), (0.5, 0.3), (0.72, 1.0), (1.0, 0.1)])
"""Profile of a W-beam: height and depth, both from 0 to 1."""


def barrier(size_lwh_m: Three) -> Mesh:
    """Return a barrier along x, the same from both sides: concrete from 0.85 m high, else two W-beams on posts."""
    return _concrete(size_lwh_m) if size_lwh_m[2] >= 0.85 else _guard_rail(size_lwh_m)


def fence(size_lwh_m: Three, rng: np.random.Generator) -> Mesh:
    """Return a noise wall along x."""
    length, width, height = size_lwh_m
    at = np.linspace(-length / 2 + 0.06, length / 2 - 0.06, max(1, round(length / 4.0)) + 1)
    # On a wall that looks to -y, u goes along x.
    return quads_mesh(on_wall(_noise_wall(at, width / 2, height, rng), (0.0, 0.0, 0.0), -np.pi / 2))


def gantry(size_lwh_m: Three, rng: np.random.Generator) -> Mesh:
    """Return two posts as far apart as its box is wide, a truss and panels that look towards x."""
    length, width, height = size_lwh_m
    deep, top = min(length, 1.0) * 0.7, height - 0.5
    low = top - 0.9
    parts = []
    for y in (-width / 2 + 0.2, width / 2 - 0.2):
        parts.append(box((0.0, y, top / 2), (0.35, 0.4, top), _POST))
        parts.append(box((0.0, y, 0.3), (deep, 0.4, 0.6), Skin("concrete", (0.33, 0.32, 0.3))))
    for x in (-deep / 2, deep / 2):
        parts += [box((x, 0.0, z), (0.12, width, 0.12), _POST) for z in (low, top)]
    num = max(2, round(width / 1.5))
    at = np.linspace(-width / 2 + 0.1, width / 2 - 0.1, num + 1)
    parts += [_strut(x, a, b, low, top, i % 2 == 0) for x in (-deep / 2, deep / 2)
              for i, (a, b) in enumerate(zip(at[:-1].tolist(), at[1:].tolist(), strict=True))]  # fmt: skip
    return merge_meshes(
        [*parts, quads_mesh(on_wall(_panels(width, height, deep / 2 + 0.1, rng), (0.0, 0.0, 0.0), 0.0))]
    )


def _guard_rail(size_lwh_m: Three) -> Mesh:
    length, width, height = size_lwh_m
    num = max(1, round(length / 4.0))
    at = (np.arange(num) + 0.5) * (length / num) - length / 2
    half = max(width / 2 - 0.09, 0.03)
    posts = blocks(at - 0.04, at + 0.04, 0.0, height - 0.06, -half, half, _POST)
    return merge_meshes(
        [
            quads_mesh(on_wall(posts, (0.0, 0.0, 0.0), -np.pi / 2)),
            _beam(length, width / 2, height),
            _beam(length, -width / 2, height),
        ]
    )


def _beam(length: float, side: float, height: float) -> Mesh:
    """A folded sheet whose waves reach y = `side`, with a flat back, open at its ends."""
    depth, sign = min(0.083, abs(side) * 0.8), 1.0 if side > 0 else -1.0
    z = height - 0.31 + 0.31 * _WAVE[:, 0]
    y = side - sign * depth * (1 - _WAVE[:, 1])
    back = side - sign * (depth + 0.004)
    profile = np.concatenate([np.column_stack([y, z]), [(back, z[-1]), (back, z[0])]])
    profile = profile if sign > 0 else profile[::-1]
    rings = [np.column_stack([np.full(len(profile), x), profile]) for x in (-length / 2, length / 2)]
    return loft(rings, _RAIL, closed=False)


def _concrete(size_lwh_m: Three) -> Mesh:
    """A New Jersey profile."""
    length, width, height = size_lwh_m
    steps = ((0.0, 1.0), (0.09, 1.0), (0.4, 0.5), (1.0, 0.28))
    rings = [_oblong(length, share * width, z * height) for z, share in steps]
    return loft(rings, Skin("concrete", (0.42, 0.41, 0.39)))


def _oblong(length: float, width: float, z: float) -> Float64:
    x, y = length / 2, width / 2
    return np.array([(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)])


def _noise_wall(at: Float64, half: float, height: float, rng: np.random.Generator) -> Quads:
    """Panels of concrete below colored ones, between steel posts."""
    tint = ((0.25, 0.3, 0.24), (0.34, 0.31, 0.25), (0.24, 0.3, 0.34))[int(rng.integers(3))]
    rows = max(1, round(height / 1.0))
    v = np.linspace(0.0, height - 0.04, rows + 1)
    low, high = np.tile(v[:-1], len(at) - 1), np.tile(v[1:], len(at) - 1)
    u0, u1 = np.repeat(at[:-1], rows) + 0.05, np.repeat(at[1:], rows) - 0.05
    deep = np.where(np.tile(np.arange(rows), len(at) - 1) % 2 == 0, 0.6, 0.66) * half
    panels = blocks(u0, u1, low, high, -deep, deep, Skin("concrete", tint))
    posts = blocks(at - 0.06, at + 0.06, 0.0, height, -half, half, _POST)
    return join_quads([panels, posts])


def _strut(x: float, y0: float, y1: float, low: float, top: float, rises: bool) -> Mesh:
    """A diagonal of a truss, 6 cm thick."""
    z0, z1 = (low, top) if rises else (top, low)
    t = 0.03
    near, far = (np.array([(x - t, y, z - t), (x + t, y, z - t), (x + t, y, z + t), (x - t, y, z + t)])
                 for y, z in ((y0, z0), (y1, z1)))  # fmt: skip
    return loft([near[::-1], far[::-1]], _POST)


def _panels(width: float, height: float, x: float, rng: np.random.Generator) -> Quads:
    """Signs with a white border, lines of text and an arrow down for each lane."""
    num = max(1, int(width / 5.5))
    pitch = width / num
    wide, low = min(0.82 * pitch, 4.6), height - 2.6
    u = (np.arange(num, dtype=np.float64) + 0.5) * pitch - width / 2
    u0, u1, v0, v1 = u - wide / 2, u + wide / 2, low, height
    paint = Skin("sign", ((0.012, 0.07, 0.3), (0.012, 0.15, 0.06))[int(rng.integers(2))])
    white = Skin("sign", (0.75, 0.75, 0.73))
    text = rng.uniform(0.25, 0.38, (2, num)) * wide
    parts = [
        blocks(u0, u1, v0, v1, x - 0.06, x, Skin("metal", (0.3, 0.3, 0.3))),
        upright(u0 + 0.02, u1 - 0.02, v0 + 0.02, v1 - 0.02, x + 0.004, white),
        upright(u0 + 0.08, u1 - 0.08, v0 + 0.08, v1 - 0.08, x + 0.008, paint),
        *(
            upright(u - half, u + half, v1 - z - 0.38, v1 - z, x + 0.012, white)
            for half, z in zip(text, (0.3, 0.95), strict=True)
        ),
        upright(u - 0.08, u + 0.08, v0 + 0.5, v0 + 0.95, x + 0.012, white),
    ]
    return join_quads([*parts, _arrows(u, v0, x + 0.012, white)])


def _arrows(u: Float64, v0: float, x: float, skin: Skin) -> Quads:
    flat = upright(u - 0.25, u + 0.25, v0 + 0.2, v0 + 0.5, x, skin)
    corners = flat.corners_m.copy()
    corners[:, 0, 0] += 0.22
    corners[:, 1, 0] -= 0.22
    return Quads(corners, flat.material, flat.color)


KINDS = ("stop", "yield", "limit", "crossing", "no_entry", "parking")  # What a sign says, by its variant
_RED: Rgb = (0.5, 0.012, 0.02)
_WHITE: Rgb = (0.75, 0.75, 0.73)
_BLUE: Rgb = (0.012, 0.07, 0.32)
_BLACK: Rgb = (0.012, 0.012, 0.012)
_LAYER_M = 0.003


def sign(size_lwh_m: Three, kind: str) -> Mesh:
    """Return a sign of one of `KINDS` whose plate is as wide as its box."""
    _, width, height = size_lwh_m
    half = min(width, height) / 2
    middle = height - half
    post = cylinder((0.0, 0.0, 0.0), (0.0, 0.0, height - 0.1 * half), 0.03, 8, Skin("pole", (0.3, 0.31, 0.32)))
    plate = [_move_mesh(part, 0.035, middle) for part in _plate(kind, half)]
    return merge_meshes([post, *plate])


def _plate(kind: str, half: float) -> list[Mesh]:
    if kind == "stop":
        octagon = _disc(8, half / np.cos(np.pi / 8), np.pi / 8)
        return [
            _board(octagon),
            _face(octagon, 1, _WHITE),
            _face(octagon * 0.93, 2, _RED),
            *_word("STOP", half, _WHITE),
        ]
    if kind == "yield":
        triangle = half * np.array([(0.0, -0.9), (1.0, 0.85), (-1.0, 0.85)])
        inner = (triangle - [0, 0.27 * half]) * 0.55 + [0, 0.27 * half]
        return [_board(triangle), _face(triangle, 1, _RED), _face(inner, 2, _WHITE)]
    if kind == "limit":
        ring = _disc(24, half)
        return [_board(ring), _face(ring, 1, _RED), _face(ring * 0.78, 2, _WHITE), *_word("50", half, _BLACK)]
    if kind == "no_entry":
        ring = _disc(24, half)
        return [_board(ring), _face(ring, 1, _RED), _face(_bar(0.0, 0.0, 0.7, 0.17) * half, 2, _WHITE)]
    square = half * np.array([(-0.98, -0.98), (0.98, -0.98), (0.98, 0.98), (-0.98, 0.98)])
    board = [_board(square), _face(square, 1, _WHITE), _face(square * 0.94, 2, _BLUE)]
    if kind == "parking":
        return [*board, *_word("P", half * 1.5, _WHITE)]
    return [*board, _face(half * np.array([(-0.75, -0.65), (0.75, -0.65), (0.0, 0.75)]), 3, _WHITE), *_walker(half)]


def _walker(half: float) -> list[Mesh]:
    head = _disc(8, 0.09) + np.array([0.0, 0.22])
    legs = [
        [(-0.02, 0.1), (-0.25, -0.5), (-0.14, -0.5), (0.08, 0.1)],
        [(-0.06, 0.0), (0.14, -0.5), (0.25, -0.5), (0.08, 0.1)],
    ]
    return [_face(np.array(shape) * half, 4, _BLACK) for shape in (head, *legs)]


def _word(text: str, half: float, color: Rgb) -> list[Mesh]:
    """Letters of bars, in the middle of a plate."""
    wide = 0.36 if len(text) > 1 else 0.5
    wide = 0.3 if len(text) > 3 else wide
    tall, pitch = 1.5 * wide, 1.35 * wide
    parts = []
    for i, letter in enumerate(text):
        left = (i - (len(text) - 1) / 2) * pitch
        for x, y, w, h in _LETTERS[letter]:
            bar = _bar(left + x * wide, y * tall, w * wide, h * tall)
            parts.append(_face(bar * half, 4, color))
    return parts


_TOP, _MIDDLE, _BOTTOM = (0.0, 0.43, 0.5, 0.07), (0.0, 0.0, 0.5, 0.07), (0.0, -0.43, 0.5, 0.07)
_UPPER_LEFT, _LOWER_RIGHT = (-0.4, 0.22, 0.1, 0.16), (0.4, -0.22, 0.1, 0.16)
_LEFT, _RIGHT = (-0.4, 0.0, 0.1, 0.37), (0.4, 0.0, 0.1, 0.37)
_S = (_TOP, _UPPER_LEFT, _MIDDLE, _LOWER_RIGHT, _BOTTOM)
_LETTERS = {
    "S": _S,
    "5": _S,
    "T": (_TOP, (0.0, -0.07, 0.1, 0.43)),
    "O": (_TOP, _LEFT, _RIGHT, _BOTTOM),
    "0": (_TOP, _LEFT, _RIGHT, _BOTTOM),
    "P": ((0.05, 0.43, 0.45, 0.07), (0.05, 0.0, 0.45, 0.07), (0.4, 0.22, 0.1, 0.15), (-0.4, 0.0, 0.1, 0.5)),
}
"""Bars of letters: middle and half sizes in a cell from -0.5 to 0.5."""


def _bar(x: float, y: float, half_wide: float, half_tall: float) -> Float64:
    signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    bar: Float64 = signs * np.array([half_wide, half_tall]) + np.array([x, y])
    return bar


def _disc(num: int, radius: float, turn_rad: float = 0.0) -> Float64:
    angle = np.arange(num) * (2 * np.pi / num) + turn_rad
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _board(outline: Float64) -> Mesh:
    """A gray sheet behind the plate's face: y to the right of who looks at it, z up."""
    rings = [np.column_stack([np.full(len(outline), x), outline]) for x in (-0.02, 0.0)]
    return loft(rings, Skin("metal", (0.35, 0.35, 0.35)))


def _face(outline: Float64, layer: int, color: Rgb) -> Mesh:
    num = len(outline)
    fan = np.column_stack([np.zeros(num - 2, int), np.arange(1, num - 1), np.arange(2, num)])
    return mesh(np.column_stack([np.full(num, layer * _LAYER_M), outline]), fan, Skin("sign", color))


def _move_mesh(part: Mesh, x: float, z: float) -> Mesh:
    vertices = (part.vertices_m + np.array([x, 0, z], np.float32)).astype(np.float32)
    return Mesh(vertices, part.triangles, part.material, part.color, part.lamp)


_STEEL = Skin("pole", (0.19, 0.2, 0.205))
_DARK = Skin("pole", (0.04, 0.045, 0.045))
_BULB = Skin("street_lamp", (1.0, 0.86, 0.65))


def lamp_post(size_lwh_m: Three) -> Mesh:
    """Return a post whose arm reaches `length` to the front from its foot."""
    reach, width, height = size_lwh_m
    base = cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.9), min(0.11, width / 2), 8, _STEEL)
    pole = cylinder((0.0, 0.0, 0.0), (0.0, 0.0, height - 0.5), 0.085, 8, _STEEL, 0.055)
    bend = [(0.0, -0.55), (0.04, -0.35), (0.16, -0.18), (0.4, -0.08), (reach - 0.55, -0.06)]
    arm = loft([_ring(x, height + z, slope) for (x, z), slope in zip(bend, (0.0, 0.3, 0.8, 1.3, 1.57), strict=True)],
               _STEEL)  # fmt: skip
    middle = reach - 0.35
    head = box((middle, 0.0, height - 0.05), (0.7, min(0.26, width), 0.1), _STEEL)
    glass = box((middle + 0.03, 0.0, height - 0.115), (0.5, 0.7 * min(0.26, width), 0.03), _BULB)
    return merge_meshes([base, pole, arm, head, glass])


def bench(size_lwh_m: Three) -> Mesh:
    """Return a bench of wooden slats on two iron feet; one sits looking towards x."""
    length, width, height = size_lwh_m
    wood, seat = Skin("wood", (0.2, 0.11, 0.055)), 0.53 * height
    deep = length / 3
    parts = [box((x, 0.0, seat - 0.02), (deep * 0.75, width, 0.04), wood) for x in (-deep / 2, deep / 2, deep * 1.12)]
    parts += [box((-length / 2 + 0.03, 0.0, height * z), (0.04, width, 0.13 * height), wood) for z in (0.72, 0.93)]
    for y in (-0.38 * width, 0.38 * width):
        parts += [
            box((0.0, y, seat - 0.07), (0.9 * length, 0.05, 0.06), _DARK),
            box((0.38 * length, y, seat / 2 - 0.05), (0.05, 0.05, seat - 0.1), _DARK),
            box((-0.38 * length, y, seat / 2 - 0.05), (0.05, 0.05, seat - 0.1), _DARK),
            box((-length / 2 + 0.075, y, 0.75 * height), (0.05, 0.05, 0.48 * height), _DARK),
        ]
    return merge_meshes(parts)


def bin_(size_lwh_m: Three, rng: np.random.Generator) -> Mesh:
    """Return a litter bin with a slanted lid."""
    length, width, height = size_lwh_m
    radius = min(length, width) / 2
    color = ((0.03, 0.09, 0.05), (0.05, 0.05, 0.055), (0.35, 0.13, 0.02))[int(rng.integers(3))]
    return merge_meshes([
        cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.78 * height), 0.85 * radius, 10, Skin("plastic", color), 0.97 * radius),
        cylinder((0.0, 0.0, 0.78 * height), (0.0, 0.0, 0.9 * height), 0.8 * radius, 10, Skin("plastic", (0.01,) * 3)),
        cylinder((0.0, 0.0, 0.9 * height), (0.0, 0.0, height), radius, 10, Skin("plastic", color), 0.6 * radius),
    ])  # fmt: skip


def hydrant(size_lwh_m: Three) -> Mesh:
    """Return a red hydrant with three caps."""
    length, width, height = size_lwh_m
    red = Skin("paint", (0.42, 0.03, 0.025))
    r = 0.32 * min(length, width)
    z = 0.62 * height
    return merge_meshes([
        cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.06), 1.35 * r, 10, red),
        cylinder((0.0, 0.0, 0.05), (0.0, 0.0, 0.8 * height), r, 10, red),
        cylinder((0.0, 0.0, 0.8 * height), (0.0, 0.0, height), 1.2 * r, 10, red, 0.3 * r),
        cylinder((0.0, -width / 2, z), (0.0, width / 2, z), 0.55 * r, 8, Skin("metal", (0.4, 0.4, 0.38))),
        cylinder((0.0, 0.0, z), (length / 2, 0.0, z), 0.7 * r, 8, red),
    ])  # fmt: skip


def _ring(x: float, z: float, slope: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Six points about a tube at x, z that leans forward by `slope` radians from upright."""
    angle = np.arange(6) * (np.pi / 3)
    across = 0.045 * np.cos(angle)
    return np.column_stack([x + across * np.cos(slope), 0.045 * np.sin(angle), z - across * np.sin(slope)])


LAMPS: tuple[Rgb, Rgb, Rgb] = ((1.0, 0.035, 0.02), (1.0, 0.5, 0.02), (0.03, 1.0, 0.42))
"""Red, yellow, green: the order of lamps in a group."""
_STREET_POST = Skin("pole", (0.17, 0.18, 0.18))
_CASE = Skin("plastic", (0.018, 0.018, 0.018))


def signal(size_lwh_m: Three) -> Mesh:
    """Return a signal for those who come towards its front (x); its lamps are numbered 0 red, 1 yellow, 2 green.

    Below 3 m it is one for pedestrians, without yellow.
    """
    length, width, height = size_lwh_m
    deep = min(length, 0.5)
    post = -deep / 2 + 0.045
    lamps = (0, 1, 2) if height >= 3.0 else (0, 2)
    top = height - 0.16 * len(lamps) - 0.02
    return merge_meshes([
        cylinder((post, 0.0, 0.0), (post, 0.0, height), 0.045, 8, _STREET_POST),
        *_head((post + 0.04, 0.0, top), deep / 2, min(width, 0.32), lamps),
    ])  # fmt: skip


def _head(back_m: Three, front_m: float, width_m: float, lamps: tuple[int, ...]) -> list[Mesh]:
    """A black case with its lamps, one above the other: its back's middle, and how far the visors reach."""
    x, y, z = back_m
    deep = 0.4 * (front_m - x)
    parts = [box((x + deep / 2, y, z), (deep, width_m, 0.32 * len(lamps)), _CASE)]
    for place, number in enumerate(lamps):
        level = z + 0.31 * ((len(lamps) - 1) / 2 - place)
        lamp = cylinder((x + deep - 0.01, y, level), (x + deep + 0.01, y, level), 0.36 * width_m, 10,
                        Skin("signal_lamp", LAMPS[number], number))  # fmt: skip
        out = front_m - x - deep
        visor = box((x + deep + out / 2, y, level + 0.39 * width_m), (out, 0.7 * width_m, 0.012), _CASE)
        parts += [lamp, visor]
    return parts
