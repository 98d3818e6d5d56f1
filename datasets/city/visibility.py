"""How much of each body can be seen from the ego vehicle, whatever sensors it carries."""

import numpy as np

from fbench.datasets.city.motion import EGO, BodyStates
from fbench.datasets.city.rays.hits import RayCaster, Rays
from fbench.replay.arrays import Array, Float32, Float64, Int64

EYE_M = 1.8
"""Height of the point above the ego vehicle's middle from which bodies are looked at."""
_GRID = 12
"""Rays across a body, in both directions."""


def visible_shares(caster: RayCaster, states: BodyStates, bodies: Int64, range_m: float) -> Float64:
    """Return the visible share (B,) of each of `bodies` (B,), 0 to 1, in clear air.

    Of the rays over a body's outline that would hit it if it were alone, the share that do; seen from `EYE_M` above
    the middle of the ego vehicle. A body that no ray of its grid hits counts as unseen.
    """
    if not len(bodies):
        return np.zeros(0)
    origin = states.position_m[EGO] + [0.0, 0.0, EYE_M]
    directions = np.concatenate([_rays_over(caster, states, int(i), origin) for i in bodies])
    owner = np.repeat(bodies, _GRID * _GRID)
    hits = caster.cast(Rays(origin[None], directions, range_m), states)
    alone = {body: rays[owner[rays] == body] for body, rays in hits.alone}
    return np.array([_share(hits.body, alone.get(int(i)), int(i)) for i in bodies])


def _share(hit: Array, rays: Int64 | None, body: int) -> float:
    return float((hit[rays] == body).mean()) if rays is not None and len(rays) else 0.0


def _rays_over(caster: RayCaster, states: BodyStates, i: int, origin: Float64) -> Float32:
    """Unit vectors (`_GRID` squared, 3) evenly over the angles that the box of body `i` takes."""
    length, width, height = caster.actors[i].body.size_lwh_m
    to_body, cos, sin = states.position_m[i] - origin, np.cos(states.yaw_rad[i]), np.sin(states.yaw_rad[i])
    x, y = _outermost(-cos * to_body[0] - sin * to_body[1], sin * to_body[0] - cos * to_body[1], length, width)
    x, y = x * cos - y * sin + to_body[0], x * sin + y * cos + to_body[1]
    heading = np.arctan2(to_body[1], to_body[0])
    azimuth = (np.arctan2(y, x) - heading + np.pi) % (2 * np.pi) - np.pi
    altitude = np.arctan2(to_body[2] + np.array([[0.0], [height]]), np.hypot(x, y))
    steps = (np.arange(_GRID) + 0.5) / _GRID
    across = heading + azimuth.min() + steps * (azimuth.max() - azimuth.min())
    up = altitude.min() + steps * (altitude.max() - altitude.min())
    a, e = np.meshgrid(across, up)
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    return rays.reshape(-1, 3).astype(np.float32)


def _outermost(x_m: float, y_m: float, length_m: float, width_m: float) -> tuple[Float64, Float64]:
    """Corners of a footprint, and its point nearest to (x, y), where its box looks tallest: (5,) each, in its axes."""
    x, y = length_m / 2, width_m / 2
    return np.array([-x, -x, x, x, np.clip(x_m, -x, x)]), np.array([-y, y, -y, y, np.clip(y_m, -y, y)])
