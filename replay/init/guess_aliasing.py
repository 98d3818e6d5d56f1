"""Whether the radial velocities of a radar are ambiguous, from how they are spread."""

from collections.abc import Sequence

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.init.draft import Line
from fbench.replay.init.guess_sensors import Candidate

_MIN_ECHOES = 1000
_EDGE_SHARE, _EDGE_ECHOES = 0.05, 0.02
_MAX_SKEW = 0.05
_MAX_BINS = 4096


def period_lines(sensors: Sequence[Candidate]) -> dict[str, Line]:
    """Guess the period of each radar, by name, whose velocities wrap around.

    Velocities thin out towards the fastest that was seen. Where they fill a range around zero up to both of its ends
    instead, what was faster has come in again at the other end.
    """
    found = {s.name: _period_line(_velocities(s)) for s in sensors if s.kind == "radar" and not s.is_own}
    return {name: line for name, line in found.items() if line is not None}


def _velocities(radar: Candidate) -> Float64:
    scans = [seen.scan.radial_velocity_mps for seen in radar.heard.seen if seen.scan is not None]
    values = np.concatenate([np.zeros(0), *(scan for scan in scans if scan is not None)])
    return np.asarray(values[np.isfinite(values)], np.float64)


def _period_line(velocity_mps: Float64) -> Line | None:
    if len(velocity_mps) < _MIN_ECHOES:
        return None
    low, high = float(velocity_mps.min()), float(velocity_mps.max())
    span = high - low
    edge = _EDGE_SHARE * span
    shares = np.mean(velocity_mps <= low + edge), np.mean(velocity_mps >= high - edge)
    if abs(high + low) > _MAX_SKEW * span or span <= 0 or min(shares) < _EDGE_ECHOES:
        return None
    period = round(span + _step(velocity_mps), 3)
    why = f"velocities fill {low:.2f} to {high:.2f} m/s up to both ends, as those that wrap around do"
    return Line("velocity_period_mps", period, why, is_guess=True)


def _step(velocity_mps: Float64) -> float:
    """Distance [m/s] of the steps in which a radar measures; 0 where it has none."""
    levels = np.unique(velocity_mps.astype(np.float32))
    return float(np.median(np.diff(levels))) if 1 < len(levels) <= _MAX_BINS else 0.0
