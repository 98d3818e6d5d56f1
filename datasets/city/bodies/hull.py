"""A vehicle's hull with windows and arches, and its parts: lamps, plates, mirrors, handles, wheels."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fbench.datasets.city.bodies.palette import BLACK, GLASS, LINE, PLATE, TYRE, linear
from fbench.datasets.city.bodies.shell import both, mirror, shell, skin_surface
from fbench.datasets.city.instant import BRAKE, HEAD, TAIL
from fbench.datasets.city.mesh import Mesh, Skin, Three, box, merge_meshes, quad, shift
from fbench.replay.data.arrays import Float64

Pair = tuple[float, float]
Knots = tuple[Pair, ...]
_LEAST_STEP_M: Final = 0.03
_ARCH_DEG: Final = np.array([0.0, 32, 68, 112, 148, 180])


@dataclass(frozen=True)
class Profile:
    """A hull; distances `s` run back from the nose [m], heights from the ground [m]."""

    length_m: float
    width_m: float
    top: Knots  # Height of the center line over s, from nose to tail: bonnet, windscreen, roof, rear window, boot
    belt: Knots  # Height of the windows' lower edge over s; follows the top where that is lower
    plan: Knots  # Share of the width over s: rounded corners
    sill_m: float  # Ground clearance
    mid_m: float  # Height where it is widest
    tumblehome: float  # How far the sides lean in above the belt, per meter of height
    windscreen: Pair  # From s to s, where the top is glass
    rear_window: Pair
    windows: Knots  # From s to s, where the sides are glass; pillars lie between them
    axles: tuple[float, ...]  # s of the wheels' middles that have arches
    wheel_radius_m: float
    crown_m: float = 0.045  # How much higher the middle is than the edges
    rail_m: float = 0.07  # Height of the frame above the side windows
    pillar_m: float = 0.07  # Width of the frame beside the windscreen
    arch_m: float = 0.055  # Gap between tire and arch


HEADLIGHT = Skin("headlight", linear("eef0ea"), HEAD)
TAILLIGHT = Skin("taillight", linear("9c1116"), TAIL)
BRAKELIGHT = Skin("taillight", linear("b8161b"), BRAKE)
TURN = Skin("plastic", linear("c8641a"))
_PLATE_M = (0.52, 0.11)  # Width and height of a European licence plate (520 mm x 110 mm)
_PAINT, _GLASS, _BLACK, _SKIRT = range(4)
_WINDOW, _SCREEN = 2, 5
"""Cells of the left half between belt and window's top, and between the pillar's edge and the middle."""
_PROUD_M: Final = 0.006  # How far what is put on the surface stands out


@dataclass(frozen=True, eq=False)
class Hull:
    """A hull whose nose is at x = length / 2, by its cross-sections at stations from tail to nose, and what is put on
    it.
    """

    profile: Profile
    s_m: Float64  # (S,) falling
    half_m: Float64
    """(S, 7, 2) y and z of the left half: sill, widest, belt, window's top, roof's edge, pillar's edge, middle."""

    def mesh(self, paint: Skin, skirt: Skin | None = None) -> Mesh:
        """Return the surface; `skirt` is the skin of its lowest part."""
        p, middle = self.profile, (self.s_m[:-1] + self.s_m[1:]) / 2
        ring = np.concatenate([self.half_m, self.half_m[:, -2::-1] * np.array([-1.0, 1])], axis=1)
        x = np.broadcast_to((p.length_m / 2 - self.s_m)[:, None, None], (*ring.shape[:2], 1))
        cells = np.full((len(middle), 6), _PAINT)
        panes = [*((_WINDOW, pair) for pair in p.windows), (_SCREEN, p.windscreen), (_SCREEN, p.rear_window)]
        for cell, (start, end) in panes:
            cells[(middle > start) & (middle < end), cell] = _GLASS
        if skirt is not None:
            cells[:, 0] = _SKIRT
        cells = np.concatenate([cells, cells[:, ::-1], np.full((len(middle), 1), _BLACK)], axis=1)
        return shell(np.concatenate([x, ring], axis=2), cells, [paint, GLASS, BLACK, skirt or paint])

    def side(self, s_m: Pair, z_m: Pair, skin: Skin, proud_m: float = _PROUD_M) -> Mesh:
        """Put a patch on both sides, from s to s and from height to height; it follows the surface."""
        return both(self.left(s_m, z_m, skin, proud_m))

    def left(self, s_m: Pair, z_m: Pair, skin: Skin, proud_m: float = _PROUD_M) -> Mesh:
        """Put a patch on the left side only."""
        x, mid = self.profile.length_m / 2, self.profile.mid_m
        s = np.array([s_m[1], *self.s_m[(self.s_m > s_m[0] + 1e-3) & (self.s_m < s_m[1] - 1e-3)], s_m[0]])
        z = np.array([z_m[0], mid, z_m[1]] if z_m[0] + 0.02 < mid < z_m[1] - 0.02 else z_m)
        outline = self._outline(s)
        half = np.concatenate([np.interp(z, line[:, 1], line[:, 0]) for line in outline])
        points = np.column_stack([np.repeat(x - s, len(z)), half + proud_m, np.tile(z, len(s))])
        rows = len(z)
        i = (np.arange(len(s) - 1)[:, None] * rows + np.arange(rows - 1)).ravel()
        tri = np.stack([i, i + 1, i + rows + 1, i, i + rows + 1, i + rows], axis=1).reshape(-1, 3)
        return skin_surface(points, tri, np.zeros(len(tri), int), [skin])

    def _outline(self, at_m: Float64) -> Float64:
        """Return y and z (N, 5, 2) of the left half, up to the roof's edge, at distances (N,) from the nose."""
        s, half = self.s_m[::-1], self.half_m[::-1, :5]
        i = np.clip(np.searchsorted(s, at_m, side="right") - 1, 0, len(s) - 2)
        share = ((at_m - s[i]) / (s[i + 1] - s[i]))[:, None, None]
        return np.asarray(half[i] * (1 - share) + half[i + 1] * share, np.float64)

    def front(self, y_m: Pair, z_m: Pair, skin: Skin, proud_m: float = _PROUD_M) -> Mesh:
        """Put a patch on the flat of the nose, from y to y and from height to height."""
        x, (y0, y1), (z0, z1) = self.profile.length_m / 2 + proud_m, y_m, z_m
        return quad(np.array([(x, y0, z0), (x, y1, z0), (x, y1, z1), (x, y0, z1)]), skin)

    def rear(self, y_m: Pair, z_m: Pair, skin: Skin, proud_m: float = _PROUD_M) -> Mesh:
        """Put a patch on the flat of the tail."""
        x, (y0, y1), (z0, z1) = -self.profile.length_m / 2 - proud_m, y_m, z_m
        return quad(np.array([(x, y1, z0), (x, y0, z0), (x, y0, z1), (x, y1, z1)]), skin)

    def flat_half_m(self, at_nose: bool) -> float:
        """Half the width of the flat of nose or tail."""
        return float(self.half_m[-1 if at_nose else 0, 2, 0])

    def headlights(self, z_m: Pair, inner: float, back_m: float) -> list[Mesh]:
        """Put headlights on the nose's outer part, from `inner` of its half width, and around its corners."""
        half = self.flat_half_m(at_nose=True)
        frame = self.front((inner * half - 0.02, half), (z_m[0] - 0.02, z_m[1] + 0.015), LINE, 0.009)
        front = self.front((inner * half, 0.99 * half), z_m, HEADLIGHT, 0.013)
        return [both(frame), both(front), self.side((0.0, back_m), (z_m[0] + 0.02, z_m[1]), HEADLIGHT, 0.013)]

    def tail_lamps(self, z_m: Pair, inner: float, round_m: float) -> list[Mesh]:
        """Put tail lights and, in their upper part, brake lights on the tail's outer part and around its corners."""
        half, length = self.flat_half_m(at_nose=False), self.profile.length_m
        z = 0.45 * z_m[0] + 0.55 * z_m[1]
        lamps = ((z_m[0], z), TAILLIGHT), ((z, z_m[1]), BRAKELIGHT)
        parts = [both(self.rear((inner * half, 0.99 * half), rows, skin)) for rows, skin in lamps]
        return [*parts, self.side((length - round_m, length), z_m, TAILLIGHT)]

    def door_lines(self, at_m: tuple[float, ...], z_m: Pair) -> list[Mesh]:
        """Draw the gaps between doors and wings: thin dark lines from height to height."""
        return [self.side((s, s + 0.018), z_m, LINE, 0.004) for s in at_m]

    def handles(self, at_m: tuple[float, ...], z_m: float, skin: Skin) -> list[Mesh]:
        """Put handles on the doors."""
        return [self.side((s, s + 0.19), (z_m, z_m + 0.035), skin, 0.022) for s in at_m]

    def underbody(self, inner_m: float, top_m: float) -> Mesh:
        """Fill the hull between the wheels, so that nobody sees through its arches."""
        low, size = self.profile.sill_m, (self.profile.length_m - 0.3, 2 * inner_m, top_m - self.profile.sill_m)
        return box((0.0, 0.0, (low + top_m) / 2 + 0.01), size, BLACK)

    def grille(self, half_m: float, z_m: Pair, bars: int, skin: Skin) -> Mesh:
        """Put a dark grille with bars on the nose."""
        step, y = (z_m[1] - z_m[0]) / (bars + 1), (-half_m, half_m)
        middles = [z_m[0] + (i + 1) * step for i in range(bars)]
        return merge_meshes(
            [self.front(y, z_m, LINE), *(self.front(y, (z - 0.008, z + 0.008), skin, 0.01) for z in middles)]
        )

    def wheels(self, outer_m: float, width_m: float, rim: Skin) -> list[Mesh]:
        """Return the wheels of all axles, whose outer sides are `outer_m` from the middle."""
        p = self.profile
        return [wheel for s in p.axles for wheel in axle(p.length_m / 2 - s, outer_m, p.wheel_radius_m, width_m, rim)]


