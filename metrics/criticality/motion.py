"""Motion of the ego and of road users in the ground plane: constant turn rate and acceleration (CTRA).

Places and velocities are complex numbers, x + iy [m, m/s]; turning by an angle is a product with exp(i angle).
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import MAX_MAGNITUDE, Rows
from fbench.replay.data.sequences import Objects, Steps
from fbench.replay.geometry.transforms import pose_matrices
from fbench.replay.runs.folder import Run

Complex = NDArray[np.complex128]
SLOW_MPS = 0.5  # Below it a direction of motion is noise: such bodies go on along their heading, unchanged
MAX_GAP_S = 1.0  # Between instants farther apart than this nothing is differentiated
FIT_S = 1.0
"""Where only places are known, motion is that of a parabola through so long a part of their course: in differences of
neighbors, the jitter of labels looks like braking.
"""
EGO_UNKNOWN = f"the motion of the ego isn't known: that takes poses at most {MAX_GAP_S:g} s apart"
MOST_MPS2, MOST_RADPS = 10.0, 1.5
"""No road user accelerates or turns faster; differences of labels that jitter do, and are limited to this."""


@dataclass(frozen=True, eq=False)
class Motion(Rows):
    """N bodies at one instant each, in the ground plane, in axes that are the same for bodies to be compared."""

    place: Complex  # (N,) of the middle of the footprint [m]
    yaw_rad: Float64  # (N,) heading of the footprint
    course_rad: Float64  # (N,) direction of motion
    speed_mps: Float64  # (N,) from 0 up
    acceleration_mps2: Float64  # (N,) along the course
    turn_rate_radps: Float64  # (N,)

    def __len__(self) -> int:
        return len(self.place)

    @property
    def known(self) -> Bool:
        """(N,) whether place and motion are known."""
        parts = (self.place, self.yaw_rad, self.course_rad, self.speed_mps, self.acceleration_mps2)
        return np.asarray(np.isfinite(np.array([*parts, self.turn_rate_radps])).all(axis=0))

    @property
    def table(self) -> Float64:
        """(N, 7) x, y, heading, course, speed, acceleration, turn rate, for kernels."""
        rest = self.yaw_rad, self.course_rad, self.speed_mps, self.acceleration_mps2, self.turn_rate_radps
        return np.ascontiguousarray(np.column_stack([self.place.real, self.place.imag, *rest]))

    def moving_s(self, time_s: Float64) -> Float64:
        """Return for how long (N, K) of these times each body moves: one that brakes stands from its stop on."""
        braking = np.where(self.acceleration_mps2 < 0, -self.acceleration_mps2, np.nan)
        with np.errstate(divide="ignore"):
            stop_s = self.speed_mps / braking
        return np.asarray(np.fmin(time_s, stop_s[:, None]))

    def way_m(self, time_s: Float64) -> Float64:
        """Return how far (N, K) each body goes in these times (N, K) or (1, K)."""
        t = self.moving_s(time_s)
        return np.asarray(self.speed_mps[:, None] * t + self.acceleration_mps2[:, None] * t**2 / 2)

    def move(self, time_s: Float64) -> tuple[Complex, Float64]:
        """Return place and heading (N, K) after these times (N, K) or (1, K).

        The displacement is the integral of (v + a s) exp(i (course + w s)) over s from 0 to t, in closed form.
        """
        t = self.moving_s(time_s)
        turned = self.turn_rate_radps[:, None] * t
        z, e = 1j * turned, np.exp(1j * turned)
        with np.errstate(divide="ignore", invalid="ignore"):
            first = (e - 1) / z
            second = (e - first) / z
        straight = np.abs(turned) < 1e-2  # Nearly: there the quotients round
        z = z[straight]
        first[straight] = 1 + z / 2 + z**2 / 6 + z**3 / 24 + z**4 / 120
        second[straight] = 1 / 2 + z / 3 + z**2 / 8 + z**3 / 30 + z**4 / 144
        along = self.speed_mps[:, None] * t * first + self.acceleration_mps2[:, None] * t**2 * second
        return self.place[:, None] + along * np.exp(1j * self.course_rad)[:, None], self.yaw_rad[:, None] + turned


@dataclass(frozen=True, eq=False)
class EgoMotion(Rows):
    """The ego at each of F frames, in the world; NaN where its poses don't tell."""

    frame: Int64  # (F,) ascending index
    place: Complex  # (F,) of the body's origin
    yaw_rad: Float64  # (F,)
    velocity: Complex  # (F,) over ground
    change: Complex  # (F,) of the velocity [m/s^2]
    turn_rate_radps: Float64  # (F,)

    def __len__(self) -> int:
        return len(self.frame)

    def of_frames(self, frame: Int64) -> Self:
        """Return the ego at these frames (S,) by index, which are among those that are known."""
        return self[np.searchsorted(self.frame, frame)]


