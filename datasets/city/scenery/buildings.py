"""Buildings: facades with windows, doors, shop fronts and balconies, in styles drawn from a seed."""

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from fbench.datasets.city.mesh import INDEX, Mesh, Rgb, Skin, Three, box, merge_meshes, mesh, scale_color
from fbench.datasets.city.scenery.quads import Quads, above, below, blocks, join_quads, leftward, rightward, upright
from fbench.replay.data.arrays import Array, Float64

Use: TypeAlias = Literal["house", "flats", "office", "hall"]
_WALLS: tuple[tuple[str, Rgb], ...] = (
    ("brick", (0.25, 0.105, 0.07)), ("brick", (0.20, 0.085, 0.06)), ("brick", (0.32, 0.20, 0.13)),
    ("plaster", (0.62, 0.58, 0.50)), ("plaster", (0.55, 0.47, 0.34)), ("plaster", (0.50, 0.50, 0.49)),
    ("plaster", (0.50, 0.34, 0.26)), ("plaster", (0.42, 0.46, 0.47)), ("plaster", (0.66, 0.64, 0.60)),
    ("concrete", (0.36, 0.35, 0.33)),
)  # fmt: skip
_OFFICE_WALLS: tuple[tuple[str, Rgb], ...] = (
    ("concrete", (0.36, 0.35, 0.34)), ("concrete", (0.45, 0.44, 0.42)), ("plaster", (0.58, 0.57, 0.55)),
    ("concrete", (0.22, 0.22, 0.23)), ("brick", (0.22, 0.10, 0.07)),
)  # fmt: skip
_HALL_WALLS: tuple[tuple[str, Rgb], ...] = (
    ("concrete", (0.48, 0.49, 0.50)), ("concrete", (0.30, 0.34, 0.40)), ("plaster", (0.58, 0.57, 0.53)),
)  # fmt: skip
_ROOFS: tuple[Rgb, ...] = ((0.22, 0.09, 0.06), (0.15, 0.07, 0.05), (0.10, 0.10, 0.105), (0.16, 0.14, 0.13))
SHOP_COLORS: tuple[Rgb, ...] = (
    (0.35, 0.04, 0.04), (0.04, 0.10, 0.26), (0.04, 0.18, 0.09), (0.45, 0.26, 0.05), (0.06, 0.06, 0.065),
    (0.55, 0.53, 0.48), (0.10, 0.22, 0.24),
)  # fmt: skip
"""Of shops' name boards and awnings."""


@dataclass(frozen=True)
class Style:
    """How walls, windows and roof of one building are made."""

    use: Use
    wall: Skin
    base: Skin  # The ground floor's walls
    trim: Skin  # Cornices, sills, balconies
    frame: Skin
    roof: Skin
    storey_m: float
    ground_m: float  # Height of the ground floor
    bay_m: float  # About how far apart windows are
    window_share: float  # A window's width, of its bay
    window_m: float  # A window's height
    sill_m: float  # Its height above the floor
    panes: int
    lit_share: float
    shop: bool
    awnings: bool
    balconies: bool
    pitched: bool


def draw_style(size_lwh_m: Three, rng: np.random.Generator) -> Style:
    """Draw how a building of a size looks."""
    length, width, height = size_lwh_m
    use: Use
    if height < 14 and min(length, width) > 22:
        use = "hall"
    elif height < 9.5:
        use = "house"
    else:
        use = "office" if rng.random() < (0.75 if height > 21 else 0.25) else "flats"
    palette = {"office": _OFFICE_WALLS, "hall": _HALL_WALLS}.get(use, _WALLS)
    material, color = palette[int(rng.integers(len(palette)))]
    wall = Skin(material, scale_color(color, float(rng.uniform(0.85, 1.12))))
    pale = float(rng.uniform(0.45, 0.68))
    dark_frames = rng.random() < (0.7 if use == "office" else 0.35)
    shop = use in ("flats", "office") and bool(rng.random() < 0.6)
    awnings = shop and use == "flats" and bool(rng.random() < 0.6)
    ribbon = use == "office" and rng.random() < 0.6
    return Style(
        use=use,
        wall=wall,
        base=Skin("concrete", scale_color(color, 0.7)) if rng.random() < 0.4 else wall,
        trim=Skin("concrete", (pale, pale, pale * 0.96)),
        frame=Skin("plastic", (0.045, 0.045, 0.05) if dark_frames else (0.66, 0.66, 0.64)),
        roof=Skin("roof", _ROOFS[int(rng.integers(len(_ROOFS)))]),
        storey_m=float(rng.uniform(3.0, 3.4)),
        ground_m=float(rng.uniform(3.9, 4.5)) if shop else 3.1,
        bay_m=float(rng.uniform(3.0, 3.8) if use == "office" else rng.uniform(2.5, 3.3)),
        window_share=0.94 if ribbon else float(rng.uniform(0.40, 0.55)),
        window_m=float(rng.uniform(1.7, 2.0) if ribbon else rng.uniform(1.4, 1.75)),
        sill_m=0.9,
        panes=int(rng.integers(1, 3)),
        lit_share=float(rng.uniform(0.1, 0.4)),
        shop=shop,
        awnings=awnings,
        balconies=use == "flats" and bool(rng.random() < 0.5),
        pitched=use == "house" or (use == "flats" and height < 16 and bool(rng.random() < 0.4)),
    )