def make_hull(profile: Profile) -> Hull:
    """Cut the hull wherever its outline bends."""
    radius = profile.wheel_radius_m + profile.arch_m
    arches = [axle + radius * np.cos(np.radians(_ARCH_DEG)) for axle in profile.axles]
    edges = [s for pair in (profile.windscreen, profile.rear_window, *profile.windows) for s in pair]
    every = np.sort(np.concatenate([np.array([s for s, _ in profile.top] + edges), *arches]))
    every = every[(every > _LEAST_STEP_M) & (every < profile.length_m - _LEAST_STEP_M)]
    every = every[np.concatenate([[True], np.diff(every) > _LEAST_STEP_M])]
    s = np.array([0.0, *every, profile.length_m])[::-1]
    bottom = np.full(len(s), profile.sill_m)
    for axle_s in profile.axles:
        inside = radius**2 - (s - axle_s) ** 2
        arch = np.where(inside > 1e-6, profile.wheel_radius_m + np.sqrt(np.maximum(inside, 0)), 0)
        bottom = np.maximum(bottom, arch)
    top, belt, plan = (np.interp(s, *np.array(knots).T) for knots in (profile.top, profile.belt, profile.plan))
    half, edge = profile.width_m / 2 * plan, top - profile.crown_m
    arched = bottom > profile.sill_m + 0.02
    belt = np.minimum(belt, edge - 0.03)
    mid = np.minimum(np.maximum(profile.mid_m, bottom + 0.06), belt - 0.05)
    share = np.clip((edge - belt) / 0.35, 0.15, 1)
    window = edge - profile.rail_m * share * np.minimum(1.0, (edge - belt) / (2 * profile.rail_m * share))
    side = half - 0.035
    inner = side - profile.tumblehome * (edge - belt) - 0.035
    rows = [
        (half - np.where(arched, 0.0, 0.035), np.minimum(bottom, mid - 0.03)), (half, mid), (side, belt),
        (side - profile.tumblehome * (window - belt) - 0.006, window), (inner, edge),
        (inner - profile.pillar_m, edge + 0.6 * profile.crown_m), (0 * s, top),
    ]  # fmt: skip
    return Hull(profile, s, np.stack([np.column_stack(row) for row in rows], axis=1))