def differentiate(values: Complex, time_s: Float64, stretch: Int64) -> Complex:
    """Return the rates (N,) of values (N,) at rising times (N,) within each stretch (N,) of equal numbers: weighted
    central differences, one-sided at the ends; NaN where a value has no neighbor within `MAX_GAP_S`.
    """
    step_s = np.diff(time_s)
    near: Bool = np.asarray((np.diff(stretch) == 0) & (step_s > 0) & (step_s <= MAX_GAP_S + 1e-9))
    slope = np.where(near, np.diff(values) / np.where(near, step_s, 1.0), np.nan)
    # Each side's slope counts as much as the other side's step is long: exact for parabolas.
    nothing = np.array([np.nan + 0j])
    before, after = np.concatenate([nothing, slope]), np.concatenate([slope, nothing])
    length = np.concatenate([[1.0], np.where(near, step_s, 1.0), [1.0]])
    both = (before * length[1:] + after * length[:-1]) / (length[1:] + length[:-1])
    found = np.where(np.isnan(before), after, np.where(np.isnan(after), before, both))
    return np.asarray(found[: len(values)], np.complex128)


def fit_motion(places: Complex, time_s: Float64, stretch: Int64) -> tuple[Complex, Complex]:
    """Return velocities and accelerations (N,) of places (N,) at rising times (N,) within each stretch (N,) of equal
    numbers: those of the parabola that is nearest (least squares) to the places within `FIT_S`, which lie around, or
    at the ends of a stretch on one side. Where these are fewer than three, differences. A gap of more than `MAX_GAP_S`
    ends a stretch.
    """
    from fbench.metrics.criticality.kernels import fit_parabolas  # numba takes a while to import

    velocity = differentiate(places, time_s, stretch)
    acceleration = differentiate(velocity, time_s, stretch)
    known = np.flatnonzero(np.isfinite(places))
    xy, t = np.column_stack([places.real, places.imag])[known], time_s[known]
    begins = np.concatenate([[True], (np.diff(stretch[known]) != 0) | (np.diff(t) > MAX_GAP_S + 1e-9)])[: len(known)]
    part, ends = np.cumsum(begins), np.append(np.flatnonzero(begins)[1:], len(known)) - 1
    first_s, last_s = t[begins][part - 1], t[ends[: begins.sum()]][part - 1]
    half_s = np.minimum(FIT_S, last_s - first_s) / 2
    middle_s = np.clip(t, first_s + half_s, last_s - half_s)
    motion = np.column_stack([velocity.real, velocity.imag, acceleration.real, acceleration.imag])[known]
    fit_parabolas(xy, t, part, middle_s, half_s + 1e-9, motion)
    velocity[known], acceleration[known] = motion[:, 0] + 1j * motion[:, 1], motion[:, 2] + 1j * motion[:, 3]
    return velocity, acceleration


def find_ego_motion(run: Run) -> EgoMotion:
    """Return how the body of a run moved, from its poses alone."""
    order = np.argsort([frame.index for frame in run.frames], kind="stable")
    frames = [run.frames[k] for k in order]
    index, segment, stamp_ns = (
        np.array([getattr(f, name) for f in frames], np.int64) for name in ("index", "segment", "stamp_ns")
    )
    return follow_ego(index, segment, stamp_ns, run.poses[order])


def follow_ego(index: Int64, segment: Int64, stamp_ns: Int64, poses: Float64) -> EgoMotion:
    """Return how the body moved over frames (F,) in the order of time, from its poses in the world (F, 7): place [m]
    and quaternion x, y, z, w; NaN where it isn't known.
    """
    known: Bool = np.asarray(np.isfinite(poses).all(axis=1))
    world_T_body = pose_matrices(
        np.where(known[:, None], poses[:, :3], 0.0), np.where(known[:, None], poses[:, 3:], [0, 0, 0, 1])
    )
    place = world_T_body[:, 0, 3] + 1j * world_T_body[:, 1, 3]
    yaw = np.where(known, np.arctan2(world_T_body[:, 1, 0], world_T_body[:, 0, 0]), np.nan)
    time_s = _seconds(stamp_ns)
    velocity = differentiate(np.where(known, place, np.nan), time_s, segment)
    turned = np.where(known, np.unwrap(np.nan_to_num(yaw)), np.nan).astype(np.complex128)
    rate = differentiate(turned, time_s, segment).real
    return EgoMotion(index, place, yaw, velocity, differentiate(velocity, time_s, segment), rate)


