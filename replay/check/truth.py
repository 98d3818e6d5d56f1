"""Findings about ground truth, and a sample from which `judge_clock` tells whether its clock is that of a sensor."""

from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping

import numpy as np

from fbench.replay.check.clock_shift import REACH_NS, Sweep, fit_tracks, judge_clock, make_tracks
from fbench.replay.check.findings import Finding, finding
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.data.boxes import MAX_BOXES, Boxes, Boxes2D, Boxes3D, most_boxes
from fbench.replay.data.messages import Message, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import Rig
from fbench.replay.data.scores import format_count
from fbench.replay.engine.cleaning import Skipped
from fbench.replay.geometry.transforms import transform
from fbench.replay.truth.labelling import TOLERANCE_NS, is_real

_OF_BOXES = {
    "GT003": "have the id of another one of their frame",
    "GT004": "aren't finite or have no size",
    "GT008": f"are in frames with more than {MAX_BOXES}",
}


class TruthCheck:
    """Looks at each message of truth and keeps its stamp."""

    def __init__(self) -> None:
        self._stamps, self._numbers = array("q"), array("q")
        self._num_boxes = 0
        self._bad: Counter[str] = Counter()  # Boxes by code
        self._first: dict[str, str] = {}  # Where each code was met first

    def add(self, truth: Truth) -> None:
        """Look at one message."""
        self._stamps.append(truth.stamp_ns)
        self._numbers.append(-1 if truth.frame_number is None else truth.frame_number)
        for boxes in (truth.boxes3d, truth.boxes2d):
            if boxes is None:
                continue
            self._num_boxes += len(boxes)
            bad = {"GT003": _count_repeated(boxes), "GT004": int(np.count_nonzero(~is_real(boxes)))}
            for code, num in {**bad, "GT008": len(boxes) * (most_boxes(boxes) > MAX_BOXES)}.items():
                if num:
                    self._bad[code] += num
                    self._first.setdefault(code, f"stamp {truth.stamp_ns} ns")

    @property
    def num_messages(self) -> int:
        """Messages so far."""
        return len(self._stamps)

    def find_labeled(self, stamps: Int64, numbers: Int64) -> Bool:
        """Tell which frames, by stamp and number (-1: none), have truth."""
        return _have_partner(stamps, numbers, np.array(self._stamps, np.int64), np.array(self._numbers, np.int64))

    def findings(self, stamps: Int64, numbers: Int64) -> Iterator[Finding]:
        """Judge the truth of a log with these frames."""
        if not self._stamps:
            yield finding("GT001", "", "no ground truth", 0)
            return
        for code, num in self._bad.items():
            yield finding(code, "truth", f"{num} of {self._num_boxes} boxes {_OF_BOXES[code]}", num, self._first[code])
        own = np.array(self._stamps, np.int64)
        lost = np.flatnonzero(~_have_partner(own, np.array(self._numbers, np.int64), stamps, numbers))
        if len(lost):
            text = f"{len(lost)} of {format_count(len(own), 'message')} of truth belong to no frame"
            yield finding("GT006", "truth", text, len(lost), f"stamp {int(own[lost[0]])} ns")


def _count_repeated(boxes: Boxes) -> int:
    """How many boxes have the id of one before them; -1 is none, and in images each camera has ids of its own."""
    if boxes.track_id is None:
        return 0
    cameras = boxes.camera.tolist() if isinstance(boxes, Boxes2D) else [""] * len(boxes)
    keys = [key for key in zip(cameras, boxes.track_id.tolist(), strict=True) if key[1] >= 0]
    return len(keys) - len(set(keys))


def _have_partner(stamps: Int64, numbers: Int64, others: Int64, other_numbers: Int64) -> Bool:
    """Tell which stamps have one of the others within the tolerance of labelling, or the same number."""
    found: Bool = (numbers >= 0) & np.isin(numbers, other_numbers)
    if len(others):
        ordered = np.sort(others, kind="stable")
        after = np.searchsorted(ordered, stamps)
        before, behind = ordered[np.maximum(after, 1) - 1], ordered[np.minimum(after, len(ordered) - 1)]
        found |= np.minimum(np.abs(stamps - behind), np.abs(stamps - before)) <= TOLERANCE_NS
    return found


