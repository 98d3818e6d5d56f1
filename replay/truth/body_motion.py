"""Where the body was between its frames."""

from collections.abc import Sequence

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.data import Pose
from fbench.replay.frame_poses import pose_between, pose_of
from fbench.replay.geometry.transforms import chained, inverse
from fbench.replay.truth.labelling import Instant

_UNKNOWN = np.full(7, np.nan)


class BodyMotion:
    """Interpolates between the poses of the frames of a segment, which a finished run knows, too: so truth that is
    added later gets the same numbers.

    Args:
        instants: The frames.
        values: (N, 7) where the body was at each: position [m] and quaternion x, y, z, w, NaN where unknown.
    """

    def __init__(self, instants: Sequence[Instant], values: Float64) -> None:
        self._values = {instant.index: value for instant, value in zip(instants, values, strict=True)}
        self._stamps: dict[int, Int64] = {}
        """Of the frames of each segment, within which they ascend."""
        self._indices: dict[int, list[int]] = {}
        of: dict[int, list[Instant]] = {}
        for instant in instants:
            of.setdefault(instant.segment, []).append(instant)
        for segment, members in of.items():
            ordered = sorted(members, key=lambda instant: instant.stamp_ns)
            self._stamps[segment] = np.array([instant.stamp_ns for instant in ordered], np.int64)
            self._indices[segment] = [instant.index for instant in ordered]

    def body_T_body(self, index: int, segment: int, stamp_ns: int) -> Float64 | None:
        """Return the transform (4, 4) from body coordinates at a stamp to those at frame `index` of a segment; `None`
        where it isn't known.
        """
        at_frame, at_stamp = pose_of(self._values[index]), pose_of(self._at(segment, stamp_ns))
        return None if at_frame is None or at_stamp is None else chained(inverse(at_frame), at_stamp)

    def is_known(self, index: int) -> bool:
        """Whether frame `index` has a pose."""
        return pose_of(self._values[index]) is not None

    def _at(self, segment: int, stamp_ns: int) -> Float64:
        stamps = self._stamps[segment]
        place = int(np.searchsorted(stamps, stamp_ns))
        after = self._pose(segment, place) if place < len(stamps) else None
        if after is None or after.stamp_ns == stamp_ns:
            return _UNKNOWN if after is None else np.concatenate([after.translation_m, after.rotation_xyzw])
        before = self._pose(segment, place - 1) if place else None
        return _UNKNOWN if before is None else pose_between(before, after, stamp_ns)

    def _pose(self, segment: int, row: int) -> Pose | None:
        value, stamp_ns = self._values[self._indices[segment][row]], int(self._stamps[segment][row])
        return None if np.isnan(value).any() else Pose("", stamp_ns, stamp_ns, value[:3], value[3:])
