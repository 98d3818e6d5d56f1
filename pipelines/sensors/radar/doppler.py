"""Ego motion from Doppler, and which echoes move over ground."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial import KDTree

from fbench.pipelines.sensors.points.clustering import Grouping
from fbench.pipelines.sensors.points.merged import Echoes
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.params import CheckedParams, in_range, require_between
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.rig import LogInfo
from fbench.replay.geometry.kernels import kernel

_ACROSS = 1e-6  # Forward share of directions across the way, along which no speed forward can be told
_MARGIN_MPS = 1e-6  # More than rounding does to the limits of what is searched


@kernel
def agreement(
    direction: Float64,
    velocity_mps: Float64,
    forward_mps: Float64,
    sideways_mps: Float64,
    period_mps: float,
    band_mps: float,
) -> Float64:
    """Score candidate velocities of a radar; `forward_mps` (F,), ascending, and `sideways_mps` (S,) span them.

    Returns (F, S): the sum over echoes of max(0, 1 - |r| / band), r being what remains of an echo's radial velocity
    when the sensor's motion is taken away, to the nearest multiple of `period_mps` (0: velocities are unambiguous).
    """
    result = np.zeros((len(forward_mps), len(sideways_mps)))
    for i in range(len(velocity_mps)):
        for s in range(len(sideways_mps)):
            aside_mps = sideways_mps[s] * direction[i, 1]
            first, last = 0, len(forward_mps)
            if period_mps <= 0 and abs(direction[i, 0]) > _ACROSS:
                # All but a few candidates leave too much of this echo.
                middle = -(velocity_mps[i] + aside_mps) / direction[i, 0]
                reach = band_mps / abs(direction[i, 0]) + _MARGIN_MPS
                first, last = np.searchsorted(forward_mps, middle - reach), np.searchsorted(forward_mps, middle + reach)
            for f in range(first, last):
                r = velocity_mps[i] + forward_mps[f] * direction[i, 0] + aside_mps
                if period_mps > 0:
                    r -= period_mps * np.floor(r / period_mps + 0.5)
                if abs(r) < band_mps:
                    result[f, s] += 1.0 - abs(r) / band_mps
    return result


PERIOD_KEY = "radar.velocity_period_mps"
"""Key in a log's metadata: its radars' velocities alias with this period. `radar.NAME...` says it for one of them."""
_LEAST_PERIOD_MPS, _MOST_PERIOD_MPS = 0.1, 1000.0


@dataclass(frozen=True)
class DopplerParams(CheckedParams, prefix="radar.doppler"):
    """How the radar's own motion is found in its echoes; the highest speeds bound how many candidates are tried."""

    period_mps: float | None = None
    """Velocities alias with this period [m/s]; 0: unambiguous; none: as the log's metadata say, else unambiguous."""
    ego_motion: Literal["included", "removed"] | None = None
    """Whether velocities hold the vehicle's own motion; none: as the log's metadata say, else they do."""
    max_reverse_mps: float = in_range(5.0, 0, 200)  # Fastest backwards [m/s].
    max_forward_mps: float = in_range(45.0, 0.4, 200)  # Fastest forwards [m/s].
    max_sideways_mps: float = in_range(1.6, 0, 200)  # Fastest sideways [m/s], as at the front of a turning vehicle.
    band_mps: float = in_range(0.3, 0.01, 100)
    """Echoes whose velocity differs by less [m/s] from that of stationary ones count as stationary in the fit."""
    min_echoes: int = in_range(10, 3, 1e6)  # With fewer echoes the radar counts as standing.

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.period_mps:
            require_between("radar.doppler.period_mps", self.period_mps, _LEAST_PERIOD_MPS, _MOST_PERIOD_MPS)


