"""Radial velocity over azimuth, with the curve that stationary objects follow."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.data.arrays import Float64
from fbench.replay.data.images import Pixels
from fbench.replay.geometry.ego_velocity import INLIER_MPS, EgoFit, fit_ego, wrapped
from fbench.reports.preview import draw
from fbench.reports.preview.draw import CURVE, of_speed
from fbench.reports.preview.sample import Points, Sample
from fbench.reports.preview.times import Axes, spanned

_COLUMNS, _CELL = 3, (426, 270)
_MOVING_MPS = 0.5
_MIN_SHARE = 0.3


@dataclass(frozen=True)
class DopplerVerdict:
    """What the velocities of one radar say."""

    radar: str
    text: str
    is_bad: bool


@dataclass(frozen=True, eq=False)
class _Scan:
    """One scan as seen from its radar, in body axes."""

    index: int
    azimuth_rad: Float64
    speed_mps: Float64
    fit: EgoFit | None
    ego_mps: float | None


def judged(samples: Sequence[Sample], radar: str, period_mps: float | None, is_removed: bool = False) -> DopplerVerdict:
    """Judge sign, ego motion and aliasing of a radar's velocities.

    Args:
        samples: With its scans.
        radar: Its name.
        period_mps: With which velocities alias; `None`: as far as is known they don't.
        is_removed: Whether the log says that velocities don't hold the vehicle's own motion.
    """
    scans = _scans(samples, radar, period_mps)
    text, is_bad = _removed(scans) if is_removed and scans else _verdict(scans, period_mps)
    return DopplerVerdict(radar, text, is_bad)


def doppler_panel(samples: Sequence[Sample], radar: str, period_mps: float | None) -> Pixels | None:
    """Draw the scans of all samples; `None` where there is none with velocities."""
    scans = _scans(samples, radar, period_mps)
    if not scans:
        return None
    rows = -(-len(scans) // _COLUMNS)
    picture = draw.canvas(_CELL[0] * min(_COLUMNS, len(scans)), _CELL[1] * rows)
    azimuth = spanned(np.degrees(np.concatenate([scan.azimuth_rad for scan in scans])), 20)
    reach = max(2.0, *(abs(v) for v in spanned(np.concatenate([scan.speed_mps for scan in scans]), 4)))
    for number, scan in enumerate(scans):
        at = (number % _COLUMNS * _CELL[0], number // _COLUMNS * _CELL[1])
        _draw_scan(picture, Axes((*at, *_CELL), azimuth, (-reach, reach)), scan, period_mps)
    return picture


def _scans(samples: Sequence[Sample], radar: str, period_mps: float | None) -> list[_Scan]:
    found = [(sample, points) for sample in samples for points in sample.placed("radar") if points.sensor == radar]
    return [_scan(sample, points, period_mps) for sample, points in found if np.isfinite(points.speed_mps).any()]


def _scan(sample: Sample, points: Points, period_mps: float | None) -> _Scan:
    seen = points.xyz - sample.rig.body_T_sensor(points.sensor)[:3, 3]
    distance = np.sqrt(np.sum(seen**2, axis=1))
    rows = (distance > 0.5) & np.isfinite(points.speed_mps)
    directions, speed = seen[rows] / distance[rows, None], points.speed_mps[rows]
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    return _Scan(sample.frame.index, azimuth, speed, fit_ego(directions, speed, period_mps), sample.ego_mps)


def _draw_scan(picture: Pixels, axes: Axes, scan: _Scan, period_mps: float | None) -> None:
    fit = scan.fit
    title = f"frame {scan.index}: {len(scan.speed_mps)} points"
    if fit is not None:
        title += f", curve: {fit.velocity_mps[0]:+.1f} m/s ahead, {fit.share:.0%} agree"
    axes.draw(picture, title, "azimuth [deg], left is +", "radial velocity [m/s], receding is +")
    if fit is not None:
        angles = np.radians(np.linspace(axes.x[0], axes.x[1], 241))
        curve = wrapped(fit.radial_mps(angles), period_mps)
        if period_mps is not None:
            curve[1:][np.abs(np.diff(curve)) > period_mps / 2] = np.nan
        axes.line(picture, np.stack([np.degrees(angles), curve], axis=1), CURVE, 2)
    xy = np.stack([np.degrees(scan.azimuth_rad), scan.speed_mps], axis=1)
    axes.dots(picture, xy, of_speed(scan.speed_mps), 2)


def _verdict(scans: Sequence[_Scan], period_mps: float | None) -> tuple[str, bool]:
    fits = [scan.fit for scan in scans if scan.fit is not None]
    if not scans:
        return (
            "no radial velocities: radar3d can't tell what moves, and takes strong clusters of a vehicle's size",
            False,
        )
    if not fits:
        return "too few points to judge the velocities", False
    if (period := _unknown_period(scans)) if period_mps is None else 0.0:
        return f"velocities seem to alias with a period of about {period:.1f} m/s: set velocity_period_mps", True
    share = float(np.median([fit.share for fit in fits]))
    if share < _MIN_SHARE:
        why = "wrong mounting, units or sign by direction, no stationary objects, or velocities without period"
        return f"no speed of the vehicle explains the points ({share:.0%} agree at best): {why}", True
    moving = [fit for fit in fits if abs(fit.velocity_mps[0]) > _MOVING_MPS and fit.share >= _MIN_SHARE]
    egos = [scan.ego_mps for scan in scans if scan.ego_mps is not None]
    ego = float(np.median(egos)) if egos else None
    if 3 * len(moving) < len(fits):
        return _still(ego)
    speed = float(np.median([fit.velocity_mps[0] for fit in moving]))
    agree = f"{float(np.median([fit.share for fit in moving])):.0%} of the points agree"
    rivals = float(np.median([fit.share - fit.opposite_share for fit in moving]))
    return _moving(speed, ego, agree, is_clear=rivals > 0.05)


def _removed(scans: Sequence[_Scan]) -> tuple[str, bool]:
    share = float(np.median([np.mean(np.abs(scan.speed_mps) < INLIER_MPS) for scan in scans]))
    if share < _MIN_SHARE:
        return f"the vehicle's own motion is said to be removed, but only {share:.0%} of the points stand still", True
    return f"the vehicle's own motion is removed, as said: {share:.0%} of the points stand still", False


def _still(ego: float | None) -> tuple[str, bool]:
    if ego is not None and abs(ego) > 1.5:
        removed = 'the vehicle\'s own motion has been removed already: set ego_motion = "removed"'
        return f"most points don't move though the vehicle drives at {ego:.1f} m/s: {removed}", True
    if ego is not None:
        return "most points don't move, and the vehicle doesn't, as its poses say", False
    removed = 'or its own motion has been removed already (then set ego_motion = "removed")'
    return f"most points don't move relative to the radar: the vehicle stands, {removed}", False


def _moving(speed: float, ego: float | None, agree: str, is_clear: bool) -> tuple[str, bool]:
    """Judge the sign."""
    flip = "the sign is the other way round: change doppler in fbench.toml"
    found = f"stationary points say that the vehicle drives {_way(speed)} at {abs(speed):.1f} m/s ({agree})"
    if ego is not None and abs(ego) > 1.5:
        told = f"its poses say {_way(ego)} at {abs(ego):.1f} m/s"
        if speed * ego < 0 and abs(speed + ego) < max(2.0, 0.3 * abs(ego)):
            return f"{found}, {told}: {flip}", True
        near = abs(speed - ego) < max(1.0, 0.2 * abs(ego))
        return (f"{found}, as its poses do", False) if near else (f"{found}, but {told}", True)
    if not is_clear:
        return f"{found}; because of aliasing the other direction fits about as well, so look at the curves", False
    return (f"{found}; unless it does, {flip}", True) if speed < 0 else (found, False)


def _way(speed: float) -> str:
    return "forward" if speed > 0 else "backwards"


def _unknown_period(scans: Sequence[_Scan]) -> float:
    """Period [m/s] that explains clearly more points than none does: twice the fastest velocity; 0 where none does."""
    top = float(np.quantile(np.abs(np.concatenate([scan.speed_mps for scan in scans])), 0.995))
    if top < 1.0:
        return 0.0
    gains = []
    for scan in scans:
        if scan.fit is not None:
            directions = np.stack([np.cos(scan.azimuth_rad), np.sin(scan.azimuth_rad), 0 * scan.azimuth_rad], axis=1)
            other = fit_ego(directions, scan.speed_mps, 2 * top)
            gains.append(0.0 if other is None else other.share - scan.fit.share)
    return 2 * top if gains and float(np.median(gains)) > 0.2 else 0.0
