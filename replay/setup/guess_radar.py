"""Guesses about radars: the sign of radial velocities, ego motion and ambiguity."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fbench.replay.data.messages import Pose, RadarScan
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.ego_velocity import fit_ego
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


_MIN_SHARE = 0.4
_STILL_SHARE = 0.6
_MOVING_MPS = 1.5
_SURELY_MOVING_MPS = 3.0
_STILL_MPS = 0.2


def doppler_lines(sensors: Sequence[Candidate], rig: Rig, poses: SampledTopic | None) -> dict[str, tuple[Line, ...]]:
    """Guess for each radar, by name, from the scans of the sample.

    Most of what a radar sees stands still. Seen from a vehicle that drives forward, things ahead come nearer: so the
    sign of the numbers ahead is that of approaching, unless the vehicle reverses, which poses tell. Numbers that stay
    near zero while the vehicle moves, as another radar or poses say, are free of its motion. A radar that gives no
    velocities at all gets no lines.
    """
    radars = [s for s in sensors if s.kind == "radar" and s.name in rig.mounts and _measures_velocity(s)]
    votes = {s.name: _cast_votes(s, rig) for s in radars}
    by_window = defaultdict[int, list[Pose]](list)
    for sample in () if poses is None else poses.samples:
        if sample.pose is not None:
            by_window[sample.window].append(sample.pose)
    speeds = {window: speed for window, own in by_window.items() if (speed := forward_speed(own)) is not None}
    found: dict[str, tuple[Line, ...]] = {}
    for s in radars:
        others = [vote for name, cast in votes.items() if name != s.name for vote in cast]
        moving = {window for window, speed in (*others, *speeds.items()) if abs(speed) > _SURELY_MOVING_MPS}
        lines = _decide(votes[s.name], len(_scans(s)), moving, speeds)
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


def _cast_votes(radar: Candidate, rig: Rig) -> list[tuple[int, float]]:
    """Fit the motion of each scan as if its velocities were positive when receding and unambiguous. Return its window
    and what it says of things straight ahead that stand still [m/s], with the sign of its numbers; 0: no motion.
    """
    rotation = rig.body_T_sensor(radar.name)[:3, :3]
    votes = []
    for sample in radar.sampled.samples:
        if sample.scan is None or sample.scan.radial_velocity_mps is None:
            continue
        xyz = np.asarray(sample.scan.xyz, np.float64)
        distance = np.sqrt((xyz**2).sum(axis=1))
        good = (distance > 1.0) & (distance < 1e6)  # neither too near for a direction nor not finite
        unit = xyz[good] / distance[good, None]
        directions = np.stack([unit[:, 0] * m[0] + unit[:, 1] * m[1] + unit[:, 2] * m[2] for m in rotation], axis=1)
        fit = fit_ego(directions, np.asarray(sample.scan.radial_velocity_mps, np.float64)[good], None)
        if fit is None or fit.share < _MIN_SHARE:
            continue
        ahead_mps = -float(fit.velocity_mps[0])
        if abs(ahead_mps) > _MOVING_MPS:
            votes.append((sample.window, ahead_mps))
        elif abs(ahead_mps) < _STILL_MPS and fit.share >= _STILL_SHARE:
            votes.append((sample.window, 0.0))
    return votes


def _decide(
    votes: Sequence[tuple[int, float]], num_scans: int, moving: set[int], speeds: Mapping[int, float]
) -> tuple[Line, ...]:
    included = [vote for vote in votes if vote[1]]
    free = [window for window, ahead_mps in votes if not ahead_mps and window in moving]
    if len(free) > len(included):
        why = f"{len(free)} of {num_scans} scans show no motion while other sensors say that the vehicle moves"
        return (
            Line("doppler", "receding", "the vehicle's own motion doesn't show the sign", is_guess=True),
            Line("ego_motion", "removed", why, is_guess=len(free) < 3),
        )
    if not included:
        unclear = f"none of {num_scans} scans shows a motion clearly"
        why = "the vehicle hardly moves in the sampled scans" if votes else unclear
        return Line("doppler", "receding", why, is_guess=True), Line("ego_motion", "included", why, is_guess=True)
    # Things ahead recede only from a vehicle that reverses.
    receding = [(ahead_mps < 0) != (speeds.get(window, 1.0) < -1.0) for window, ahead_mps in included]
    sign = "receding" if 2 * sum(receding) >= len(receding) else "approaching"
    num = max(sum(receding), len(receding) - sum(receding))
    speed = float(np.median([abs(ahead_mps) for _, ahead_mps in included]))
    is_clear = num >= 3 and num >= 0.8 * len(included) and len(included) >= 0.3 * num_scans
    backed = "poses say so" if speeds else "assuming that it drives forward"
    why = f"{num} of {num_scans} scans fit a vehicle at {speed:.1f} m/s, {backed}"
    return (
        Line("doppler", sign, why, is_guess=not is_clear),
        Line("ego_motion", "included", "stationary objects move relative to the vehicle", is_guess=not is_clear),
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