REACH_M = 64.0  # Farther points [m from the body, along x or y] are left out
_CELL_M = 0.25
_GROUND_M = 4.0
_LOW_M, _HIGH_M = 0.4, 2.5
"""Points this far above the lowest one around them stand on the ground, but don't hang over it."""
_MAX_PLACES = 8000


def _find_places(xyz: Array, body_T_sensor: Float64, keep_ground: bool) -> Float32:
    """Places (M, 2) [m] in body coordinates of points (N, 3) in the sensor's: the mean of those in each quarter of a
    meter, at most 8000, evenly spread over all. Without the ground only points well above the lowest one of their 4 m
    count: so neither the mounting nor the heights of boxes matter.
    """
    x, y, z = (np.ascontiguousarray(column) for column in transform(body_T_sensor, xyz).T)
    rows = np.flatnonzero((np.abs(x) < REACH_M) & (np.abs(y) < REACH_M) & np.isfinite(z))
    x, y, z = x[rows], y[rows], z[rows]
    if not keep_ground:
        coarse = _cells(x, y, _GROUND_M)
        lowest = np.full(int(coarse.max(initial=0)) + 1, np.inf)
        np.minimum.at(lowest, coarse, z)
        height = z - lowest[coarse]
        upright = np.flatnonzero((height > _LOW_M) & (height < _HIGH_M))
        x, y = x[upright], y[upright]
    _, row, count = np.unique(_cells(x, y, _CELL_M), return_inverse=True, return_counts=True)
    sums = [np.bincount(row, weights=column, minlength=len(count)) for column in (x, y)]
    places = np.stack(sums, axis=1) / count[:, None]
    return places[:: -(-max(len(places), 1) // _MAX_PLACES)].astype(np.float32)


def _cells(x: Float64, y: Float64, edge_m: float) -> Int64:
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
        near = boxes[_find_nearest(boxes)]
        if near.track_id is not None and len(near):
            shape = np.column_stack([near.center_m[:, :2], near.size_lwh_m[:, :2], near.yaw_rad])
            self._truths[truth.stamp_ns] = (near.track_id, shape)
        self._thin_out()

    def add_sweep(self, message: Message | Skipped, rig: Rig) -> None:
        """Take a sweep of a LiDAR or a scan of a radar with the stamp that counts; nothing else matters."""
        if not isinstance(message, PointCloud | RadarScan) or self._is_idle or message.sensor not in rig.mounts:
            return
        stamp_ns, name = message.stamp_ns, message.sensor
        if not self._is_kept(stamp_ns // _WINDOW_NS) or self._is_spare(name, stamp_ns):
            return
        body_T_sensor = rig.body_T_sensor(name)
        # The road gives few echoes of radar.
        places = _find_places(message.xyz, body_T_sensor, keep_ground=isinstance(message, RadarScan))
        self._sweeps[name].append(Sweep(stamp_ns, body_T_sensor[:2, 3], places))
        self._thin_out()

    def findings(self, offsets_ns: Mapping[str, int], reference: str | None) -> Iterator[Finding]:
        """Judge each sensor; `offsets_ns` were added to stamps already."""
        tracks = make_tracks(self._truths)
        for name, sweeps in sorted(self._sweeps.items()):
            fits = [fit for sweep in sweeps for fit in fit_tracks(sweep, tracks)]
            found = judge_clock(name, fits, offsets_ns.get(name, 0), is_reference=name == reference)
            if found is not None:
                yield found

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


def _find_nearest(boxes: Boxes3D) -> Array:
    distance = np.hypot(boxes.center_m[:, 0], boxes.center_m[:, 1])
    usable = np.isfinite(boxes.geometry).all(axis=1) & (distance < REACH_M)
    usable &= (boxes.size_lwh_m[:, :2] > 0).all(axis=1) & (boxes.size_lwh_m[:, :2] < _MAX_SIZE_M).all(axis=1)
    if boxes.track_id is not None:
        usable &= boxes.track_id >= 0
    rows = np.flatnonzero(usable)
    return rows[np.argsort(distance[rows], kind="stable")][:_MAX_BOXES]
