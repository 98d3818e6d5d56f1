"""Guesses about radars: the sign of radial velocities, ego motion and ambiguity."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fbench.replay.data.messages import Pose, RadarScan
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.ego_velocity import EgoFit, decide_motion, fit_ego, read_motion
from fbench.replay.setup.guess_sensors import Candidate
from fbench.replay.setup.inspection import Line, SampledTopic


def forward_speed(poses: Sequence[Pose]) -> float | None:
    """Median speed along the body's x axis [m/s], of poses in the order of their stamps; `None`: there are too few."""
    speeds = []
    for first, second in zip(poses, poses[5:], strict=False):
        seconds = (second.stamp_ns - first.stamp_ns) / 1e9
        if 0 < seconds < 2 and np.any(first.rotation_xyzw):
            step = second.translation_m - first.translation_m
            speeds.append(float((step * first.world_T_body[:3, 0]).sum()) / seconds)
    return float(np.median(speeds)) if speeds else None


_SURELY_MOVING_MPS = 3.0


def doppler_lines(sensors: Sequence[Candidate], rig: Rig, poses: SampledTopic | None) -> dict[str, tuple[Line, ...]]:
    """Guess for each radar, by name, from the scans of the sample.

    Most of what a radar sees stands still. Seen from a vehicle that drives forward, things ahead come nearer: so the
    sign of the numbers ahead is that of approaching, unless the vehicle reverses, which poses tell. Numbers that stay
    near zero while the vehicle moves, as another radar or poses say, are free of its motion. A radar that gives no
    velocities at all gets no lines.
    """
    radars = [s for s in sensors if s.kind == "radar" and s.name in rig.mounts and _measures_velocity(s)]
    fits = {s.name: _fit_scans(s, rig) for s in radars}
    by_window = defaultdict[int, list[Pose]](list)
    for sample in () if poses is None else poses.samples:
        if sample.pose is not None:
            by_window[sample.window].append(sample.pose)
    speeds = {window: speed for window, own in by_window.items() if (speed := forward_speed(own)) is not None}
    found: dict[str, tuple[Line, ...]] = {}
    for s in radars:
        others = [(w, _ahead_mps(fit)) for name, own in fits.items() if name != s.name for w, fit in own]
        moving = {window for window, speed in (*others, *speeds.items()) if abs(speed) > _SURELY_MOVING_MPS}
        lines = _decide(fits[s.name], moving, speeds)
        found[s.name] = tuple(map(_compare_with_own, lines)) if s.is_own else lines
    return found


def _scans(radar: Candidate) -> list[RadarScan]:
    return [sample.scan for sample in radar.sampled.samples if sample.scan is not None]


def _measures_velocity(radar: Candidate) -> bool:
    """Tell whether any scan has a velocity; also where there are no scans to tell."""
    columns = [scan.radial_velocity_mps for scan in _scans(radar)]
    return not columns or any(column is not None and bool(np.isfinite(column).any()) for column in columns)


def _compare_with_own(line: Line) -> Line:
    """In fbench's logs the meaning is fixed; data that contradict it are worth a look."""
    meant = "receding" if line.key == "doppler" else "included"
    if line.value == meant:
        return replace(line, why="as in all logs that fbench writes" if line.is_guess else line.why, is_guess=False)
    return Line(line.key, meant, f"as in all logs that fbench writes, but {line.why}: {line.value}", is_guess=True)


def _fit_scans(radar: Candidate, rig: Rig) -> list[tuple[int, EgoFit | None]]:
    """Fit the motion of each scan as if its velocities were positive when receding and unambiguous, with its window."""
    rotation = rig.body_T_sensor(radar.name)[:3, :3]
    fits: list[tuple[int, EgoFit | None]] = []
    for sample in radar.sampled.samples:
        if sample.scan is None:
            continue
        if sample.scan.radial_velocity_mps is None:
            fits.append((sample.window, None))
            continue
        xyz = np.asarray(sample.scan.xyz, np.float64)
        distance = np.sqrt((xyz**2).sum(axis=1))
        good = (distance > 1.0) & (distance < 1e6)  # neither too near for a direction nor not finite
        unit = xyz[good] / distance[good, None]
        directions = np.stack([unit[:, 0] * m[0] + unit[:, 1] * m[1] + unit[:, 2] * m[2] for m in rotation], axis=1)
        speed = np.asarray(sample.scan.radial_velocity_mps, np.float64)[good]
        fits.append((sample.window, fit_ego(directions, speed, None)))
    return fits