def velocity_period(radar: str, log_info: LogInfo, params: DopplerParams) -> float:
    """Period [m/s] with which the velocities of a radar alias; 0 where they are unambiguous.

    Parameters go before what the log says about one radar, and that before what it says about all. Nothing is guessed
    from the velocities: a radar that rounds them looks like one that aliases. Raises LogError where the log says
    something that isn't a period.
    """
    if params.period_mps is not None:
        return params.period_mps
    of_all, own = (_log_period(key, log_info) for key in (PERIOD_KEY, f"radar.{radar}.velocity_period_mps"))
    return (of_all or 0.0) if own is None else own


def resolve_ego_motion(radar: str, log_info: LogInfo, params: DopplerParams) -> DopplerParams:
    """Say whether velocities of a radar hold the ego motion. Raises LogError where the log says something else."""
    key = f"radar.{radar}.ego_motion"
    text = log_info.metadata.get(key, log_info.metadata.get("radar.ego_motion", "included"))
    if params.ego_motion is not None:
        return params
    if text not in ("included", "removed"):
        raise LogError(f"log '{log_info.name}': metadata {key}: expected 'included' or 'removed', got '{text}'")
    return replace(params, ego_motion="removed" if text == "removed" else "included")


def _log_period(key: str, log_info: LogInfo) -> float | None:
    text = log_info.metadata.get(key)
    if text is None:
        return None
    try:
        period = float(text)
    except ValueError:
        period = math.nan
    if period != 0 and not _LEAST_PERIOD_MPS <= period <= _MOST_PERIOD_MPS:
        expected = f"expected 0 or a number from {_LEAST_PERIOD_MPS:g} to {_MOST_PERIOD_MPS:g}"
        raise LogError(f"log '{log_info.name}': metadata {key}: {expected}, got '{text}'")
    return period


def wrap_velocity(velocity_mps: Float64, period_mps: float) -> Float64:
    """Take velocities [m/s] to the nearest multiple of the period; unchanged where that is 0."""
    if period_mps <= 0:
        return velocity_mps
    return velocity_mps - period_mps * np.floor(velocity_mps / period_mps + 0.5)


def sensor_velocity(echoes: Echoes, params: DopplerParams) -> Float64:
    """Velocity (2,) [m/s] of the radar over ground, forward and left.

    For stationary echoes radial velocity = -direction . velocity (Kellner et al., "Instantaneous ego-motion
    estimation using Doppler radar", ITSC 2013). All velocities of a coarse grid are tried, which also settles
    how often the velocities are aliased; the slowest best one is refined by least squares on the echoes in the band.
    """
    forward = np.arange(-params.max_reverse_mps, params.max_forward_mps, 0.4)
    sideways = np.linspace(-params.max_sideways_mps, params.max_sideways_mps, 5)
    slowest = np.argsort(np.abs(forward), kind="stable")
    sideways = sideways[np.argsort(np.abs(sideways), kind="stable")]
    band_mps = 2 * params.band_mps
    measured = echoes.direction, echoes.radial_velocity_mps
    scores = agreement(*measured, forward, sideways, echoes.period_mps, band_mps)[slowest]
    f, s = np.unravel_index(int(np.argmax(scores)), scores.shape)
    velocity = np.array([forward[slowest[f]], sideways[s]])
    for times in (3.0, 2.0, 1.5, 1.0, 1.0, 1.0):
        rest = over_ground(echoes, velocity)
        near = np.abs(rest) < times * params.band_mps
        x, y, r = echoes.direction[near, 0], echoes.direction[near, 1], rest[near]
        xx, xy, yy = (x * x).sum() + 1e-9, (x * y).sum(), (y * y).sum() + 1.0
        xr, yr = (x * r).sum(), (y * r).sum()
        velocity = velocity + np.array([yr * xy - xr * yy, xr * xy - yr * xx]) / (xx * yy - xy * xy)
    return velocity