def _seconds(stamp_ns: Int64) -> Float64:
    return np.asarray((stamp_ns - stamp_ns[:1].sum()) * 1e-9)  # of differences: floats of such stamps would round


def move_ego(ego: EgoMotion, steps: Steps) -> Motion:
    """Return the motion (S,) of the ego at each step, in its own axes there: at the origin, heading along x."""
    own, nothing = ego.of_frames(steps.frame), np.zeros(len(steps))
    heading = np.exp(1j * own.yaw_rad)
    origin = nothing.astype(np.complex128)
    motion = _describe(own.velocity * np.conj(heading), own.change * np.conj(heading), origin, nothing)
    turning = np.where(motion.speed_mps < SLOW_MPS, 0.0, own.turn_rate_radps)
    return replace(motion, turn_rate_radps=np.clip(turning, -MOST_RADPS, MOST_RADPS))


def move_objects(objects: Objects, steps: Steps, ego: EgoMotion, else_standing: bool = False) -> Motion:
    """Return the motion (N,) of road users, in the axes of the ego at the step of each.

    Velocities are those that the boxes have, and turn rates and accelerations are their differences; 0 where a box has
    no neighbor of its id. Else all follow from the places that boxes of one id have in the world, as `fit_motion` says.
    What has neither is unknown, or stands where `else_standing`.
    """
    own, n = ego.of_frames(steps.frame), len(objects)
    if objects.center_m is None or objects.yaw_rad is None:
        unknown = np.full(n, np.nan)
        return Motion(unknown + 0j, *[unknown] * 5)
    turn = np.exp(1j * own.yaw_rad)[objects.step]
    center_m, yaw_rad = _finite(objects.center_m), _finite(objects.yaw_rad)
    place = center_m[:, 0] + 1j * center_m[:, 1]
    order = np.lexsort([steps.places[objects.step], objects.track_id, steps.stream[objects.step]])
    ids, streams = objects.track_id[order], steps.stream[objects.step][order]
    # Boxes without an id belong together with no other.
    starts = np.concatenate([[True], (np.diff(ids) != 0) | (np.diff(streams) != 0) | (ids[1:] < 0)])[:n]
    stretch, time_s = np.cumsum(starts).astype(np.int64), _seconds(steps.stamp_ns)[objects.step][order]
    world = own.place[objects.step] + place * turn
    velocity = np.full(n, np.nan + 0j)
    if objects.velocity_mps is not None:
        own_mps = _finite(objects.velocity_mps)
        velocity = (own_mps[:, 0] + 1j * own_mps[:, 1]) * turn
    given: Bool = np.isfinite(velocity)
    derived, bent, change = (np.full(n, np.nan + 0j) for _ in range(3))
    if not given.all():
        derived[order], bent[order] = fit_motion(world[order], time_s, stretch)
    velocity = np.where(given, velocity, derived)
    if else_standing:
        velocity = np.where(np.isfinite(velocity), velocity, 0)
    change[order] = differentiate(velocity[order], time_s, stretch)
    change = np.where(given | np.isnan(bent), change, bent)
    return _describe(velocity * np.conj(turn), change * np.conj(turn), place, yaw_rad)


def _finite(values: Float64) -> Float64:
    """The values, NaN where they are infinite or absurdly large: results may hold anything."""
    return np.where(np.abs(values) < MAX_MAGNITUDE, values, np.nan)


def _describe(velocity: Complex, change: Complex, place: Complex, yaw_rad: Float64) -> Motion:
    """Motion of bodies with these velocities and changes of velocity [m/s^2]; changes that aren't known are 0."""
    change, speed = np.where(np.isfinite(change), change, 0), np.abs(velocity)
    slow = speed < SLOW_MPS
    safe = np.where(slow | ~np.isfinite(speed), 1.0, speed)
    along = np.where(slow, 0.0, (np.conj(velocity) * change).real / safe)
    across = np.where(slow, 0.0, (np.conj(velocity) * change).imag / safe**2)
    # What is nearly at rest keeps its speed along its heading, forward or backward.
    slow_along = (velocity * np.exp(-1j * yaw_rad)).real
    return Motion(
        place, yaw_rad,
        np.where(slow, yaw_rad + np.where(slow_along < 0, np.pi, 0.0), np.angle(velocity)),
        np.where(slow, np.abs(slow_along), speed),
        np.where(np.isfinite(speed), np.clip(along, -MOST_MPS2, MOST_MPS2), np.nan),
        np.where(np.isfinite(speed), np.clip(across, -MOST_RADPS, MOST_RADPS), np.nan),
    )  # fmt: skip
