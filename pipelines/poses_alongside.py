"""Where the body was at the instant of each frame, reading the log's poses alongside."""

from collections.abc import Iterator

from fbench.replay.arrays import Float64
from fbench.replay.data import Frame, Pose
from fbench.replay.frame_poses import FramePoses

_LOOK_AHEAD_NS = 2_000_000_000
"""Poses are read so far behind a frame's arrival in search of the one that follows it."""


class PosesAlongside:
    """Interpolates between the poses around a frame, as for truth, though the later one isn't there yet when the frame
    is complete.

    Args:
        poses: In the order in which they were recorded.
        name: The stream that counts.
    """

    def __init__(self, poses: Iterator[Pose], name: str | None) -> None:
        self._poses, self._found, self._num = poses, FramePoses(name), 0
        self._next = next(poses, None)

    def world_T_body(self, frame: Frame) -> Float64 | None:
        """Pose (4, 4) at a frame's instant; `None` where unknown. Frames come in their order, each once."""
        index, self._num = self._num, self._num + 1
        arrived_ns = min((message.log_ns for message in frame.messages.values()), default=frame.stamp_ns)
        while self._next is not None and self._next.log_ns <= arrived_ns:
            self._take(self._next)
        self._found.open(index, frame.stamp_ns)
        while self._found.is_waiting:
            if self._next is None or self._next.log_ns > arrived_ns + _LOOK_AHEAD_NS:
                self._found.finish()
            else:
                self._take(self._next)
        return self._found.world_T_body(index)

    def _take(self, pose: Pose) -> None:
        self._found.add(pose)
        self._next = next(self._poses, None)
