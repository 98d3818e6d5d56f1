"""Motion compensation (deskewing) of points that a moving LiDAR measured one after the other."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.messages import PointCloud, Pose
from fbench.replay.data.rig import LogInfo
from fbench.replay.geometry.kernels import kernel

_SMALL = 1e-3
"""Below this angle [rad] series are more exact than quotients."""


@kernel
def carried(xyz: Float64, time_s: Float64, turn_radps: Float64, speed_mps: Float64) -> Float64:
    """Move points (N, 3) [m], each in body coordinates at its time (N,), to body coordinates at time 0.

    The body turns (3,) and moves (3,) steadily in its own axes: p -> R p + V v t with W = [w]x, a = |w| t,
    R = I + sin(a) / |w| W + (1 - cos(a)) / |w|^2 W^2 and V t = t I + (1 - cos(a)) / |w|^2 W + (a - sin(a)) / |w|^3 W^2
    (exponential of a twist: Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, 2.3).
    """
    result = np.empty_like(xyz)
    rate = math.sqrt(turn_radps[0] ** 2 + turn_radps[1] ** 2 + turn_radps[2] ** 2)
    move = np.zeros((3, 4))
    before = 0.0
    for i in range(len(xyz)):
        if time_s[i] == 0.0:
            result[i] = xyz[i]
            continue
        if time_s[i] != before:  # beams of one shot share it
            before = time_s[i]
            _fill(move, before, rate, turn_radps, speed_mps)
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        for axis in range(3):
            result[i, axis] = move[axis, 0] * x + move[axis, 1] * y + move[axis, 2] * z + move[axis, 3]
    return result


@kernel
def _fill(move: Float64, t: float, rate: float, turn: Float64, speed: Float64) -> None:
    """Write R and V v t into `move` (3, 4)."""
    a = rate * t
    if abs(a) < _SMALL:
        first, second, third = t * (1 - a * a / 6), t * t * (0.5 - a * a / 24), t**3 * (1 / 6 - a * a / 120)
    else:
        first, second = math.sin(a) / rate, 2 * (math.sin(a / 2) / rate) ** 2
        third = (a - math.sin(a)) / rate**3
    square = turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        move[axis, axis] = 1 + second * (turn[axis] ** 2 - square)
        move[axis, j] = second * turn[axis] * turn[j] - first * turn[k]
        move[axis, k] = second * turn[axis] * turn[k] + first * turn[j]
        across = turn[j] * speed[k] - turn[k] * speed[j]  # W v
        along = turn[0] * speed[0] + turn[1] * speed[1] + turn[2] * speed[2]
        move[axis, 3] = t * speed[axis] + second * across + third * (turn[axis] * along - square * speed[axis])


FROZEN = "frozen at the stamp"
"""So the metadata `lidar.NAME.motion` say that nothing moved in a sweep, or that its points are compensated."""
_MOST_BETWEEN_NS = 1_000_000_000
"""Between poses farther apart the motion isn't steady."""
_HOLDS_NS = 500_000_000
"""So long after its last pose a motion goes on."""
_MOST_AWAY_NS = 1_000_000_000
"""Points measured farther from the frame's instant have wrong times."""
_MOST_MPS, _MOST_RADPS = 100.0, 5.0
"""No vehicle moves faster: such poses jumped."""


@dataclass(frozen=True, eq=False)
class Motion:
    """How the body moves, steadily, in its own axes."""

    turn_radps: Float64
    """(3,)"""
    speed_mps: Float64
    """(3,)"""


class Deskew:
    """Moves points to the instant of their frame: by their own times where the LiDAR gives them, else by that of the
    sweep, so that LiDARs with different stamps fit together.

    The motion is that between the last two frames with a pose, taken for steady; before the second one points stay
    where they are. Things that move themselves stay smeared by their own motion.
    """

    def __init__(self, log_info: LogInfo) -> None:
        self._log_info = log_info
        self.reset()

    def reset(self) -> None:
        """Forget the poses."""
        self._pose: Pose | None = None
        self._motion: Motion | None = None

    def note(self, pose: Pose | None, stamp_ns: int) -> None:
        """Take the pose of the next frame, at whose instant `stamp_ns` points are wanted."""
        before = self._pose
        if pose is not None and (before is None or pose.stamp_ns != before.stamp_ns):
            self._pose, self._motion = pose, None if before is None else motion(before, pose)
        if self._pose is not None and abs(stamp_ns - self._pose.stamp_ns) > _HOLDS_NS:
            self._motion = None

    def moved(self, xyz: Float64, cloud: PointCloud, rows: Int64, stamp_ns: int) -> Float64:
        """Move points (N, 3) [m] in body coordinates, which are the chosen `rows` of a sweep, to `stamp_ns`."""
        has_times = cloud.offset_ns is not None and not self._is_frozen(cloud.sensor)
        if self._motion is None or not (has_times or cloud.stamp_ns != stamp_ns):
            return xyz
        after_ns = np.full(len(xyz), cloud.stamp_ns - stamp_ns, np.int64)
        if has_times and cloud.offset_ns is not None:
            after_ns += cloud.offset_ns[rows]
        if np.abs(after_ns).max(initial=0) > _MOST_AWAY_NS:
            return xyz
        after_s = after_ns.astype(np.float64) * 1e-9
        return carried(xyz, after_s, self._motion.turn_radps, self._motion.speed_mps)

    def _is_frozen(self, lidar: str) -> bool:
        return self._log_info.metadata.get(f"lidar.{lidar}.motion") == FROZEN


def motion(before: Pose, after: Pose) -> Motion | None:
    """Return the steady motion from one pose to the next; `None` where they are too far apart in time, or jumped."""
    between_ns = after.stamp_ns - before.stamp_ns
    if not 0 < between_ns <= _MOST_BETWEEN_NS:
        return None
    poses = np.array([before.world_T_body, after.world_T_body])
    if not np.isfinite(poses).all():
        return None
    first, second = RigidTransform.from_matrix(poses)
    twist = np.asarray((first.inv() * second).as_exp_coords(), np.float64) / (between_ns * 1e-9)
    turn, speed = twist[:3], twist[3:]
    is_sane = np.sqrt((turn**2).sum()) <= _MOST_RADPS and np.sqrt((speed**2).sum()) <= _MOST_MPS
    return Motion(turn, speed) if is_sane else None