def over_ground(echoes: Echoes, velocity: Float64) -> Float64:
    """Radial velocity (N,) [m/s] of echoes over ground, given the radar's velocity (2,); positive when receding, NaN
    where it measures none.
    """
    moved = echoes.direction[:, 0] * velocity[0] + echoes.direction[:, 1] * velocity[1]
    return wrap_velocity(echoes.radial_velocity_mps + moved, echoes.period_mps)


def own_velocity(echoes: Echoes, params: DopplerParams) -> Float64:
    """Velocity (2,) [m/s] of one radar over ground, forward and left, as far as its measured velocities hold it."""
    measured = echoes[np.isfinite(echoes.radial_velocity_mps)]
    if len(measured.xyz) >= params.min_echoes and params.ego_motion != "removed":
        return sensor_velocity(measured, params)
    return np.zeros(2)


@dataclass(frozen=True)
class UnmeasuredParams(CheckedParams, prefix="radar.unmeasured"):
    """What echoes without velocity must be like, since standing things can't be told from moving ones by it."""

    strongest: float = in_range(0.25, 0, 1)
    """Share of the echoes of one scan [0 to 1], the strongest, that is clustered; those of unknown magnitude are."""
    least_kept: int = in_range(200, 0, 1e6)
    """So many of a scan's strongest echoes are clustered at least: sparse scans hold little that is weak."""
    max_length_m: float = in_range(15.0, 0.1, 1000)  # Longer clusters [m] are walls and hedges.
    max_width_m: float = in_range(4.5, 0.1, 1000)  # Wider clusters [m] are buildings and trees.


def strong(magnitude_db: Float64, params: UnmeasuredParams) -> Bool:
    """Tell which echoes (N,) of one scan are among its strongest; equally strong ones are alike."""
    known = np.sort(magnitude_db[np.isfinite(magnitude_db)])
    num = max(round(params.strongest * len(known)), params.least_kept)
    if num >= len(known):
        return np.ones(len(magnitude_db), np.bool_)
    least = known[len(known) - num] if num else np.inf
    return np.asarray(~(magnitude_db < least), np.bool_)


def add_unmeasured(
    xyz: Float64, range_rate_mps: Float64, candidates: Bool, cluster: Int64, grouping: Grouping,
    params: UnmeasuredParams,
) -> Int64:  # fmt: skip
    """Give echoes without velocity (N,) a cluster, and return the clusters (N,) of all.

    What a radar with Doppler says about the place counts: of echoes it measured within the radius the nearest tells
    whether this is part of its moving cluster, or stands still. Others are clustered by place alone, and what is too
    large for a vehicle is left out. New clusters get the numbers after those in `cluster`, in the order of `grouping`.
    """
    result, measured = cluster.copy(), np.flatnonzero(np.isfinite(range_rate_mps))
    rows = np.flatnonzero(candidates & ~np.isfinite(range_rate_mps))
    if len(measured) and len(rows):
        distance, nearest = KDTree(xyz[measured, :2]).query(xyz[rows, :2])
        is_near = distance <= grouping.radii(np.hypot(xyz[rows, 0], xyz[rows, 1]))
        result[rows] = np.where(is_near, cluster[measured[nearest]], -1)
        rows = rows[~is_near]
    found = grouping.clusters(xyz[rows, :2], np.hypot(xyz[rows, 0], xyz[rows, 1]))
    number = int(cluster.max(initial=-1)) + 1
    for one in range(int(found.max(initial=-1)) + 1):
        members = rows[found == one]
        # Extents along and across the main axis, which is that of the largest variance.
        x, y = (xyz[members, :2] - xyz[members, :2].mean(axis=0)).T
        heading = 0.5 * np.arctan2(2 * (x * y).sum(), (x * x - y * y).sum())
        cos, sin = np.cos(heading), np.sin(heading)
        length, width = np.ptp(cos * x + sin * y), np.ptp(cos * y - sin * x)
        if length <= params.max_length_m and width <= params.max_width_m:
            result[members] = number
            number += 1
    return result
