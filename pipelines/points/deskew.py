"""Points that a moving LiDAR measured one after the other, put where the body would have seen them at one instant."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from fbench.pipelines.points.deskew_kernel import carried
from fbench.replay.arrays import Float64, Int64
from fbench.replay.data import LogInfo, PointCloud, Pose

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
