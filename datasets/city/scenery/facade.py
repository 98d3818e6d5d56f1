"""Walls with windows, doors, shop fronts and balconies, in coordinates of the wall (see `quads`)."""

from dataclasses import replace

import numpy as np

from fbench.datasets.city.materials import INDEX
from fbench.datasets.city.scenery.quads import (
    Quads,
    above,
    below,
    blocks,
    joined,
    leftward,
    painted,
    rightward,
    shaded,
    upright,
)
from fbench.datasets.city.scenery.style import SHOP_COLORS, Style
from fbench.datasets.city.shapes import Rgb, Skin
from fbench.replay.arrays import Array, Float64

_RECESS_M = 0.12
"""How deep windows lie in the wall."""
_FRAME_M = 0.07
_OUT_M = 0.8
"""How far balconies and awnings stand out."""
_LIT: tuple[Rgb, ...] = ((0.30, 0.21, 0.12), (0.30, 0.24, 0.16), (0.27, 0.27, 0.25))
"""Colours of rooms behind lit windows: by day they are curtains, so not too bright."""
_DOORS: tuple[Rgb, ...] = ((0.12, 0.06, 0.03), (0.03, 0.08, 0.05), (0.05, 0.06, 0.12), (0.22, 0.03, 0.03))


def facade(width_m: float, height_m: float, style: Style, front: bool, rng: np.random.Generator) -> Quads:
    """Return a wall from u = 0 to its width and v = 0 to its height, with all that belongs to it."""
    if style.use == "hall":
        return _hall(width_m, height_m, style, front, rng)
    ground = min(style.ground_m, height_m)
    storeys = max(1, round((height_m - ground) / style.storey_m)) if height_m - ground > 2.2 else 0
    floors = ground + np.arange(storeys + 1, dtype=np.float64) * ((height_m - ground) / max(storeys, 1))
    bays = round(width_m / style.bay_m)
    upper = _rows(width_m, bays, floors, style, front, rng) if storeys else _wall(width_m, ground, height_m, style.wall)
    parts = [upper, _ground_floor(width_m, ground, style, front, rng)]
    if front and style.balconies and storeys and bays:
        parts.append(_balconies(width_m, bays, floors[:-1], style, rng))
    return joined(parts)


def _wall(width: float, v0: float, v1: float, skin: Skin) -> Quads:
    return upright(0.0, width, v0, v1, 0.0, skin)


def _rows(width: float, bays: int, floors: Float64, style: Style, deep: bool, rng: np.random.Generator) -> Quads:
    """Storeys between `floors` with a window in every bay: `deep` in the wall, or flat where few will look."""
    if bays < 1:
        return _wall(width, float(floors[0]), float(floors[-1]), style.wall)
    bay = width / bays
    half = min(bay * style.window_share, bay - 0.2) / 2
    middle = (np.arange(bays) + 0.5) * bay
    v0 = floors[:-1] + style.sill_m
    v1 = np.minimum(v0 + style.window_m, floors[1:] - 0.25)
    rows, columns = np.repeat(np.arange(len(v0)), bays), np.tile(middle, len(v0))
    openings = columns - half, columns + half, v0[rows], v1[rows]
    if not deep:
        frames = upright(*openings, 0.02, style.frame)
        wall = _wall(width, float(floors[0]), float(floors[-1]), style.wall)
        return joined([wall, frames, _panes(*openings, 0.04, style, rng)])
    bands = upright(0.0, width, np.append(floors[0], v1), np.append(v0, floors[-1]), 0.0, style.wall)
    left, right = np.append(0.0, middle + half), np.append(middle - half, width)
    rows, columns = np.repeat(np.arange(len(v0)), bays + 1), np.tile(np.arange(bays + 1), len(v0))
    piers = upright(left[columns], right[columns], v0[rows], v1[rows], 0.0, style.wall)
    return joined([bands, piers, windows(*openings, style, rng)])


