"""Traffic signs: a post with a plate that looks towards x."""

import numpy as np

from fbench.datasets.city.mesh import Mesh, merged
from fbench.datasets.city.shapes import Rgb, Skin, Three, cylinder, loft, mesh
from fbench.replay.arrays import Float64

KINDS = ("stop", "yield", "limit", "crossing", "no_entry", "parking")
"""What a sign says, by its variant."""
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
    plate = [_moved(part, 0.035, middle) for part in _plate(kind, half)]
    return merged([post, *plate])


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
    """A grey sheet behind the plate's face: y to the right of who looks at it, z up."""
    rings = [np.column_stack([np.full(len(outline), x), outline]) for x in (-0.02, 0.0)]
    return loft(rings, Skin("metal", (0.35, 0.35, 0.35)))


def _face(outline: Float64, layer: int, color: Rgb) -> Mesh:
    num = len(outline)
    fan = np.column_stack([np.zeros(num - 2, int), np.arange(1, num - 1), np.arange(2, num)])
    return mesh(np.column_stack([np.full(num, layer * _LAYER_M), outline]), fan, Skin("sign", color))


def _moved(part: Mesh, x: float, z: float) -> Mesh:
    vertices = (part.vertices_m + np.array([x, 0, z], np.float32)).astype(np.float32)
    return Mesh(vertices, part.triangles, part.material, part.color, part.lamp)
