"""The offset of a sensor's stamps at which its measurements fall onto the truth boxes."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.check.findings import Finding, finding
from fbench.replay.data.arrays import Array, Float32, Float64, Int64
from fbench.replay.data.scores import format_count

REACH_NS = 500_000_000  # Largest offset that is tried
STEP_NS = 10_000_000
OFFSETS_NS = np.arange(-REACH_NS, REACH_NS + 1, STEP_NS)
_ZERO = len(OFFSETS_NS) // 2  # The offset of 0
_MAX_GAP_NS = 800_000_000  # Between truths farther apart nothing is known about a box
_MIN_PATH_M = 1.0  # A box that moves less than this over all offsets tells nothing about them
_MAX_BOXES = 6
_OUTER_M, _INNER_M = 0.2, 0.35  # Standard deviations of what is seen in front of a box's sides and behind them
_DEEP = 0.35  # How well places deep inside agree, against those on a side
_EDGE_M = 0.4
_AROUND_M, _MARGIN_M = 2.0, 0.25


@dataclass(frozen=True, eq=False)
class Sweep:
    """What stood around at one instant."""

    stamp_ns: int
    eye_m: Float64  # (2,) the sensor in body coordinates [m]
    places: Float32  # (M, 2) in body coordinates [m]


@dataclass(frozen=True, eq=False)
class Track:
    """One object of the truth: its footprints by ascending stamp, in body coordinates."""

    track_id: int
    stamp_ns: Int64  # (N,)
    shape: Float64  # (N, 5) center x and y, length, width [m], yaw [rad], which jumps by less than a quarter turn

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
    score: Float64  # (K,) 0 to 1: agreement with the sides of the box that the sensor sees
    num_inside: Int64  # (K,) places in the footprint; `num_around` are within two meters of it
    num_around: Int64
    moved_m: Float64  # (K,) how far the box is from where it is without an offset [m]


def make_tracks(truths: Mapping[int, tuple[Int64, Float64]]) -> list[Track]:
    """Sort boxes by track: `truths` holds ids (N,) and footprints (N, 5) by stamp."""
    rows: dict[int, dict[int, Float64]] = {}
    for stamp_ns, (ids, shapes) in sorted(truths.items()):
        for track_id, shape in zip(ids.tolist(), shapes, strict=True):
            rows.setdefault(track_id, {}).setdefault(stamp_ns, shape)
    tracks = []
    for track_id, row in sorted(rows.items()):
        if len(row) > 1:
            shape = np.array(list(row.values()))
            shape[:, 4] = np.unwrap(shape[:, 4], period=np.pi)  # front and back of a footprint are alike
            tracks.append(Track(track_id, np.array(list(row), np.int64), shape))
    return tracks


def fit_tracks(sweep: Sweep, tracks: Sequence[Track]) -> list[Fit]:
    """Compare a sweep with the nearest boxes that move relative to the body."""
    stamps = sweep.stamp_ns + OFFSETS_NS
    paths = [(track.track_id, path) for track in tracks if (path := track.at(stamps)) is not None]
    moving = [(id_, p) for id_, p in paths if np.hypot(*(p[:, :2].max(axis=0) - p[:, :2].min(axis=0))) > _MIN_PATH_M]
    moving.sort(key=lambda item: (float(np.hypot(*item[1][_ZERO, :2])), item[0]))
    return [fit for id_, path in moving[:_MAX_BOXES] if (fit := _fit(sweep, id_, path)) is not None]


def _fit(sweep: Sweep, track_id: int, path: Float64) -> Fit | None:
    # Only places that may be in or around a footprint of the path.
    reach = float(np.hypot(path[:, 2], path[:, 3]).max()) / 2 + _AROUND_M
    low, high = path[:, :2].min(axis=0) - reach, path[:, :2].max(axis=0) + reach
    places = np.asarray(sweep.places[((sweep.places > low) & (sweep.places < high)).all(axis=1)], np.float64)
    u, v = _in_boxes(places, path)
    eye_u, eye_v = _in_boxes(sweep.eye_m[None], path)
    half_l, half_w = path[:, 2, None] / 2, path[:, 3, None] / 2
    # 1 on the sides that face the sensor, falling to 0 outside; inside to a third: windows, wheels, round corners.
    depth = np.minimum(_depth(u, eye_u, half_l), _depth(v, eye_v, half_w))
    outside = (np.abs(u) > half_l + _EDGE_M) | (np.abs(v) > half_w + _EDGE_M)
    near = np.exp(-0.5 * (depth / np.where(depth < 0, _OUTER_M, _INNER_M)) ** 2)
    agreement = np.where(outside, 0.0, np.where(depth < 0, near, _DEEP + (1 - _DEEP) * near))
    score = np.asarray(agreement, np.float64).sum(axis=1)
    best = float(score.max(initial=0.0))
    if best < 1.0:
        return None
    inside = (np.abs(u) < half_l + _MARGIN_M) & (np.abs(v) < half_w + _MARGIN_M)
    around = (np.abs(u) < half_l + _AROUND_M) & (np.abs(v) < half_w + _AROUND_M)
    return Fit(
        sweep.stamp_ns, track_id, score / best * min(1.0, best / 10), inside.sum(axis=1), around.sum(axis=1),
        np.hypot(path[:, 0] - path[_ZERO, 0], path[:, 1] - path[_ZERO, 1]),
    )  # fmt: skip


def _in_boxes(places: Float64, path: Float64) -> tuple[Float64, Float64]:
    """Coordinates along and across each footprint, (K, N) each."""
    x: Float64 = places[None, :, 0] - path[:, 0, None]
    y: Float64 = places[None, :, 1] - path[:, 1, None]
    cos, sin = np.cos(path[:, 4, None]), np.sin(path[:, 4, None])
    return np.asarray(cos * x + sin * y, np.float64), np.asarray(cos * y - sin * x, np.float64)


def _depth(at: Array, eye: Array, half: Array) -> Float64:
    """How far behind the side that faces the sensor; infinite where neither of the two does."""
    return np.asarray(np.where(np.abs(eye) > half, half - np.sign(eye) * at, np.inf), np.float64)


_BLOCK_NS = 500_000_000
_MIN_BLOCKS, _NUM_DRAWS = 6, 400
_MIN_SHIFT_NS, _MAX_SPREAD_NS, _EDGE_NS = 60_000_000, 80_000_000, 20_000_000
_MIN_MOVED_M = 0.6  # Boxes that are larger than what they hold look like an offset that moves them by less
_MIN_GAIN = 0.08  # So much more of what stands in and around boxes must be inside
_NEAR_NS = 100_000_000  # Without any one of the tracks the offset is the same up to this


def judge_clock(sensor: str, fits: Sequence[Fit], added_ns: int, is_reference: bool) -> Finding | None:
    """Find the offset that all agree on; `None` where they tell none, or none that matters. `added_ns` was added to
    the sensor's stamps already.

    Fits of one track within half a second count as one observation. These are drawn anew (bootstrap: Efron, Annals of
    Statistics 7, 1979) to see how sure the best offset is, and each track is left out once: one with boxes of a wrong
    size must not decide alone.
    """
    blocks: dict[tuple[int, int], list[Fit]] = defaultdict(list)
    for fit in fits:
        blocks[fit.track_id, fit.stamp_ns // _BLOCK_NS].append(fit)
    keys = sorted(blocks)
    ids = np.array([track_id for track_id, _ in keys], np.int64)
    if len(keys) < _MIN_BLOCKS or len(np.unique(ids)) < 2:
        return None
    curves = np.array([np.mean([fit.score for fit in blocks[key]], axis=0) for key in keys])
    generator = np.random.Generator(np.random.Philox(key=len(keys)))
    draws = generator.integers(len(keys), size=(_NUM_DRAWS, len(keys)))
    counts = np.array([np.bincount(draw, minlength=len(keys)) for draw in draws], np.float64)
    drawn_ns = OFFSETS_NS[np.argmax(np.einsum("db,bk->dk", counts, curves), axis=1)]
    apart_ns = OFFSETS_NS[[int(np.argmax(curves[ids != one].sum(axis=0))) for one in np.unique(ids)]]
    offset_ns = round(float(np.mean(drawn_ns)) / STEP_NS) * STEP_NS
    spread_ns = round(float(np.std(drawn_ns)))
    low, high = np.quantile(drawn_ns, (0.02, 0.98))
    is_sure = low * high > 0 and 3 * spread_ns <= abs(offset_ns) and spread_ns <= _MAX_SPREAD_NS
    is_inside = _MIN_SHIFT_NS <= abs(offset_ns) <= REACH_NS - _EDGE_NS
    if not (is_sure and is_inside and np.abs(apart_ns - offset_ns).max() <= _NEAR_NS):
        return None
    # Boxes of a slightly wrong size may explain an offset as well.
    at = int(np.searchsorted(OFFSETS_NS, offset_ns))
    moved_m = float(np.median([fit.moved_m[at] for fit in fits]))
    nums = [(sum(int(f.num_inside[i]) for f in fits), sum(int(f.num_around[i]) for f in fits)) for i in (at, _ZERO)]
    share, before = (inside / max(around, 1) for inside, around in nums)
    if moved_m < _MIN_MOVED_M or share < before + _MIN_GAIN:
        return None
    num_sweeps, num_tracks = len({fit.stamp_ns for fit in fits}), len({fit.track_id for fit in fits})
    text = (
        f"its points fall onto the truth boxes best with its stamps moved by {offset_ns / 1e6:+.0f} ms "
        f"(standard deviation {max(spread_ns, STEP_NS) / 1e6:.0f} ms): of what stands in and around "
        f"boxes {share:.0%} is inside then, {before:.0%} now ({format_count(num_tracks, 'track')}, "
        f"{format_count(num_sweeps, 'sweep')})"
    )
    advice = f"try --offset {sensor}={(added_ns + offset_ns) / 1e6:.0f}"
    if is_reference:
        advice = f"look at how truth was stamped: frames take their instants from {sensor}, which --offset can't move"
    return finding("TIM012", sensor, text, num_sweeps, advice=advice)
