"""Ego motion from Doppler, and which echoes move over ground."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.checks import require_between
from fbench.pipelines.points.doppler_kernel import agreement
from fbench.pipelines.points.merged import Echoes
from fbench.replay.arrays import Float64
from fbench.replay.data import LogInfo
from fbench.replay.errors import LogError

PERIOD_KEY = "radar.velocity_period_mps"
"""Key in a log's metadata: its radars' velocities alias with this period."""


@dataclass(frozen=True)
class DopplerParams:
    """How the radar's own motion is found in its echoes."""

    period_mps: float | None = None
    """Velocities alias with this period [m/s]; 0: unambiguous; none: as the log's metadata say, else unambiguous."""
    max_reverse_mps: float = 5.0
    """Fastest backwards [m/s]."""
    max_forward_mps: float = 45.0
    """Fastest forwards [m/s]."""
    max_sideways_mps: float = 1.6
    """Fastest sideways [m/s], as at the front of a turning vehicle."""
    band_mps: float = 0.3
    """Echoes whose velocity differs by less [m/s] from that of stationary ones count as stationary in the fit."""
    min_echoes: int = 10
    """With fewer echoes the radar counts as standing."""

    def __post_init__(self) -> None:
        require_between("radar.doppler.period_mps", self.period_mps or 0.0, 0.0, 1e3)
        for name in ("max_reverse_mps", "max_sideways_mps"):
            require_between(f"radar.doppler.{name}", getattr(self, name), 0.0, 200.0)
        require_between("radar.doppler.max_forward_mps", self.max_forward_mps, 0.4, 200.0)
        require_between("radar.doppler.band_mps", self.band_mps, 0.01, 100.0)
        require_between("radar.doppler.min_echoes", self.min_echoes, 3, 1e6)


def logged_period(log_info: LogInfo) -> float | None:
    """Period [m/s] that the log's metadata give for its radars; `None` where they don't.

    Raises:
        LogError: where it isn't a number.
    """
    text = log_info.metadata.get(PERIOD_KEY)
    try:
        return None if text is None else float(text)
    except ValueError as error:
        raise LogError(f"log '{log_info.name}': metadata {PERIOD_KEY}: expected a number, got '{text}'") from error


def wrapped(velocity_mps: Float64, period_mps: float) -> Float64:
    """Take velocities [m/s] to the nearest multiple of the period; unchanged where that is 0."""
    if period_mps <= 0:
        return velocity_mps
    result: Float64 = velocity_mps - period_mps * np.floor(velocity_mps / period_mps + 0.5)
    return result


def sensor_velocity(echoes: Echoes, period_mps: float, params: DopplerParams) -> Float64:
    """Velocity (2,) [m/s] of the radar over ground, forward and left.

    For stationary echoes radial velocity = -direction . velocity (Kellner et al., "Instantaneous ego-motion
    estimation using Doppler radar", ITSC 2013). All velocities of a coarse grid are tried, which also settles
    how often the velocities are aliased; the slowest best one is refined by least squares on the echoes in the band.
    """
    forward = np.arange(-params.max_reverse_mps, params.max_forward_mps, 0.4)
    sideways = np.linspace(-params.max_sideways_mps, params.max_sideways_mps, 5)
    forward = forward[np.argsort(np.abs(forward), kind="stable")]
    sideways = sideways[np.argsort(np.abs(sideways), kind="stable")]
    scores = agreement(echoes.direction, echoes.radial_velocity_mps, forward, sideways, period_mps, 2 * params.band_mps)
    f, s = np.unravel_index(int(np.argmax(scores)), scores.shape)
    velocity = np.array([forward[f], sideways[s]])
    for band_mps in (3.0, 2.0, 1.5, 1.0, 1.0, 1.0):
        velocity = velocity + _correction(echoes, velocity, period_mps, band_mps * params.band_mps)
    return velocity


def _correction(echoes: Echoes, velocity: Float64, period_mps: float, band_mps: float) -> Float64:
    rest = over_ground(echoes, velocity, period_mps)
    near = np.abs(rest) < band_mps
    x, y, r = echoes.direction[near, 0], echoes.direction[near, 1], rest[near]
    xx, xy, yy = (x * x).sum() + 1e-9, (x * y).sum(), (y * y).sum() + 1.0
    xr, yr = (x * r).sum(), (y * r).sum()
    determinant = xx * yy - xy * xy
    step: Float64 = np.array([yr * xy - xr * yy, xr * xy - yr * xx]) / determinant
    return step


def over_ground(echoes: Echoes, velocity: Float64, period_mps: float) -> Float64:
    """Radial velocity (N,) [m/s] of echoes over ground, given the radar's velocity (2,); positive when receding."""
    moved = echoes.direction[:, 0] * velocity[0] + echoes.direction[:, 1] * velocity[1]
    return wrapped(echoes.radial_velocity_mps + moved, period_mps)


def range_rates(echoes: Echoes, params: DopplerParams) -> tuple[Float64, float]:
    """Radial velocity (N,) [m/s] over ground of the echoes of one radar, and the period with which it aliases.

    NaN where the radar measures no velocities.
    """
    measured = echoes[np.isfinite(echoes.radial_velocity_mps)]
    period = params.period_mps or 0.0
    velocity = np.zeros(2)
    if len(measured.xyz) >= params.min_echoes:
        velocity = sensor_velocity(measured, period, params)
    return over_ground(echoes, velocity, period), period
