"""Objects in streets and beside roads: rails, walls, gantries, signs, lamp posts, benches, hydrants, signals."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from fbench.datasets.city.mesh import Mesh, Rgb, Skin, Three, box, cylinder, loft, merge_meshes, mesh, shift
from fbench.datasets.city.scenery.quads import Quads, blocks, join_quads, upright
from fbench.replay.data.arrays import Float64

_RAIL = Skin("barrier", (0.34, 0.35, 0.36))
_POST = Skin("pole", (0.25, 0.26, 0.27))
_WAVE = np.array([(0.0, 0.1), (0.28, 1.0), (0.5, 0.3), (0.72, 1.0), (1.0, 0.1)])
"""Profile of a W-beam: height and depth, both from 0 to 1."""
_STEEL, _STREET_POST = Skin("pole", (0.19, 0.2, 0.205)), Skin("pole", (0.17, 0.18, 0.18))
_DARK = Skin("pole", (0.04, 0.045, 0.045))
_BULB, _CASE = Skin("street_lamp", (1.0, 0.86, 0.65)), Skin("plastic", (0.018, 0.018, 0.018))
_RED, _WHITE, _BLUE, _BLACK = (0.5, 0.012, 0.02), (0.75, 0.75, 0.73), (0.012, 0.07, 0.32), (0.012, 0.012, 0.012)
_LEGS = (
    [(-0.02, 0.1), (-0.25, -0.5), (-0.14, -0.5), (0.08, 0.1)],
    [(-0.06, 0.0), (0.14, -0.5), (0.25, -0.5), (0.08, 0.1)],
)
LAMPS: tuple[Rgb, Rgb, Rgb] = ((1.0, 0.035, 0.02), (1.0, 0.5, 0.02), (0.03, 1.0, 0.42))
"""Red, yellow, green: the order of lamps in a group."""


def barrier(size_lwh_m: Three) -> Mesh:
    """Return a barrier along x, the same from both sides: a New Jersey profile of concrete from 0.85 m high, else two
    W-beams on posts.
    """
    length, width, height = size_lwh_m
    if height >= 0.85:
        x, steps = length / 2, ((0.0, 1.0), (0.09, 1.0), (0.4, 0.5), (1.0, 0.28))
        sections = [(share * width / 2, z * height) for z, share in steps]
        rings = [np.array([(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)]) for y, z in sections]
        return loft(rings, Skin("concrete", (0.42, 0.41, 0.39)))
    num = max(1, round(length / 4.0))
    at = (np.arange(num) + 0.5) * (length / num) - length / 2
    half = max(width / 2 - 0.09, 0.03)
    posts = blocks(at - 0.04, at + 0.04, 0.0, height - 0.06, -half, half, _POST)
    beams = (_beam(length, side, height) for side in (width / 2, -width / 2))
    return merge_meshes([posts.on_wall(-np.pi / 2).mesh(), *beams])


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


def fence(size_lwh_m: Three, rng: np.random.Generator) -> Mesh:
    """Return a noise wall along x: panels of concrete below colored ones, between steel posts."""
    length, width, height = size_lwh_m
    at = np.linspace(-length / 2 + 0.06, length / 2 - 0.06, max(1, round(length / 4.0)) + 1)
    tint = ((0.25, 0.3, 0.24), (0.34, 0.31, 0.25), (0.24, 0.3, 0.34))[int(rng.integers(3))]
    rows, num, half = max(1, round(height / 1.0)), len(at) - 1, width / 2
    v = np.linspace(0.0, height - 0.04, rows + 1)
    u0, u1 = np.repeat(at[:-1], rows) + 0.05, np.repeat(at[1:], rows) - 0.05
    deep = np.where(np.tile(np.arange(rows), num) % 2 == 0, 0.6, 0.66) * half
    panels = blocks(u0, u1, np.tile(v[:-1], num), np.tile(v[1:], num), -deep, deep, Skin("concrete", tint))
    posts = blocks(at - 0.06, at + 0.06, 0.0, height, -half, half, _POST)
    return join_quads([panels, posts]).on_wall(-np.pi / 2).mesh()  # that looks to -y: u goes along x


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
    at = np.linspace(-width / 2 + 0.1, width / 2 - 0.1, max(2, round(width / 1.5)) + 1)
    t = 0.03  # half the thickness of the diagonals
    for x in (-deep / 2, deep / 2):
        for i, (y0, y1) in enumerate(pairwise(at.tolist())):
            z0, z1 = (top, low) if i % 2 else (low, top)
            near, far = (np.array([(x - t, y, z - t), (x + t, y, z - t), (x + t, y, z + t), (x - t, y, z + t)])
                         for y, z in ((y0, z0), (y1, z1)))  # fmt: skip
            parts.append(loft([near[::-1], far[::-1]], _POST))
    return merge_meshes([*parts, _panels(width, height, deep / 2 + 0.1, rng).on_wall(0.0).mesh()])


def _panels(width: float, height: float, x: float, rng: np.random.Generator) -> Quads:
    """Signs with a white border, lines of text and an arrow down for each lane."""
    num = max(1, int(width / 5.5))
    pitch = width / num
    wide, low = min(0.82 * pitch, 4.6), height - 2.6
    u = (np.arange(num, dtype=np.float64) + 0.5) * pitch - width / 2
    u0, u1, v0, v1 = u - wide / 2, u + wide / 2, low, height
    paint = Skin("sign", ((0.012, 0.07, 0.3), (0.012, 0.15, 0.06))[int(rng.integers(2))])
    white, text = Skin("sign", _WHITE), rng.uniform(0.25, 0.38, (2, num)) * wide
    flat = upright(u - 0.25, u + 0.25, v0 + 0.2, v0 + 0.5, x + 0.012, white)
    arrows = flat.corners_m.copy()
    arrows[:, :2, 0] += [0.22, -0.22]
    return join_quads([
        blocks(u0, u1, v0, v1, x - 0.06, x, Skin("metal", (0.3, 0.3, 0.3))),
        upright(u0 + 0.02, u1 - 0.02, v0 + 0.02, v1 - 0.02, x + 0.004, white),
        upright(u0 + 0.08, u1 - 0.08, v0 + 0.08, v1 - 0.08, x + 0.008, paint),
        *(upright(u - half, u + half, v1 - z - 0.38, v1 - z, x + 0.012, white)
          for half, z in zip(text, (0.3, 0.95), strict=True)),
        upright(u - 0.08, u + 0.08, v0 + 0.5, v0 + 0.95, x + 0.012, white),
        replace(flat, corners_m=arrows),
    ])  # fmt: skip


KINDS = ("stop", "yield", "limit", "crossing", "no_entry", "parking")  # What a sign says, by its variant
Face = tuple[Float64, int, Rgb]  # An outline (P, 2), y to the right of who looks at it, z up; its layer and color
_TOP, _MIDDLE, _BOTTOM = (0.0, 0.43, 0.5, 0.07), (0.0, 0.0, 0.5, 0.07), (0.0, -0.43, 0.5, 0.07)
_UPPER_LEFT, _LOWER_RIGHT = (-0.4, 0.22, 0.1, 0.16), (0.4, -0.22, 0.1, 0.16)
_LEFT, _RIGHT = (-0.4, 0.0, 0.1, 0.37), (0.4, 0.0, 0.1, 0.37)
_S, _O = (_TOP, _UPPER_LEFT, _MIDDLE, _LOWER_RIGHT, _BOTTOM), (_TOP, _LEFT, _RIGHT, _BOTTOM)
_P = ((0.05, 0.43, 0.45, 0.07), (0.05, 0.0, 0.45, 0.07), (0.4, 0.22, 0.1, 0.15), (-0.4, 0.0, 0.1, 0.5))
_LETTERS = {"S": _S, "5": _S, "T": (_TOP, (0.0, -0.07, 0.1, 0.43)), "O": _O, "0": _O, "P": _P}
"""Bars of letters: middle and half sizes in a cell from -0.5 to 0.5."""


def sign(size_lwh_m: Three, kind: str) -> Mesh:
    """Return a sign of one of `KINDS` whose plate is as wide as its box."""
    _, width, height = size_lwh_m
    half = min(width, height) / 2
    square, ring = half * np.array([(-0.98, -0.98), (0.98, -0.98), (0.98, 0.98), (-0.98, 0.98)]), _disc(24, half)
    inner: list[Face]
    match kind:
        case "stop":
            octagon = _disc(8, half / np.cos(np.pi / 8), np.pi / 8)
            outline, color, inner = octagon, _WHITE, [(octagon * 0.93, 2, _RED), *_word("STOP", half, _WHITE)]
        case "yield":
            triangle = half * np.array([(0.0, -0.9), (1.0, 0.85), (-1.0, 0.85)])
            smaller = (triangle - [0, 0.27 * half]) * 0.55 + [0, 0.27 * half]
            outline, color, inner = triangle, _RED, [(smaller, 2, _WHITE)]
        case "limit":
            outline, color, inner = ring, _RED, [(ring * 0.78, 2, _WHITE), *_word("50", half, _BLACK)]
        case "no_entry":
            outline, color, inner = ring, _RED, [(_bar(0.0, 0.0, 0.7, 0.17) * half, 2, _WHITE)]
        case "parking":
            outline, color, inner = square, _WHITE, [(square * 0.94, 2, _BLUE), *_word("P", half * 1.5, _WHITE)]
        case _:
            triangle = half * np.array([(-0.75, -0.65), (0.75, -0.65), (0.0, 0.75)])
            outline, color, inner = square, _WHITE, [(square * 0.94, 2, _BLUE), (triangle, 3, _WHITE)]
            inner += [(np.array(shape) * half, 4, _BLACK) for shape in (_disc(8, 0.09) + np.array([0.0, 0.22]), *_LEGS)]
    gray = Skin("metal", (0.35, 0.35, 0.35))
    plate = [loft([np.column_stack([np.full(len(outline), x), outline]) for x in (-0.02, 0.0)], gray)]
    for shape, layer, shown in [(outline, 1, color), *inner]:
        num = len(shape)
        fan = np.column_stack([np.zeros(num - 2, int), np.arange(1, num - 1), np.arange(2, num)])
        plate.append(mesh(np.column_stack([np.full(num, layer * 0.003), shape]), fan, Skin("sign", shown)))
    post = cylinder((0.0, 0.0, 0.0), (0.0, 0.0, height - 0.1 * half), 0.03, 8, Skin("pole", (0.3, 0.31, 0.32)))
    return merge_meshes([post, *(shift(part, (0.035, 0.0, height - half)) for part in plate)])


def _word(text: str, half: float, color: Rgb) -> list[Face]:
    """Letters of bars, in the middle of a plate."""
    wide = 0.5 if len(text) == 1 else 0.3 if len(text) > 3 else 0.36
    tall, pitch = 1.5 * wide, 1.35 * wide
    bars = [((i - (len(text) - 1) / 2) * pitch, *bar) for i, letter in enumerate(text) for bar in _LETTERS[letter]]
    return [(_bar(left + x * wide, y * tall, w * wide, h * tall) * half, 4, color) for left, x, y, w, h in bars]


def _bar(x: float, y: float, half_wide: float, half_tall: float) -> Float64:
    signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    return np.asarray(signs * np.array([half_wide, half_tall]) + np.array([x, y]))


def _disc(num: int, radius: float, turn_rad: float = 0.0) -> Float64:
    angle = np.arange(num) * (2 * np.pi / num) + turn_rad
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def lamp_post(size_lwh_m: Three) -> Mesh:
    """Return a post whose arm reaches `length` to the front from its foot."""
    reach, width, height = size_lwh_m
    base = cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.9), min(0.11, width / 2), 8, _STEEL)
    pole = cylinder((0.0, 0.0, 0.0), (0.0, 0.0, height - 0.5), 0.085, 8, _STEEL, 0.055)
    bend = [(0.0, -0.55), (0.04, -0.35), (0.16, -0.18), (0.4, -0.08), (reach - 0.55, -0.06)]
    across, aside = 0.045 * np.cos(np.arange(6) * (np.pi / 3)), 0.045 * np.sin(np.arange(6) * (np.pi / 3))
    rings = [np.column_stack([x + across * np.cos(slope), aside, height + z - across * np.sin(slope)])
             for (x, z), slope in zip(bend, (0.0, 0.3, 0.8, 1.3, 1.57), strict=True)]  # fmt: skip
    arm = loft(rings, _STEEL)
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


def signal(size_lwh_m: Three) -> Mesh:
    """Return a signal for those who come towards its front (x); its lamps are numbered 0 red, 1 yellow, 2 green. Below
    3 m it is one for pedestrians, without yellow.
    """
    length, width, height = size_lwh_m
    front, wide = min(length, 0.5) / 2, min(width, 0.32)
    lamps = (0, 1, 2) if height >= 3.0 else (0, 2)
    post, top = -min(length, 0.5) / 2 + 0.045, height - 0.16 * len(lamps) - 0.02
    x = post + 0.04
    deep = 0.4 * (front - x)
    out = front - x - deep  # how far visors reach
    parts = [cylinder((post, 0.0, 0.0), (post, 0.0, height), 0.045, 8, _STREET_POST),
             box((x + deep / 2, 0.0, top), (deep, wide, 0.32 * len(lamps)), _CASE)]  # fmt: skip
    for place, number in enumerate(lamps):
        level, skin = top + 0.31 * ((len(lamps) - 1) / 2 - place), Skin("signal_lamp", LAMPS[number], number)
        parts.append(cylinder((x + deep - 0.01, 0.0, level), (x + deep + 0.01, 0.0, level), 0.36 * wide, 10, skin))
        parts.append(box((x + deep + out / 2, 0.0, level + 0.39 * wide), (out, 0.7 * wide, 0.012), _CASE))
    return merge_meshes(parts)