def windows(u0: Array, u1: Array, v0: Array, v1: Array, style: Style, rng: np.random.Generator) -> Quads:
    """Return what fills openings of a wall: reveals, frames and panes, some lit, some with curtains."""
    d = -_RECESS_M
    reveal = replace(style.wall, color=shaded(style.wall.color, 0.85))
    sides = [
        above(u0, u1, d, 0.0, v0, style.trim),
        below(u0, u1, d, 0.0, v1, reveal),
        rightward(v0, v1, d, 0.0, u0, reveal),
        leftward(v0, v1, d, 0.0, u1, reveal),
    ]
    return joined([*sides, upright(u0, u1, v0, v1, d, style.frame), _panes(u0, u1, v0, v1, d + 0.02, style, rng)])


def _panes(u0: Array, u1: Array, v0: Array, v1: Array, d: float, style: Style, rng: np.random.Generator) -> Quads:
    num, panes = len(u0), style.panes
    pitch = (u1 - u0 - _FRAME_M) / panes
    starts = (u0 + _FRAME_M)[:, None] + pitch[:, None] * np.arange(panes)
    ends = starts + pitch[:, None] - _FRAME_M
    quads = upright(starts.ravel(), ends.ravel(), np.repeat(v0 + _FRAME_M, panes), np.repeat(v1 - _FRAME_M, panes),
                    d, Skin("window", (0.03, 0.035, 0.04)))  # fmt: skip
    lit = rng.random(num) < style.lit_share
    shade = np.where(rng.random(num) < 0.3, rng.uniform(0.08, 0.25, num), rng.uniform(0.015, 0.05, num))
    glass = shade[:, None] * np.array([0.93, 1.0, 1.05])
    color = np.where(lit[:, None], np.asarray(_LIT)[rng.integers(len(_LIT), size=num)], glass)
    material = np.where(lit, INDEX["lit_window"], INDEX["window"]).astype(np.uint8)
    return Quads(quads.corners_m, np.repeat(material, panes), np.repeat(color, panes, axis=0).astype(np.float32))


