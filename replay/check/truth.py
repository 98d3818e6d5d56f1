"""Findings about ground truth, and whether its stamps and those of the sensors are of one clock.

A sample of sweeps and boxes is kept while a log is read once; at the end `best_shift` judges it.
"""

from array import array
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.replay.check.clock_shift import REACH_NS, STEP_NS, Shift, Sweep, fits, make_tracks, shift
from fbench.replay.check.findings import Finding, finding
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D
from fbench.replay.data.messages import Message, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import Rig
from fbench.replay.engine.cleaning import Skipped
from fbench.replay.geometry.transforms import transform
from fbench.replay.truth.labelling import TOLERANCE_NS, is_real


@dataclass
class TruthCheck:
    """Looks at each message of truth and keeps its stamp."""

    num_boxes: int = 0
    num_repeated: int = 0
    num_unreal: int = 0
    first_repeated: str = ""
    first_unreal: str = ""
    _stamps: "array[int]" = field(default_factory=lambda: array("q"))
    _numbers: "array[int]" = field(default_factory=lambda: array("q"))

    def add(self, truth: Truth) -> None:
        """Look at one message."""
        self._stamps.append(truth.stamp_ns)
        self._numbers.append(-1 if truth.frame_number is None else truth.frame_number)
        for boxes in (truth.boxes3d, truth.boxes2d):
            if boxes is not None:
                self._boxes(truth.stamp_ns, boxes)

    @property
    def num_messages(self) -> int:
        """Messages so far."""
        return len(self._stamps)

    def labelled(self, stamps: Int64, numbers: Int64) -> Bool:
        """Tell which frames, by stamp and number (-1: none), have truth."""
        return _near(stamps, np.array(self._stamps, np.int64)) | _numbered(numbers, np.array(self._numbers, np.int64))

    def findings(self, stamps: Int64, numbers: Int64) -> Iterator[Finding]:
        """Judge the truth of a log with these frames."""
        num = self.num_messages
        if num == 0:
            yield finding("GT001", "", "no ground truth", 0)
            return
        if self.num_repeated:
            text = f"{self.num_repeated} of {self.num_boxes} boxes have the id of another one of their frame"
            yield finding("GT003", "truth", text, self.num_repeated, self.first_repeated)
        if self.num_unreal:
            text = f"{self.num_unreal} of {self.num_boxes} boxes aren't finite or have no size"
            yield finding("GT004", "truth", text, self.num_unreal, self.first_unreal)
        own, own_numbers = np.array(self._stamps, np.int64), np.array(self._numbers, np.int64)
        lost = np.flatnonzero(~(_near(own, stamps) | _numbered(own_numbers, numbers)))
        if len(lost):
            text = f"{len(lost)} of {num} messages of truth belong to no frame"
            yield finding("GT006", "truth", text, len(lost), f"stamp {int(own[lost[0]])} ns")

    def _boxes(self, stamp_ns: int, boxes: Boxes) -> None:
        where = f"stamp {stamp_ns} ns"
        self.num_boxes += len(boxes)
        if repeated := _num_repeated(boxes):
            self.num_repeated += repeated
            self.first_repeated = self.first_repeated or where
        if unreal := int(np.count_nonzero(~is_real(boxes))):
            self.num_unreal += unreal
            self.first_unreal = self.first_unreal or where


def _num_repeated(boxes: Boxes) -> int:
    """How many boxes have the id of one before them; -1 is none, and in images each camera has ids of its own."""
    if boxes.track_id is None:
        return 0
    cameras = boxes.camera.tolist() if isinstance(boxes, Boxes2D) else [""] * len(boxes)
    keys = [key for key in zip(cameras, boxes.track_id.tolist(), strict=True) if key[1] >= 0]
    return len(keys) - len(dict.fromkeys(keys))


def _near(stamps: Int64, others: Int64) -> Bool:
    """Tell which stamps have another one within the tolerance of labelling."""
    ordered = np.sort(others, kind="stable")
    if len(ordered) == 0:
        return np.zeros(len(stamps), bool)
    after = np.searchsorted(ordered, stamps)
    best = np.minimum(
        np.abs(stamps - ordered[np.minimum(after, len(ordered) - 1)]),
        np.abs(stamps - ordered[np.maximum(after, 1) - 1]),
    )
    near: Bool = best <= TOLERANCE_NS
    return near


def _numbered(numbers: Array, others: Array) -> Bool:
    same: Bool = (numbers >= 0) & np.isin(numbers, others)
    return same


REACH_M = 64.0  # Farther points [m from the body, along x or y] are left out
_CELL_M = 0.25
_GROUND_M = 4.0
_LOW_M, _HIGH_M = 0.4, 2.5
"""Points this far above the lowest one around them stand on the ground, but don't hang over it."""
_MAX_PLACES = 8000


def standing(xyz: Array, body_T_sensor: Float64) -> Float32:
    """Places (M, 2) [m] in body coordinates where something stands: of the points (N, 3) in the sensor's coordinates
    that are well above the lowest one of their 4 m, the mean of those in each quarter of a metre.

    The ground is told without knowing it, so that neither the mounting nor the heights of boxes matter. At most 8000
    places are given, evenly spread over all.
    """
    x, y, z = _standing_near(xyz, body_T_sensor)
    coarse = _cells(x, y, _GROUND_M)
    lowest = np.full(int(coarse.max(initial=0)) + 1, np.inf)
    np.minimum.at(lowest, coarse, z)
    height = z - lowest[coarse]
    upright = np.flatnonzero((height > _LOW_M) & (height < _HIGH_M))
    return _means(x[upright], y[upright])


def echoes(xyz: Array, body_T_sensor: Float64) -> Float32:
    """Places (M, 2) [m] in body coordinates of radar points (N, 3), of any height: the road gives few echoes."""
    x, y, _ = _standing_near(xyz, body_T_sensor)
    return _means(x, y)


def _standing_near(xyz: Array, body_T_sensor: Float64) -> tuple[Float64, Float64, Float64]:
    x, y, z = (np.ascontiguousarray(column) for column in transform(body_T_sensor, xyz).T)
    near = np.flatnonzero((np.abs(x) < REACH_M) & (np.abs(y) < REACH_M) & np.isfinite(z))
    return x[near], y[near], z[near]


def _means(x: Float64, y: Float64) -> Float32:
    _, row, count = np.unique(_cells(x, y, _CELL_M), return_inverse=True, return_counts=True)
    sums = [np.bincount(row, weights=column, minlength=len(count)) for column in (x, y)]
    places = np.stack(sums, axis=1) / count[:, None]
    return places[:: -(-max(len(places), 1) // _MAX_PLACES)].astype(np.float32)


def _cells(x: Float64, y: Float64, edge_m: float) -> Int64:
    """Number of the square that each point is in."""
    across = round(2 * REACH_M / edge_m)
    return np.asarray(((x + REACH_M) / edge_m).astype(np.int64) * across + ((y + REACH_M) / edge_m).astype(np.int64))


_WINDOW_NS = 500_000_000
_SPARE_NS = 45_000_000  # Of faster streams only some messages are taken
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