def _ahead_mps(fit: EgoFit | None) -> float:
    """What a scan says of things straight ahead that stand still [m/s], with the sign of its numbers; 0: no motion."""
    return 0.0 if fit is None or read_motion(fit, is_moving=False) != "included" else -float(fit.velocity_mps[0])


def _decide(
    fits: Sequence[tuple[int, EgoFit | None]], moving: set[int], speeds: Mapping[int, float]
) -> tuple[Line, ...]:
    shown = [read_motion(fit, window in moving) for window, fit in fits]
    motion, num_scans = decide_motion(shown), len(fits)
    if motion == "removed":
        scans = f"{shown.count('removed')} of {num_scans} scans"
        why = f"{scans} show no motion while other sensors say that the vehicle moves"
        sign = Line("doppler", "receding", "the vehicle's own motion doesn't show the sign", is_guess=True)
        return sign, Line("ego_motion", "removed", why)
    if motion == "still":
        why = "the vehicle hardly moves in the sampled scans"
        return Line("doppler", "receding", why, is_guess=True), Line("ego_motion", "included", why, is_guess=True)
    included = [(window, ahead) for window, fit in fits if (ahead := _ahead_mps(fit))]
    # Things ahead recede only from a vehicle that reverses.
    receding = [(ahead_mps < 0) != (speeds.get(window, 1.0) < -1.0) for window, ahead_mps in included]
    sign_name = "receding" if 2 * sum(receding) >= len(receding) else "approaching"
    if motion == "unknown":
        show = "shows" if len(included) < 2 else "show"
        few = f"{len(included) or 'none'} of {num_scans} scans {show} a motion clearly"
        why = f'unknown, {few}; set "removed" if the radar takes the vehicle\'s own motion out'
        return Line("doppler", sign_name, few, is_guess=True), Line("ego_motion", "included", why, is_guess=True)
    num = max(sum(receding), len(receding) - sum(receding))
    speed = float(np.median([abs(ahead_mps) for _, ahead_mps in included]))
    backed = "poses say so" if speeds else "assuming that it drives forward"
    why = f"{num} of {num_scans} scans fit a vehicle at {speed:.1f} m/s, {backed}"
    is_clear = num >= max(3, 0.8 * len(included))
    return (
        Line("doppler", sign_name, why, is_guess=not is_clear),
        Line("ego_motion", "included", "stationary objects move relative to the vehicle"),
    )


_MIN_ECHOES = 1000
_EDGE_SHARE, _EDGE_ECHOES = 0.05, 0.02
_MAX_SKEW = 0.05
_MAX_BINS = 4096


def period_line(radar: Candidate) -> Line | None:
    """Guess the period of a radar's velocities where they wrap around. They thin out towards the fastest that was seen.
    Where they fill a range around zero up to both of its ends instead, what was faster has come in again at the other
    end.
    """
    columns = [scan.radial_velocity_mps for scan in _scans(radar)]
    velocity = np.concatenate([np.zeros(0), *(column for column in columns if column is not None)])
    velocity = velocity[np.isfinite(velocity)]
    if radar.is_own or len(velocity) < _MIN_ECHOES:
        return None
    low, high = float(velocity.min()), float(velocity.max())
    span = high - low
    edge = _EDGE_SHARE * span
    shares = np.mean(velocity <= low + edge), np.mean(velocity >= high - edge)
    if abs(high + low) > _MAX_SKEW * span or span <= 0 or min(shares) < _EDGE_ECHOES:
        return None
    # Radars measure in steps.
    levels = np.unique(velocity.astype(np.float32))
    step = float(np.median(np.diff(levels))) if 1 < len(levels) <= _MAX_BINS else 0.0
    why = f"velocities fill {low:.2f} to {high:.2f} m/s evenly up to both ends, which indicates aliasing"
    return Line("velocity_period_mps", round(span + step, 3), why, is_guess=True)
