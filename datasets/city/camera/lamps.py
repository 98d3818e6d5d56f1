"""Lamps that light the scene by night: street lamps and headlights."""

import math
from typing import NamedTuple

import numpy as np

from fbench.datasets.city.actor import Actor
from fbench.datasets.city.camera.light import DAYLIGHT_LUX, Light
from fbench.datasets.city.camera.near import Grid, cell_of, grid_around
from fbench.datasets.city.camera.samples import HitArrays
from fbench.datasets.city.motion import EGO, BodyStates
from fbench.datasets.city.rays.hits import MISS
from fbench.replay.arrays import Array, Float64
from fbench.replay.data import VEHICLES
from fbench.replay.kernels import kernel

_STREET_CD, _STREET_REACH_M = 1_800.0, 20.0
"""Some 25 lx below a lamp of 8 m."""
_BEAM_CD, _BEAM_REACH_M = 14_000.0, 50.0
"""A low beam at its brightest, of two lamps together; UN R112 has 10,000 to 20,000 cd a lamp below the cut-off."""
_BEAM_HEIGHT_M = 0.7
_CONE_END = 0.2
"""Cosine of the angle from below at which the cone of street lamps ends."""
_WIDEST = 0.75
"""Tangent of the angle to the side at which beams end."""
_BEAM_DISC_M = 0.5 * _BEAM_REACH_M * (1 + _WIDEST * _WIDEST)
"""Radius of the disc around a beam, whose middle is as far ahead of the lamps."""
_AT_WIDEST = math.exp(-6 * _WIDEST * _WIDEST)


class Lamps(NamedTuple):
    """L lamps."""

    position_m: Float64
    """(L, 3) in the world."""
    heading: Float64
    """(L, 2) unit vectors where a beam goes; 0 for street lamps, which shine downwards."""
    near: Grid


def lamps_of(actors: tuple[Actor, ...], states: BodyStates, street_lamps_m: Float64, light: Light) -> Lamps:
    """Return what shines at an instant: nothing by day."""
    street = street_lamps_m if light.is_dark else np.zeros((0, 3))
    drives = [a.body.label in VEHICLES and not a.parked for a in actors]
    cars = np.flatnonzero(np.array(drives, bool)) if light.is_dark else np.zeros(0, np.int64)
    length = np.array([actors[i].body.size_lwh_m[0] for i in cars])
    heading = np.stack([np.cos(states.yaw_rad[cars]), np.sin(states.yaw_rad[cars])], axis=1)
    front = np.column_stack([states.position_m[cars, :2] + heading * (length / 2)[:, None],
                             states.position_m[cars, 2] + _BEAM_HEIGHT_M])  # fmt: skip
    position = np.concatenate([street, front])
    middle = position[:, :2] + np.concatenate([np.zeros((len(street), 2)), heading * _BEAM_DISC_M])
    radius = np.repeat([_STREET_REACH_M, _BEAM_DISC_M], [len(street), len(cars)])
    ego = states.position_m[EGO]
    near = grid_around(float(ego[0]), float(ego[1]), middle, radius)
    return Lamps(position, np.concatenate([np.zeros((len(street), 2)), heading]), near)


@kernel
def add_lamplight(light_on: Array, hits: HitArrays, origin: Array, lamps: Lamps) -> None:
    """Add the illuminance by lamps to that of all hits (N, 3), in units of daylight."""
    range_m, body, direction, normal = hits.range_m, hits.body, hits.direction, hits.normal
    position, heading, start, items = lamps.position_m, lamps.heading, lamps.near.start, lamps.near.items
    x_m, y_m = lamps.near.x_m, lamps.near.y_m
    for i in range(len(body)):
        if body[i] == MISS:
            continue
        r = float(range_m[i])
        x, y, z = origin[0] + r * direction[i, 0], origin[1] + r * direction[i, 1], origin[2] + r * direction[i, 2]
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        cell, red, green, blue = cell_of(x_m, y_m, x, y), 0.0, 0.0, 0.0
        for k in range(start[cell], start[cell + 1] if cell >= 0 else start[cell]):
            n = items[k]
            dx, dy, dz = position[n, 0] - x, position[n, 1] - y, position[n, 2] - z
            facing, distance2 = dx * nx + dy * ny + dz * nz, dx * dx + dy * dy + dz * dz + 0.05
            if facing <= 0:
                continue
            hx, hy = heading[n, 0], heading[n, 1]
            if hx == 0 and hy == 0:
                level = _street(dz, distance2) * facing
                red, green, blue = red + 1.25 * level, green + 0.95 * level, blue + 0.58 * level
            else:
                level = _beam(dx, dy, dz, hx, hy, distance2) * facing
                red, green, blue = red + level, green + 0.97 * level, blue + 0.88 * level
        light_on[i, 0] += red
        light_on[i, 1] += green
        light_on[i, 2] += blue


@kernel
def _street(dz: float, distance2: float) -> float:
    """Illuminance by a street lamp `dz` above, divided by its distance squared, of a plane at a right angle to the
    vector towards it: with a cone that ends at some 75 degrees, and no step at its reach.
    """
    if dz <= 0 or dz * dz <= _CONE_END * _CONE_END * distance2 or distance2 >= _STREET_REACH_M * _STREET_REACH_M:
        return 0.0
    distance = math.sqrt(distance2)
    cone = min(1.0, (dz / distance - _CONE_END) / 0.25)
    end = min(1.0, 4 * (1 - distance / _STREET_REACH_M))
    return float(_STREET_CD / DAYLIGHT_LUX * cone * end / (distance2 * distance))


@kernel
def _beam(dx: float, dy: float, dz: float, hx: float, hy: float, distance2: float) -> float:
    """The same of low beams from which a point is seen at (dx, dy, dz): a cut-off 1 % below the horizon, little light
    far below it, so that the road is lit evenly, and wide to the sides.
    """
    ahead = -(dx * hx + dy * hy)
    side = dx * hy - dy * hx
    if ahead <= 0.3 or abs(side) >= _WIDEST * ahead or ahead >= _BEAM_REACH_M:
        return 0.0
    aside, below = side / ahead, dz / ahead
    over = 0.02 + 0.98 * min(1.0, max(0.0, (below + 0.004) / 0.018))
    end = min(1.0, 4 * (1 - ahead / _BEAM_REACH_M))
    shape = (math.exp(-6 * aside * aside) - _AT_WIDEST) * math.exp(-7 * max(below, 0.0))
    return float(_BEAM_CD / DAYLIGHT_LUX * over * shape * end / (distance2 * math.sqrt(distance2)))
