"""Poses of the body at the instants of the frames, from a stream of poses."""

from array import array
from bisect import bisect_left, insort
from collections import deque
from operator import attrgetter

import numpy as np

from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import Pose
from fbench.replay.geometry.transforms import pose_matrix
from fbench.replay.logs.coordinate_frames import invalid

MAX_BETWEEN_NS = 1_000_000_000  # Between poses farther apart nothing is known
MAX_BEYOND_NS = 50_000_000  # So long a pose holds where none comes before or after it
MAX_KEPT_NS = 10_000_000_000  # Poses older than the newest by more are forgotten: no frame opens so late
MAX_BACK_NS = 1_000_000_000  # Poses that are further behind the newest are of a clock that was set back
_UNKNOWN = np.full(7, np.nan)
NUM = 7  # Position [m] and quaternion x, y, z, w


class FramePoses:
    """Keeps seven numbers a frame: interpolated between the poses before and after its instant. Positions are
    interpolated linearly, rotations on the shortest arc. A frame may open long after the poses around it came: a sweep
    is recorded when it is over, and often stamped as it begins.
    """

    def __init__(self, name: str | None) -> None:
        """Begin; `name` is that of the stream, `None` where the log has none."""
        self._name = name
        self._recent: list[Pose] = []  # By stamp
        self._waiting: deque[tuple[int, int]] = deque()
        self._values = array("d")
        self.is_known = False  # Whether any frame has a pose

    def open(self, index: int, stamp_ns: int) -> None:
        """Take the next frame; its pose may come later."""
        self._values.extend(_UNKNOWN)
        if self._recent and stamp_ns <= self._recent[-1].stamp_ns:
            self._set(index, self._at(stamp_ns))
        elif self._name is not None:
            self._waiting.append((index, stamp_ns))

    def add(self, pose: Pose) -> None:
        """Take a pose; of several streams that of the first name counts."""
        if pose.sensor != self._name or invalid(pose.translation_m, pose.rotation_xyzw) is not None:
            return
        if self._recent and pose.stamp_ns < self._recent[-1].stamp_ns - MAX_BACK_NS:
            self.finish()
            self._recent.clear()
        insort(self._recent, pose, key=attrgetter("stamp_ns"))
        while self._waiting and self._waiting[0][1] <= pose.stamp_ns:
            index, stamp_ns = self._waiting.popleft()
            self._set(index, self._at(stamp_ns))
        oldest_ns = self._recent[-1].stamp_ns - MAX_KEPT_NS
        if self._recent[0].stamp_ns < oldest_ns - MAX_BACK_NS:  # not at every pose
            del self._recent[: bisect_left(self._recent, oldest_ns, key=attrgetter("stamp_ns"))]

    def finish(self) -> None:
        """No pose of this clock comes any more: what waits gets the last one, if that is near."""
        for index, stamp_ns in self._waiting:
            self._set(index, self._at(stamp_ns))
        self._waiting.clear()

    @property
    def is_waiting(self) -> bool:
        """Whether a frame's pose is still to come."""
        return bool(self._waiting)

    @property
    def values(self) -> Float64:
        """(N, 7) of all frames, the first one's first; NaN where unknown."""
        return np.array(self._values, np.float64).reshape(-1, NUM)

    def world_T_body(self, index: int) -> Float64 | None:
        """Pose (4, 4) at a frame; `None` where unknown."""
        return pose_of(np.array(self._values[NUM * index : NUM * index + NUM]))

    def _at(self, stamp_ns: int) -> Float64:
        place = bisect_left(self._recent, stamp_ns, key=attrgetter("stamp_ns"))
        around = self._recent[max(place - 1, 0) : place + 1]
        if len(around) == 2 and place > 0:
            return pose_between(around[0], around[1], stamp_ns)
        return _near(around[0], stamp_ns) if around else _UNKNOWN

    def _set(self, index: int, value: Float64) -> None:
        if not np.isnan(value[0]):
            self.is_known = True
            self._values[NUM * index : NUM * index + NUM] = array("d", value.tolist())


def pose_of(value: Float64) -> Float64 | None:
    """Return the matrix (4, 4) of seven numbers; `None` where they are NaN."""
    return None if np.isnan(value).any() else pose_matrix(value[:3], value[3:])


def _near(pose: Pose, stamp_ns: int) -> Float64:
    if abs(pose.stamp_ns - stamp_ns) > MAX_BEYOND_NS:
        return _UNKNOWN
    return np.concatenate([pose.translation_m, pose.rotation_xyzw])


def pose_between(before: Pose, after: Pose, stamp_ns: int) -> Float64:
    """Seven numbers at a stamp between those of two poses; NaN where they are too far apart."""
    from scipy.spatial.transform import Rotation, Slerp  # takes a while to import

    if after.stamp_ns - before.stamp_ns > MAX_BETWEEN_NS or stamp_ns in (before.stamp_ns, after.stamp_ns):
        return _near(min(before, after, key=lambda p: abs(p.stamp_ns - stamp_ns)), stamp_ns)
    share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    turn = Slerp([0.0, 1.0], Rotation.from_quat([before.rotation_xyzw, after.rotation_xyzw]))
    return np.concatenate([(1 - share) * before.translation_m + share * after.translation_m, turn(share).as_quat()])
