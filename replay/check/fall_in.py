"""How well what a sensor sees falls onto the truth boxes, if its stamps were moved."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Array, Float32, Float64, Int64

REACH_NS = 500_000_000
"""Largest offset that is tried."""
OFFSETS_NS = np.arange(-REACH_NS, REACH_NS + 1, 10_000_000)
_MAX_GAP_NS = 800_000_000
"""Between truths farther apart nothing is known about a box."""
_MIN_PATH_M = 1.0
"""A box that moves less than this over all offsets tells nothing about them."""
_MAX_BOXES = 6
_OUTER_M, _INNER_M = 0.2, 0.35
"""Standard deviations of what is seen in front of a box's sides and behind them."""
_DEEP = 0.35
"""How well places deep inside agree, against those on a side."""
_EDGE_M = 0.4
_AROUND_M, _MARGIN_M = 2.0, 0.25


@dataclass(frozen=True, eq=False)
class Sweep:
    """What stood around at one instant."""

    stamp_ns: int
    eye_m: Float64
    """(2,) the sensor in body coordinates [m]."""
    places: Float32
    """(M, 2) in body coordinates [m]."""


@dataclass(frozen=True, eq=False)
class Track:
    """One object of the truth: its footprints by ascending stamp, in body coordinates."""

    track_id: int
    stamp_ns: Int64
    """(N,)."""
    shape: Float64
    """(N, 5) centre x and y, length, width [m], yaw [rad], which jumps by less than a quarter turn."""

    def at(self, stamps_ns: Int64) -> Float64 | None:
        """Footprints (K, 5) at these ascending stamps, between those of the truth; `None` where one isn't known."""
        if stamps_ns[0] <= self.stamp_ns[0] or stamps_ns[-1] > self.stamp_ns[-1]:
            return None
        after = np.searchsorted(self.stamp_ns, stamps_ns)
        steps = self.stamp_ns[after] - self.stamp_ns[after - 1]
        if (steps > _MAX_GAP_NS).any():
            return None
        share = ((stamps_ns - self.stamp_ns[after - 1]) / steps)[:, None]
        return np.asarray((1 - share) * self.shape[after - 1] + share * self.shape[after], np.float64)


@dataclass(frozen=True, eq=False)
class Fit:
    """How well one sweep fits one track, by `OFFSETS_NS`."""

    stamp_ns: int
    track_id: int
    score: Float64
    """(K,) 0 to 1: agreement with the sides of the box that the sensor sees."""
    num_inside: Int64
    """(K,) places in the footprint; `num_around` are within two metres of it."""
    num_around: Int64
    moved_m: Float64
    """(K,) how far the box is from where it is without an offset [m]."""


def make_tracks(truths: Mapping[int, tuple[Int64, Float64]]) -> list[Track]:
    """Sort boxes by track: `truths` holds ids (N,) and footprints (N, 5) by stamp."""
    rows: dict[int, dict[int, Float64]] = {}
    for stamp_ns, (ids, shapes) in sorted(truths.items()):
        for track_id, shape in zip(ids.tolist(), shapes, strict=True):
            rows.setdefault(track_id, {}).setdefault(stamp_ns, shape)
    return [_track(track_id, row) for track_id, row in sorted(rows.items()) if len(row) > 1]


def _track(track_id: int, rows: Mapping[int, Float64]) -> Track:
    shape = np.array(list(rows.values()))
    shape[:, 4] = np.unwrap(shape[:, 4], period=np.pi)  # front and back of a footprint are alike
    return Track(track_id, np.array(list(rows), np.int64), shape)


def fits(sweep: Sweep, tracks: Sequence[Track]) -> list[Fit]:
    """Compare a sweep with the nearest boxes that move relative to the body."""
    stamps = sweep.stamp_ns + OFFSETS_NS
    zero = len(OFFSETS_NS) // 2
    paths = [(track, path) for track in tracks if (path := track.at(stamps)) is not None]
    moving = [(t, p) for t, p in paths if np.hypot(*(p[:, :2].max(axis=0) - p[:, :2].min(axis=0))) > _MIN_PATH_M]
    moving.sort(key=lambda item: (float(np.hypot(*item[1][zero, :2])), item[0].track_id))
    return [fit for t, p in moving[:_MAX_BOXES] if (fit := _fit(sweep, t.track_id, p)) is not None]


def _fit(sweep: Sweep, track_id: int, path: Float64) -> Fit | None:
    places = _beside(sweep.places, path)
    u, v = _in_boxes(places, path)
    eye_u, eye_v = _in_boxes(sweep.eye_m[None], path)
    half_l, half_w = path[:, 2, None] / 2, path[:, 3, None] / 2
    score = _agreement(u, v, eye_u, eye_v, half_l, half_w).sum(axis=1)
    best = float(score.max(initial=0.0))
    if best < 1.0:
        return None
    inside = (np.abs(u) < half_l + _MARGIN_M) & (np.abs(v) < half_w + _MARGIN_M)
    around = (np.abs(u) < half_l + _AROUND_M) & (np.abs(v) < half_w + _AROUND_M)
    start = path[len(path) // 2, :2]
    return Fit(
        sweep.stamp_ns, track_id, score / best * min(1.0, best / 10), inside.sum(axis=1), around.sum(axis=1),
        np.hypot(path[:, 0] - start[0], path[:, 1] - start[1]),
    )  # fmt: skip


def _beside(places: Float32, path: Float64) -> Float64:
    """Those places (N, 2) that may be in or around a footprint of the path."""
    reach = float(np.hypot(path[:, 2], path[:, 3]).max()) / 2 + _AROUND_M
    low, high = path[:, :2].min(axis=0) - reach, path[:, :2].max(axis=0) + reach
    return np.asarray(places[((places > low) & (places < high)).all(axis=1)], np.float64)


def _in_boxes(places: Float64, path: Float64) -> tuple[Float64, Float64]:
    """Coordinates along and across each footprint, (K, N) each."""
    x: Float64 = places[None, :, 0] - path[:, 0, None]
    y: Float64 = places[None, :, 1] - path[:, 1, None]
    cos, sin = np.cos(path[:, 4, None]), np.sin(path[:, 4, None])
    return np.asarray(cos * x + sin * y, np.float64), np.asarray(cos * y - sin * x, np.float64)


def _agreement(u: Array, v: Array, eye_u: Array, eye_v: Array, half_l: Array, half_w: Array) -> Float64:
    """1 on the sides that face the sensor, falling to 0 outside; inside to a third: windows, wheels, round corners."""
    depth_u, depth_v = _depth(u, eye_u, half_l), _depth(v, eye_v, half_w)
    depth = np.minimum(depth_u, depth_v)
    outside = (np.abs(u) > half_l + _EDGE_M) | (np.abs(v) > half_w + _EDGE_M)
    near = np.exp(-0.5 * (depth / np.where(depth < 0, _OUTER_M, _INNER_M)) ** 2)
    return np.asarray(np.where(outside, 0.0, np.where(depth < 0, near, _DEEP + (1 - _DEEP) * near)), np.float64)


def _depth(at: Array, eye: Array, half: Array) -> Float64:
    """How far behind the side that faces the sensor; infinite where neither of the two does."""
    return np.asarray(np.where(np.abs(eye) > half, half - np.sign(eye) * at, np.inf), np.float64)
