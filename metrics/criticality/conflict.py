"""Conflicts of the ego with road users: time to collision, and the braking or steering that avoids it."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.criticality.motion import Motion
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.boxes import Rows
from fbench.replay.data.metadata import Outline

HORIZON_S = 5.0  # Motion isn't predicted any further
_STEPS = 50  # Into which it is cut; within one the moment of contact is found by halving
CRITICAL_S = 3.0
"""A conflict is critical from this time to collision on ..."""
CRITICAL_MPS2 = 3.0  # ... or from this deceleration on, which passengers feel as hard braking
FULL_MPS2 = 8.0  # A car can hardly brake harder on dry asphalt: from here on a conflict has the full weight
MOST_MPS2 = 12.0  # Decelerations and lateral accelerations are limited to this: no tire gives more
_HALVINGS = 30


@dataclass(frozen=True, eq=False)
class Conflicts(Rows):
    """Of N bodies with the ego. Times are inf and efforts 0 where the ego meets nothing within `HORIZON_S`; all is NaN
    where the motion of one of the two isn't known.
    """

    ttc_s: Float64  # (N,)
    deceleration_mps2: Float64  # (N,) constant, from now on, with which the ego just doesn't touch the body
    lateral_mps2: Float64  # (N,) constant, from now on, that just clears the body on the nearer side

    def __len__(self) -> int:
        return len(self.ttc_s)

    @property
    def known(self) -> Bool:
        """(N,) whether motion is known."""
        return ~np.isnan(self.ttc_s)

    @property
    def weight(self) -> Float64:
        """(N,) criticality, 0 to 1: the larger of 1 - TTC / `HORIZON_S` and of the deceleration over `FULL_MPS2`."""
        urgency = 1 - np.minimum(self.ttc_s, HORIZON_S) / HORIZON_S
        return np.asarray(np.maximum(urgency, np.minimum(self.deceleration_mps2 / FULL_MPS2, 1.0)))

    @property
    def critical(self) -> Bool:
        """(N,) whether the ego must act soon or hard."""
        return np.asarray((self.ttc_s <= CRITICAL_S) | (self.deceleration_mps2 >= CRITICAL_MPS2))


def find_conflicts(ego: Motion, outline: Outline, bodies: Motion, size_lw_m: Float64) -> Conflicts:
    """Predict N bodies with footprints of length and width (N, 2), and the ego (N,) beside each in the same axes.

    They meet when the two rectangles first touch. Rectangles that overlap at once, which happens where the outline
    isn't exact, meet at 0 s if they go on into each other, and not at all if they don't.
    """
    from fbench.metrics.criticality.kernels import meet  # numba takes a while to import

    known = ego.known & bodies.known & np.isfinite(size_lw_m).all(axis=1)
    ttc, brake, evade = (np.where(known, none, np.nan) for none in (np.inf, 0.0, 0.0))
    ahead_m = (outline.front_m - outline.rear_m) / 2
    half_ego = np.array([(outline.front_m + outline.rear_m) / 2, outline.side_m])
    rows = np.flatnonzero(known)
    ttc[rows] = meet(
        ego[rows].table, ahead_m, bodies[rows].table, half_ego, size_lw_m[rows] / 2, HORIZON_S, _STEPS, _HALVINGS
    )
    met = np.flatnonzero(np.isfinite(ttc))
    pair = _Pair(ego[met], ahead_m, bodies[met], half_ego, size_lw_m[met] / 2)
    brake[met], evade[met] = pair.brake_mps2(ttc[met]), pair.evade_mps2(ttc[met])
    return Conflicts(ttc, brake, evade)


@dataclass(frozen=True, eq=False)
class _Pair:
    """Egos and bodies, (N,) each, that meet."""

    ego: Motion
    ahead_m: float  # Of the ego's place: where the middle of its rectangle is
    body: Motion
    half_ego: Float64  # (2,) half length and width
    half_body: Float64  # (N, 2)

    def _contact(self, ttc_s: Float64) -> tuple[Float64, Float64]:
        """Way of the ego (N,) until contact, and its course (N,) then."""
        at = ttc_s[:, None]
        turned = self.ego.turn_rate_radps * self.ego.moving_s(at)[:, 0]
        return self.ego.way_m(at)[:, 0], self.ego.course_rad + turned

    def brake_mps2(self, ttc_s: Float64) -> Float64:
        """Constant deceleration (N,) of the ego along its path that avoids a contact after `ttc_s` (N,).

        v is the ego's speed, s its way until contact, u and q the body's speed and acceleration along the ego's course
        at contact. A body that doesn't go the ego's way (u <= 0) must not be reached: v^2 / (2 s). One that does is
        ahead by the gap g, and is followed: (v - u)^2 / (2 g) - q, or, where it stops before both are equally fast,
        v^2 / (2 (g + u^2 / (2 |q|))).
        """
        (way, course), v = self._contact(ttc_s), self.ego.speed_mps
        toward = np.cos(self.body.course_rad - course)
        u, q = self.body.speed_mps * toward, self.body.acceleration_mps2 * toward
        q = np.where(self.body.speed_mps > 0, q, 0.0)
        leads = u > 1e-9
        gap = np.maximum(way - np.where(leads, self.body.way_m(ttc_s[:, None])[:, 0] * toward, 0.0), 0.0)
        w = v - u
        with np.errstate(divide="ignore", invalid="ignore"):
            stop_way = np.where(leads & (q < 0), u**2 / (-2 * q), np.where(leads, np.inf, 0.0))
            stopping = np.where(np.isinf(stop_way), 0.0, v**2 / (2 * (gap + stop_way)))
            following = w**2 / (2 * gap) - q
            stops_first = (w <= 0) | (u + q * 2 * gap / w < 0)
        found = np.where(leads & ~stops_first, following, stopping)
        found = np.where(v > 0, found, 0.0)  # An ego that stands can't avoid anything by braking
        return np.asarray(np.clip(np.nan_to_num(found, nan=MOST_MPS2), 0.0, MOST_MPS2))

    def evade_mps2(self, ttc_s: Float64) -> Float64:
        """Constant lateral acceleration (N,) of the ego that clears the body by the time of contact: 2 d / t^2, where d
        is how far the ego must go aside, on the side where that is less.
        """
        at = ttc_s[:, None]
        (a, yaw_a), (b, yaw_b), course = self.ego.move(at), self.body.move(at), self._contact(ttc_s)[1]
        aside = ((b - a - self.ahead_m * np.exp(1j * yaw_a))[:, 0] * np.exp(-1j * course)).imag
        turned = yaw_b[:, 0] - course
        reach = self.half_body[:, 0] * np.abs(np.sin(turned)) + self.half_body[:, 1] * np.abs(np.cos(turned))
        away = np.maximum(reach + self.half_ego[1] - np.abs(aside), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.where(self.ego.speed_mps > 0, 2 * away / ttc_s**2, 0.0)
        return np.asarray(np.clip(np.nan_to_num(found, nan=0.0, posinf=MOST_MPS2), 0.0, MOST_MPS2))