_RECESS_M, _FRAME_M = 0.12, 0.07  # How deep windows lie in the wall; width of their frames
_PANE = Skin("window", (0.03, 0.035, 0.04))
_OUT_M = 0.8  # How far balconies and awnings stand out
_LIT: tuple[Rgb, ...] = ((0.30, 0.21, 0.12), (0.30, 0.24, 0.16), (0.27, 0.27, 0.25))
"""Colors of rooms behind lit windows: by day they are curtains, so not too bright."""
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
    return join_quads(parts)


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
        return join_quads([wall, frames, _panes(*openings, 0.04, style, rng)])
    bands = upright(0.0, width, np.append(floors[0], v1), np.append(v0, floors[-1]), 0.0, style.wall)
    left, right = np.append(0.0, middle + half), np.append(middle - half, width)
    rows, columns = np.repeat(np.arange(len(v0)), bays + 1), np.tile(np.arange(bays + 1), len(v0))
    piers = upright(left[columns], right[columns], v0[rows], v1[rows], 0.0, style.wall)
    return join_quads([bands, piers, windows(*openings, style, rng)])


def windows(u0: Array, u1: Array, v0: Array, v1: Array, style: Style, rng: np.random.Generator) -> Quads:
    """Return what fills openings of a wall: reveals, frames and panes, some lit, some with curtains."""
    d = -_RECESS_M
    reveal = replace(style.wall, color=scale_color(style.wall.color, 0.85))
    sides = [
        above(u0, u1, d, 0.0, v0, style.trim),
        below(u0, u1, d, 0.0, v1, reveal),
        rightward(v0, v1, d, 0.0, u0, reveal),
        leftward(v0, v1, d, 0.0, u1, reveal),
    ]
    return join_quads([*sides, upright(u0, u1, v0, v1, d, style.frame), _panes(u0, u1, v0, v1, d + 0.02, style, rng)])


def _panes(u0: Array, u1: Array, v0: Array, v1: Array, d: float, style: Style, rng: np.random.Generator) -> Quads:
    num, panes = len(u0), style.panes
    pitch = (u1 - u0 - _FRAME_M) / panes
    starts = (u0 + _FRAME_M)[:, None] + pitch[:, None] * np.arange(panes)
    ends = starts + pitch[:, None] - _FRAME_M
    low, high = np.repeat(v0 + _FRAME_M, panes), np.repeat(v1 - _FRAME_M, panes)
    quads = upright(starts.ravel(), ends.ravel(), low, high, d, _PANE)
    lit = rng.random(num) < style.lit_share
    shade = np.where(rng.random(num) < 0.3, rng.uniform(0.08, 0.25, num), rng.uniform(0.015, 0.05, num))
    glass = shade[:, None] * np.array([0.93, 1.0, 1.05])
    color = np.where(lit[:, None], np.asarray(_LIT)[rng.integers(len(_LIT), size=num)], glass)
    material = np.where(lit, INDEX["lit_window"], INDEX["window"]).astype(np.uint8)
    return replace(quads.paint(np.repeat(color, panes, axis=0)), material=np.repeat(material, panes))


