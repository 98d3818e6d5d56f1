"""Whether stamps of LiDARs and radars and those of the truth are of one clock: what they see must fall onto the boxes.

A sample of sweeps and boxes is kept while a log is read once; at the end `best_shift` judges it.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping

import numpy as np

from fbench.replay.arrays import Array, Float64, Int64
from fbench.replay.boxes import Boxes3D
from fbench.replay.check.best_shift import STEP_NS, Shift, shift
from fbench.replay.check.fall_in import REACH_NS, Sweep, fits, make_tracks
from fbench.replay.check.finding import Finding, finding
from fbench.replay.check.standing import REACH_M, echoes, standing
from fbench.replay.data import Message, PointCloud, RadarScan, Rig, Truth
from fbench.replay.skipped import Skipped

_WINDOW_NS = 500_000_000
_SPARE_NS = 45_000_000
"""Of faster streams only some messages are taken."""
_MAX_SWEEPS, _MAX_TRUTHS = 160, 2000
_MAX_BOXES, _MAX_SIZE_M = 64, 30.0


class TruthClock:
    """Keeps a bounded sample of sweeps and boxes of short windows of time, evenly spread over the log.

    Which windows are kept depends on stamps alone, so that it doesn't matter whether truth comes before or after the
    sweeps in the log: every second one is dropped where they hold too many sweeps.
    """

    def __init__(self) -> None:
        self._sweeps: dict[str, list[Sweep]] = defaultdict(list)
        self._truths: dict[int, tuple[Int64, Float64]] = {}
        self._last: dict[str, int] = {}
        self._stride = 1
        self._is_idle = False
        """Boxes without track ids don't tell where they are between two instants."""

    def add_truth(self, truth: Truth) -> None:
        """Take a message of truth; only boxes with track ids in body coordinates and with a stamp count."""
        boxes = truth.boxes3d
        if boxes is None or truth.in_world or truth.frame_index is not None:
            return
        if len(boxes):
            self._is_idle = boxes.track_id is None and not self._truths
        if self._is_spare("", truth.stamp_ns) or not self._is_near(truth.stamp_ns):
            return
        near = boxes[_nearest(boxes)]
        if near.track_id is not None and len(near):
            shape = np.column_stack([near.center_m[:, :2], near.size_lwh_m[:, :2], near.yaw_rad])
            self._truths[truth.stamp_ns] = (near.track_id, shape)
        self._thin_out()

    def add_sweep(self, message: Message | Skipped, rig: Rig) -> None:
        """Take a sweep of a LiDAR or a scan of a radar with the stamp that counts; nothing else matters."""
        if not isinstance(message, PointCloud | RadarScan):
            return
        stamp_ns, name = message.stamp_ns, message.sensor
        if (
            self._is_idle
            or name not in rig.mounts
            or not self._is_kept(stamp_ns // _WINDOW_NS)
            or self._is_spare(name, stamp_ns)
        ):
            return
        body_T_sensor = rig.body_T_sensor(name)
        of_kind = standing if isinstance(message, PointCloud) else echoes
        self._sweeps[name].append(Sweep(stamp_ns, body_T_sensor[:2, 3], of_kind(message.xyz, body_T_sensor)))
        self._thin_out()

    def findings(self, offsets_ns: Mapping[str, int], reference: str | None) -> Iterator[Finding]:
        """Judge each sensor; `offsets_ns` were added to stamps already."""
        tracks = make_tracks(self._truths)
        for name, sweeps in sorted(self._sweeps.items()):
            found = shift([fit for sweep in sweeps for fit in fits(sweep, tracks)])
            if found is not None:
                yield _told(name, found, offsets_ns.get(name, 0), name == reference)

    def _is_kept(self, window: int) -> bool:
        return window % self._stride == 0

    def _is_near(self, stamp_ns: int) -> bool:
        """Tell whether a sweep that is kept needs boxes of this instant, to look up an offset between two of them."""
        reach_ns = REACH_NS + 2 * _WINDOW_NS
        first, last = (stamp_ns - reach_ns) // _WINDOW_NS, (stamp_ns + reach_ns) // _WINDOW_NS
        return any(self._is_kept(window) for window in range(first, last + 1))

    def _is_spare(self, name: str, stamp_ns: int) -> bool:
        if 0 <= stamp_ns - self._last.get(name, -_SPARE_NS) < _SPARE_NS:
            return True
        self._last[name] = stamp_ns
        return False

    def _thin_out(self) -> None:
        while sum(map(len, self._sweeps.values())) > _MAX_SWEEPS or len(self._truths) > _MAX_TRUTHS:
            self._stride *= 2
            for name, sweeps in self._sweeps.items():
                self._sweeps[name] = [s for s in sweeps if self._is_kept(s.stamp_ns // _WINDOW_NS)]
            self._truths = {stamp_ns: kept for stamp_ns, kept in self._truths.items() if self._is_near(stamp_ns)}


def _nearest(boxes: Boxes3D) -> Array:
    """Rows of the nearest usable boxes."""
    distance = np.hypot(boxes.center_m[:, 0], boxes.center_m[:, 1])
    usable = np.isfinite(boxes.geometry).all(axis=1) & (distance < REACH_M)
    usable &= (boxes.size_lwh_m[:, :2] > 0).all(axis=1) & (boxes.size_lwh_m[:, :2] < _MAX_SIZE_M).all(axis=1)
    if boxes.track_id is not None:
        usable &= boxes.track_id >= 0
    rows = np.flatnonzero(usable)
    return rows[np.argsort(distance[rows], kind="stable")][:_MAX_BOXES]


def _told(name: str, found: Shift, given_ns: int, is_reference: bool) -> Finding:
    spread_ns = max(found.spread_ns, STEP_NS)
    text = (
        f"its points fall onto the truth boxes best with its stamps moved by {found.offset_ns / 1e6:+.0f} ms (standard "
        f"deviation {spread_ns / 1e6:.0f} ms): of what stands in and around boxes {found.share:.0%} is inside then, "
        f"{found.share_before:.0%} now ({found.num_tracks} tracks, {found.num_sweeps} sweeps)"
    )
    advice = f"try --offset {name}={(given_ns + found.offset_ns) / 1e6:.0f}"
    if is_reference:
        advice = f"look at how truth was stamped: frames take their instants from {name}, which --offset can't move"
    return finding("TIM012", name, text, found.num_sweeps, advice=advice)
