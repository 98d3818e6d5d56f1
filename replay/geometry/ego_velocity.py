"""Motion of a radar over ground, from the radial velocities of one scan."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fbench.replay.data.arrays import Float64

INLIER_MPS = 0.4
_MAX_SPEED_MPS = 45.0
_STEP_MPS = 0.2
_MIN_POINTS = 8
_MIN_SHARE, _STILL_SHARE = 0.4, 0.6  # Of points that agree, so that a scan says something
_MOVING_MPS, _STILL_MPS = 1.5, 0.2
_MIN_VOTES, _MAJORITY, _MIN_TURNOUT = 3, 0.8, 0.3

Motion = Literal["included", "removed", "still", "unknown"]
"""The vehicle's own motion in a radar's velocities; `still`: there is none, and nothing says that the vehicle moves."""


@dataclass(frozen=True, eq=False)
class EgoFit:
    """The motion of a radar over ground that most points agree with."""

    velocity_mps: Float64  # (2,) forward and left, body axes [m/s]
    share: float  # Share of the points that agree
    opposite_share: float
    """Share that the best motion the other way round would explain; with aliasing it can be as good."""

    def radial_mps(self, azimuth_rad: Float64) -> Float64:
        """Radial velocity (N,) [m/s] of stationary objects in these directions in the plane, not aliased."""
        forward, left = self.velocity_mps
        return np.asarray(-(np.cos(azimuth_rad) * forward + np.sin(azimuth_rad) * left), np.float64)


def fit_ego(directions: Float64, speed_mps: Float64, period_mps: float | None) -> EgoFit | None:
    """Find the velocity that makes the most points stationary: v_r = -d . v for unit vectors d (N, 3) in body axes.

    After D. Kellner et al., "Instantaneous ego-motion estimation using Doppler radar", ITSC 2013; instead of RANSAC all
    forward speeds up to 45 m/s are tried, so that nothing is random, then the agreeing points refine it. `directions`
    lead from the radar to its points, `speed_mps` (N,) is positive receding and aliases with `period_mps`, `None`:
    unambiguous. `None` with fewer than eight points.
    """
    known = np.isfinite(speed_mps)
    d, v = directions[known, :2], speed_mps[known]
    if len(v) < _MIN_POINTS:
        return None
    num = round(_MAX_SPEED_MPS / _STEP_MPS)
    speeds = np.arange(-num, num + 1, dtype=np.float64) * _STEP_MPS
    candidates: Float64 = speeds[np.argsort(np.abs(speeds), kind="stable")]  # of equal ones the slowest is taken
    parts = np.array_split(candidates, 16)  # so that large scans don't take so many times their size
    rest = (wrap_velocity(v + part[:, None] * d[:, 0], period_mps) for part in parts)
    counts = np.concatenate([np.count_nonzero(np.abs(part) < INLIER_MPS, axis=1) for part in rest])
    best = candidates[int(np.argmax(counts))]
    opposite = int(counts[candidates * best < 0].max(initial=0))
    velocity = np.array([best, 0.0])
    for band in (3.0, 2.0, 1.5, 1.0, 1.0, 1.0):  # from wide to narrow, as a radar in a bend moves sideways too
        velocity = _refine(d, v, velocity, period_mps, band * INLIER_MPS)
    agreeing = np.abs(_residual(d, v, velocity, period_mps)) < INLIER_MPS
    return EgoFit(velocity, float(agreeing.mean()), opposite / len(v))


def read_motion(fit: EgoFit | None, is_moving: bool) -> Motion:
    """Say what one scan shows, by its fit; `is_moving`: others say that the vehicle moves."""
    if fit is None or fit.share < _MIN_SHARE:
        return "unknown"
    if abs(fit.velocity_mps[0]) > _MOVING_MPS:
        return "included"
    is_still = abs(fit.velocity_mps[0]) < _STILL_MPS and fit.share >= _STILL_SHARE
    return ("removed" if is_moving else "still") if is_still else "unknown"


def decide_motion(shown: Sequence[Motion]) -> Motion:
    """Decide about a radar by what its scans show: at least three must agree, four fifths of those that show a motion
    included or removed, and three tenths of those in which the vehicle doesn't stand; else it is unknown.
    """
    counts = Counter(shown)

    def is_clear(motion: Motion, rivals: int, num: int) -> bool:
        votes = counts[motion]
        return votes >= max(_MIN_VOTES, _MAJORITY * (votes + rivals), _MIN_TURNOUT * num)

    num_moving = len(shown) - counts["still"]
    if is_clear("included", counts["removed"], num_moving):
        return "included"
    if is_clear("removed", counts["included"], num_moving):
        return "removed"
    return "still" if is_clear("still", counts["included"] + counts["removed"], len(shown)) else "unknown"


def wrap_velocity(speed_mps: Float64, period_mps: float | None) -> Float64:
    """Velocities as a radar shows them that aliases with a period: within half a period of 0."""
    if period_mps is None:
        return speed_mps
    return np.asarray((speed_mps + period_mps / 2) % period_mps - period_mps / 2, np.float64)


def _residual(d: Float64, v: Float64, velocity: Float64, period_mps: float | None) -> Float64:
    return wrap_velocity(v + d[:, 0] * velocity[0] + d[:, 1] * velocity[1], period_mps)


def _refine(d: Float64, v: Float64, velocity: Float64, period_mps: float | None, band_mps: float) -> Float64:
    """Least squares over the agreeing points; sideways only where the directions tell it."""
    residual = _residual(d, v, velocity, period_mps)
    agreeing = np.abs(residual) < band_mps
    if np.count_nonzero(agreeing) < _MIN_POINTS:
        return velocity
    d, rest = d[agreeing], residual[agreeing]
    if float(np.std(d[:, 1])) < 0.2:
        return velocity - [float(np.sum(d[:, 0] * rest) / np.sum(d[:, 0] ** 2)), 0.0]
    step = np.linalg.lstsq(d, rest, rcond=None)[0]
    return np.asarray(velocity - step, np.float64)