def plate(x_m: float, z_m: float) -> Mesh:
    """Return a licence plate at `x_m`, which looks forward where that is positive."""
    return box((x_m, 0.0, z_m), (0.012, *_PLATE_M), PLATE)


def mirrors(x_m: float, y_m: float, z_m: float, size_lwh_m: Three, skin: Skin) -> Mesh:
    """Return mirrors on both sides, whose inner ends are at `y_m`; their glass looks back."""
    length, width, height = size_lwh_m
    ring = np.array([(-1.0, -1.0), (1, -1), (1, 1), (-1, 1)]) / 2
    rings = [np.column_stack([np.full(4, x), scale * ring * (width, height)])
             for x, scale in ((-0.5, 1.0), (0.1, 1.0), (0.5, 0.7))]  # fmt: skip
    left = shell(np.stack(rings) * np.array([length, 1, 1]), np.zeros((2, 4), int), [skin, GLASS], (1, 0))
    return both(shift(left, (x_m, y_m + width / 2, z_m)))


_SIDES, _RIM_SHARE = 15, 0.66  # Of the wheel's radius
_GAP: Final = 3  # Every so manyth sector of the rim is a gap between spokes


def wheel(radius_m: float, width_m: float, rim: Skin) -> Mesh:
    """Return a wheel that stands on the ground under the origin, its outer side towards +y."""
    angle = np.arange(_SIDES) * (2 * np.pi / _SIDES) - np.pi / 2
    half = width_m / 2
    rows = [(1.0, -half), (1.0, 0.8 * half), (_RIM_SHARE, half)]
    rings = np.stack([
        np.column_stack([-share * radius_m * np.cos(angle), np.full(_SIDES, y), share * radius_m * np.sin(angle)])
        for share, y in rows
    ])  # fmt: skip
    cells = np.zeros((len(rows) - 1, _SIDES), int)
    sectors = np.where(np.arange(_SIDES) % _GAP == 0, 2, 1)
    return shift(shell(rings, cells, [TYRE, rim, LINE, BLACK], (3, sectors)), (0.0, 0.0, radius_m))


def axle(x_m: float, outer_m: float, radius_m: float, width_m: float, rim: Skin) -> list[Mesh]:
    """Return the two wheels at `x_m` whose outer sides are `outer_m` from the middle."""
    left = shift(wheel(radius_m, width_m, rim), (x_m, outer_m - width_m / 2, 0.0))
    return [left, mirror(left)]