def _ground_floor(width: float, height: float, style: Style, front: bool, rng: np.random.Generator) -> Quads:
    if front and style.shop and width > 4:
        return _shops(width, height, style, rng)
    ground = replace(style, wall=style.base, window_share=min(style.window_share, 0.6), sill_m=1.0)
    bays = round(width / style.bay_m)
    rows = _rows(width, bays, np.array([0.0, height]), ground, front, rng)
    if not front or width < 2.5:
        return rows
    # Between two windows: on the pier in the middle, or at the side of the only one.
    bay = width / max(bays, 1)
    u = bay * (bays // 2) if bays > 1 else 0.65
    return joined([rows, _door(u, min(0.5, bay * (1 - ground.window_share) / 2 - 0.05), height, style, rng)])


def _door(u: float, half: float, height: float, style: Style, rng: np.random.Generator) -> Quads:
    half, top = max(half, 0.35), min(2.25, height - 0.4)
    leaf = Skin("wood", _DOORS[int(rng.integers(len(_DOORS)))])
    return joined([
        upright(u - half - 0.1, u + half + 0.1, 0.0, top + 0.1, 0.02, style.trim),
        upright(u - half, u + half, 0.0, top, 0.04, leaf),
        upright(u - half * 0.55, u + half * 0.55, top * 0.55, top * 0.9, 0.05, Skin("window", (0.03, 0.035, 0.04))),
    ])  # fmt: skip


def _shops(width: float, height: float, style: Style, rng: np.random.Generator) -> Quads:
    """Show windows below a name board; every third bay or so is a door."""
    bays = max(1, round(width / 4.2))
    bay = width / bays
    start, head = np.arange(bays) * bay, height - 1.15
    u0, u1 = start + 0.25, start + bay - 0.25
    left, right = np.append(0.0, u1), np.append(u0, width)
    is_door = rng.random(bays) < 0.35
    shop = replace(style, wall=style.base, panes=2, lit_share=0.6)
    v0 = np.where(is_door, 0.06, 0.5)
    parts = [
        upright(left, right, 0.0, head, 0.0, style.base),
        upright(u0, u1, 0.0, v0, 0.0, style.base),
        upright(0.0, width, head, height, 0.0, style.base),
        windows(u0, u1, v0, np.full(bays, head), shop, rng),
    ]
    colors = np.asarray(SHOP_COLORS)[rng.integers(len(SHOP_COLORS), size=bays)]
    boards = upright(start + 0.12, start + bay - 0.12, head + 0.12, head + 0.75, 0.04, Skin("paint", (0, 0, 0)))
    parts.append(painted(boards, colors))
    wide = rng.uniform(0.2, 0.38, bays) * bay
    letters = upright(start + bay / 2 - wide, start + bay / 2 + wide, head + 0.3, head + 0.56, 0.06,
                      Skin("paint", (0.7, 0.68, 0.62)))  # fmt: skip
    parts.append(letters if colors.mean() < 0.3 else painted(letters, np.full((bays, 3), 0.05)))
    if style.awnings:
        parts.append(_awnings(start + 0.1, start + bay - 0.1, head + 0.05, colors))
    return joined(parts)


def _awnings(u0: Array, u1: Array, top: float, colors: Array) -> Quads:
    """Cloth that slopes down from the wall, of two layers, so that it is seen from below as well."""
    flat = upright(u0, u1, top - 0.55, top, _OUT_M, Skin("cloth", (0, 0, 0)))
    corners = flat.corners_m.copy()
    corners[:, 2:, 2] = 0.02
    under = corners[:, ::-1] - np.array([0.0, 0.015, 0.0])
    lip = upright(u0, u1, top - 0.75, top - 0.55, _OUT_M, Skin("cloth", (0, 0, 0)))
    both = Quads(np.concatenate([corners, under, lip.corners_m, lip.corners_m[:, ::-1] - np.array([0.0, 0.0, 0.01])]),
                 np.tile(flat.material, 4), np.tile(flat.color, (4, 1)))  # fmt: skip
    return painted(both, np.concatenate([colors, colors * 0.8, colors * 1.1, colors * 0.8]))


def _balconies(width: float, bays: int, floors: Float64, style: Style, rng: np.random.Generator) -> Quads:
    """Slabs with railings under some columns of windows."""
    bay = width / bays
    chosen = np.flatnonzero(rng.random(bays) < 0.45)
    v, column = np.repeat(floors, len(chosen)), np.tile(chosen, len(floors))
    u0, u1, out = (column + 0.06) * bay, (column + 0.94) * bay, _OUT_M
    rail = style.frame if rng.random() < 0.5 else style.trim
    top = v + 1.0
    return joined([
        blocks(u0, u1, v - 0.16, v, 0.0, out, style.trim, back=False),
        blocks(u0, u1, v + 0.1, top, out - 0.05, out, rail),
        blocks(u0, u0 + 0.05, v + 0.1, top, 0.0, out - 0.05, rail),
        blocks(u1 - 0.05, u1, v + 0.1, top, 0.0, out - 0.05, rail),
    ])  # fmt: skip


def _hall(width: float, height: float, style: Style, front: bool, rng: np.random.Generator) -> Quads:
    """A works: clad walls with joints, a band of windows below the eaves, gates."""
    bays = max(1, round(width / 6.0))
    pitch = width / bays
    start = np.arange(bays) * pitch
    v0 = max(height - 2.2, height * 0.6)
    v1 = v0 + 1.0
    left, right = np.append(0.0, start + pitch - 0.6), np.append(start + 0.6, width)
    parts = [
        _wall(width, 0.0, v0, style.wall),
        _wall(width, v1, height, style.wall),
        upright(left, right, v0, v1, 0.0, style.wall),
        windows(start + 0.6, start + pitch - 0.6, np.full(bays, v0), np.full(bays, v1), style, rng),
        blocks(start[1:] - 0.06, start[1:] + 0.06, 0.0, height, 0.0, 0.05, style.trim, back=False),
    ]
    gates = start[rng.random(bays) < (0.5 if front else 0.15)] + pitch / 2
    top = min(4.2, v0 - 0.4)
    parts.append(upright(gates - 1.9, gates + 1.9, 0.0, top + 0.15, 0.03, style.trim))
    parts.append(upright(gates - 1.75, gates + 1.75, 0.0, top, 0.06, Skin("metal", (0.25, 0.27, 0.29))))
    return joined(parts)
