"""Where the body is, for trackers: poses as they come, continued where some are missing."""

from fbench.replay.arrays import Float64
from fbench.replay.geometry.transforms import extrapolated


class EgoPoses:
    """Remembers the last two poses, and goes on from them at constant speed and turn rate."""

    def __init__(self) -> None:
        self._poses: list[tuple[int, Float64]] = []

    @property
    def known(self) -> bool:
        """Whether there was a pose."""
        return bool(self._poses)

    def step(self, stamp_ns: int, world_T_body: Float64 | None) -> Float64 | None:
        """Return the pose (4, 4) to use at `stamp_ns`; `None` before the first."""
        if world_T_body is not None:
            self._poses = [*self._poses[-1:], (stamp_ns, world_T_body)]
            return world_T_body
        if len(self._poses) < 2:
            return self._poses[0][1] if self._poses else None
        (before_ns, before), (last_ns, last) = self._poses
        return extrapolated(before, last, (stamp_ns - last_ns) / (last_ns - before_ns))