def _ground_floor(width: float, height: float, style: Style, front: bool, rng: np.random.Generator) -> Quads:
    if front and style.shop and width > 4:
        return _shops(width, height, style, rng)
    ground = replace(style, wall=style.base, window_share=min(style.window_share, 0.6), sill_m=1.0)
    bays = round(width / style.bay_m)
    rows = _rows(width, bays, np.array([0.0, height]), ground, front, rng)
    if not front or width < 2.5:
        return rows
    bay = width / max(bays, 1)
    u = bay * (bays // 2) if bays > 1 else 0.65  # between two windows: on the middle pier, or beside the only one
    half, top = max(min(0.5, bay * (1 - ground.window_share) / 2 - 0.05), 0.35), min(2.25, height - 0.4)
    leaf = Skin("wood", _DOORS[int(rng.integers(len(_DOORS)))])
    return join_quads([
        rows,
        upright(u - half - 0.1, u + half + 0.1, 0.0, top + 0.1, 0.02, style.trim),
        upright(u - half, u + half, 0.0, top, 0.04, leaf),
        upright(u - half * 0.55, u + half * 0.55, top * 0.55, top * 0.9, 0.05, _PANE),
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
    parts.append(boards.paint(colors))
    wide = rng.uniform(0.2, 0.38, bays) * bay
    light, middle = Skin("paint", (0.7, 0.68, 0.62)), start + bay / 2
    letters = upright(middle - wide, middle + wide, head + 0.3, head + 0.56, 0.06, light)
    parts.append(letters if colors.mean() < 0.3 else letters.paint(np.full((bays, 3), 0.05)))
    if style.awnings:
        parts.append(_awnings(start + 0.1, start + bay - 0.1, head + 0.05, colors))
    return join_quads(parts)


def _awnings(u0: Array, u1: Array, top: float, colors: Array) -> Quads:
    """Cloth that slopes down from the wall, of two layers, so that it is seen from below as well."""
    flat = upright(u0, u1, top - 0.55, top, _OUT_M, Skin("cloth", (0, 0, 0)))
    corners = flat.corners_m.copy()
    corners[:, 2:, 2] = 0.02
    under = corners[:, ::-1] - np.array([0.0, 0.015, 0.0])
    lip = upright(u0, u1, top - 0.75, top - 0.55, _OUT_M, Skin("cloth", (0, 0, 0)))
    layers = [corners, under, lip.corners_m, lip.corners_m[:, ::-1] - np.array([0.0, 0.0, 0.01])]
    shades = np.concatenate([colors, colors * 0.8, colors * 1.1, colors * 0.8]).astype(np.float32)
    return Quads(np.concatenate(layers), np.tile(flat.material, 4), shades)


def _balconies(width: float, bays: int, floors: Float64, style: Style, rng: np.random.Generator) -> Quads:
    """Slabs with railings under some columns of windows."""
    bay = width / bays
    chosen = np.flatnonzero(rng.random(bays) < 0.45)
    v, column = np.repeat(floors, len(chosen)), np.tile(chosen, len(floors))
    u0, u1, out = (column + 0.06) * bay, (column + 0.94) * bay, _OUT_M
    rail = style.frame if rng.random() < 0.5 else style.trim
    top = v + 1.0
    return join_quads([
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
    v1, top = v0 + 1.0, min(4.2, v0 - 0.4)
    left, right = np.append(0.0, start + pitch - 0.6), np.append(start + 0.6, width)
    parts = [
        _wall(width, 0.0, v0, style.wall),
        _wall(width, v1, height, style.wall),
        upright(left, right, v0, v1, 0.0, style.wall),
        windows(start + 0.6, start + pitch - 0.6, np.full(bays, v0), np.full(bays, v1), style, rng),
        blocks(start[1:] - 0.06, start[1:] + 0.06, 0.0, height, 0.0, 0.05, style.trim, back=False),
    ]
    gates = start[rng.random(bays) < (0.5 if front else 0.15)] + pitch / 2
    parts.append(upright(gates - 1.9, gates + 1.9, 0.0, top + 0.15, 0.03, style.trim))
    parts.append(upright(gates - 1.75, gates + 1.75, 0.0, top, 0.06, Skin("metal", (0.25, 0.27, 0.29))))
    return join_quads(parts)


_INSET_M = 0.12  # Walls stand back from the box by this much: cornice and step fill it
_DEEP_INSET_M = 0.85  # The front's, where balconies or awnings stand out


def building(size_lwh_m: Three, rng: np.random.Generator) -> Mesh:
    """Return a building in its own coordinates: front towards x, origin in the middle of its foot."""
    length, width, height = size_lwh_m
    style = draw_style(size_lwh_m, rng)
    if length < 6:
        style = replace(style, balconies=False, awnings=False)
    front = _DEEP_INSET_M if style.awnings or style.balconies else _INSET_M
    core = np.array([-length / 2 + _INSET_M, length / 2 - front, -width / 2 + _INSET_M, width / 2 - _INSET_M])
    x0, x1, y0, y1 = core.tolist()
    has_shed = not style.pitched and height > 9 and bool(rng.random() < 0.6)
    rise = min(0.32 * min(length, width), 0.4 * height) if style.pitched else 2.2 if has_shed else 0.0
    eaves, sides = height - rise, []
    for k, foot in enumerate([(x1, y0), (x1, y1), (x0, y1), (x0, y0)]):  # front, left, back, right
        wall = facade(x1 - x0 if k % 2 else y1 - y0, eaves, style, k == 0, rng)
        sides.append(wall.on_wall(k * np.pi / 2, (*foot, 0.0)))
    parts = [join_quads(sides).mesh(), box((0.0, 0.0, 0.04), (length, width, 0.08), style.trim)]
    parts += _gable(core, eaves, height, style, rng) if style.pitched else _flat_roof(x0, x1, y0, y1, eaves, style)
    if has_shed:  # houses the lift
        size = (min(4.0, 0.4 * (x1 - x0)), min(5.0, 0.4 * (y1 - y0)), height - eaves + 0.5)
        middle = ((x0 + x1) / 2, (y0 + y1) / 2 + 0.2 * (y1 - y0), height - size[2] / 2)
        parts.append(box(middle, size, style.wall))
    return merge_meshes(parts)


def _flat_roof(x0: float, x1: float, y0: float, y1: float, eaves: float, style: Style) -> list[Mesh]:
    """A roof below a parapet, which is a cornice as well."""
    high, outer, thick = 0.5, _INSET_M, _INSET_M + 0.25
    z = eaves - high / 2
    xm, ym, long, wide = (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0 + 2 * outer, y1 - y0 + 2 * outer
    top = above(y0, y1, x0, x1, eaves - high + 0.1, Skin("concrete", (0.2, 0.2, 0.2)))
    return [
        box((x1 + outer - thick / 2, ym, z), (thick, wide, high), style.trim),
        box((x0 - outer + thick / 2, ym, z), (thick, wide, high), style.trim),
        box((xm, y1 + outer - thick / 2, z), (long - 2 * thick, thick, high), style.trim),
        box((xm, y0 - outer + thick / 2, z), (long - 2 * thick, thick, high), style.trim),
        top.on_wall(0.0).mesh(),
    ]


def _gable(core: Float64, eaves: float, height: float, style: Style, rng: np.random.Generator) -> list[Mesh]:
    """A pitched roof along the longer side, with a chimney up to the building's height."""
    x0, x1, y0, y1 = (core + np.array([-1, 1, -1, 1]) * _INSET_M).tolist()
    ridge = height - 0.6
    xm, ym = (x0 + x1) / 2, (y0 + y1) / 2
    corners = [(x0, y0, eaves), (x1, y0, eaves), (x1, y1, eaves), (x0, y1, eaves)]
    if y1 - y0 > x1 - x0:
        vertices = np.array([*corners, (xm, y0, ridge), (xm, y1, ridge)])
        slopes, ends = [[1, 2, 5], [1, 5, 4], [3, 0, 4], [3, 4, 5]], [[0, 1, 4], [2, 3, 5]]
    else:
        vertices = np.array([*corners, (x0, ym, ridge), (x1, ym, ridge)])
        slopes, ends = [[0, 1, 5], [0, 5, 4], [2, 3, 4], [2, 4, 5]], [[1, 2, 5], [3, 0, 4]]
    along = float(rng.uniform(-0.3, 0.3))
    chimney = box((xm + along * (x1 - x0) * 0.6, ym + along * (y1 - y0) * 0.6, (eaves + height) / 2),
                  (0.6, 0.7, height - eaves), Skin("brick", (0.2, 0.09, 0.06)))  # fmt: skip
    surfaces = (slopes, style.roof), (ends, style.wall), ([[0, 3, 2], [0, 2, 1]], style.trim)
    return [*(mesh(vertices, np.array(triangles), skin) for triangles, skin in surfaces), chimney]
