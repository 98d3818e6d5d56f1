"""Comparison without labels: how far two runs agree, and how steady the tracks of each are."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fbench.metrics.comparison.cells import CellPair
from fbench.metrics.comparison.counts import count_outcomes
from fbench.metrics.comparison.objects import Event, Kind, find_divergence, join_events, name_sensors, place_of
from fbench.metrics.core.problem import Problem
from fbench.metrics.core.slices import RANGES_M, Group, by_range
from fbench.metrics.detection.outcomes import Judgement, Outcome, compare_class, judge_detections
from fbench.metrics.runs.columns import objects_of
from fbench.metrics.runs.places import ground_points, has_poses
from fbench.metrics.tracking.clear import ClearPairs
from fbench.metrics.tracking.clear_events import SWITCH
from fbench.metrics.tracking.scores import follow_tracks
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import LABELS, Boxes2D, Boxes3D, finite
from fbench.replay.data.comparison import Comparison, ObjectChange, Row, State, Verdict
from fbench.replay.data.sequences import Objects, Steps
from fbench.replay.data.sequences import Sequence as Steady
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import BoxTable

_ANY = Group("any", LABELS, agnostic=True)
_DISTANCE_M, _IOU = 2.0, 0.5
_SMOOTH = 5  # Frames over which a track is smoothed
_BREAK_FRAMES, _BREAK_M = 3, 2.0  # A track that ends and another that begins so soon and near are one object
_VANISH_M = 40.0  # Nearer than this, an object doesn't vanish by itself
_LEAST_FRAMES = 5  # Of a track that is looked at
_LONG_FRAMES = 10  # A track of so many is rarely a false alarm
_SWITCH_FRAMES = 5.0  # Frames without the object that are as bad as a switch
_NEAR_M, _FAR_M = 10.0, 50.0  # Nearer ones don't count more; where the distance isn't known
_MOST_OBJECTS = 100


def compare_by_base(pairs: Sequence[CellPair], notes: tuple[str, ...], failures: tuple[str, ...]) -> Comparison:
    """Take the results of the base for truth: nothing is better or worse, only changed. Objects come first that matter
    most, see `_weigh`. Raises MetricError where a side is a baseline, or one works in images and the other in
    space.
    """
    rows: list[Row] = []
    objects: list[ObjectChange] = []
    for pair in pairs:
        if pair.base.run is None or pair.head.run is None:
            raise MetricError(f"{pair.name}: a baseline file holds no boxes; compare with the run itself")
        rows += _rows(pair, pair.base.run, pair.head.run)
        objects += rank_changes(pair.base.run, pair.head.run, str(pair.name))
    objects.sort(key=_rank)
    divergences = tuple(found for pair in pairs if (found := find_divergence(pair)) is not None)
    state: State = "failed" if failures else "passed" if divergences else "identical"
    first = tuple(objects[:_MOST_OBJECTS])
    cells = tuple(pair.entry for pair in pairs)
    return Comparison(tuple(rows), 0.0, state, failures, notes, divergences, first, (), True, cells)


def count_agreement(run: Run, other: Run) -> tuple[Int64, Int64]:
    """Count hits, false alarms and misses (F, 3) of each frame's detections with those of another pipeline for truth;
    and return the indices (F,) of these frames, which both runs have. Raises MetricError where one has boxes in images.
    """
    sequence = _beside(other, run, other.detections, run.detections)
    judged = judge_detections(compare_class(sequence, _ANY, _match(isinstance(run.detections.boxes, Boxes2D))))
    own = {frame.stamp_ns: frame.index for frame in run.frames}
    both = [(f.index, own[f.stamp_ns]) for f in other.frames if f.stamp_ns in own]
    others, index = np.array(both, np.int64).reshape(-1, 2).T
    return count_outcomes(judged, others), index


def _rows(pair: CellPair, base: Run, head: Run) -> Iterator[Row]:
    names = pair.name.pipeline, pair.name.condition
    flat = isinstance(base.detections.boxes, Boxes2D)
    matching = f"iou {_IOU:g}" if flat else f"bev {_DISTANCE_M:g} m"

    def row(metric: str, unit: str, one: float | None, two: float | None, why: str, part: str = "all") -> Row:
        delta = None if one is None or two is None else two - one
        verdict: Verdict = "null" if delta is None else "same" if delta == 0 else "changed"
        return Row(*names, metric, "any", part, matching, unit, one, two, delta, verdict, "", why, better="neither")

    tables = [("detections", base.detections, head.detections)]
    if base.manifest.has_tracks and head.manifest.has_tracks:
        tables.append(("tracks", base.tracks, head.tracks))
    for what, one, two in tables:
        sequence = _beside(base, head, one, two)
        candidates = compare_class(sequence, _ANY, _match(flat))
        parts = list(by_range(sequence, RANGES_M[-1])) if what == "detections" else []
        for part in (None, *parts):
            n = judge_detections(candidates if part is None else candidates.select(part)).counts
            num = 2 * n.tp + n.fp + n.fn
            value = 2 * n.tp / num if num else None
            why = f"{n.fn} lost, {n.fp} new boxes"
            one_of = 1.0 if value is not None else None
            yield row(f"agreement_{what}", "1", one_of, value, why, "all" if part is None else part.name)
    if len(tables) == 2:
        switches = float((_follow(base, head)[2].event & SWITCH != 0).sum())
        yield row("identity_changes", "1", 0.0, switches, "how often an object of the base changes its track")
        before, after = (measure_steadiness(run) for run in (base, head))
        for metric, (unit, why) in _STEADINESS.items():
            yield row(metric, unit, before.get(metric), after.get(metric), why)


def _match(flat: bool) -> Match:
    return Match("iou2d", _IOU) if flat else Match("bev", _DISTANCE_M)


def _beside(base: Run, head: Run, one: BoxTable, two: BoxTable) -> Steady:
    """Results of both runs at their common instants: those of the base as truth."""
    if type(one.boxes) is not type(two.boxes):
        raise MetricError("one run has boxes in images, the other in space; compare 3D with 3D, 2D with 2D")
    others = {frame.stamp_ns: frame.index for frame in head.frames}
    both = [(f.index, others[f.stamp_ns], f.stamp_ns, f.segment) for f in base.frames if f.stamp_ns in others]
    index, other, stamp_ns, segment = np.array(both, np.int64).reshape(-1, 4).T
    boxes = one.boxes
    cameras = tuple(sorted({*boxes.camera.tolist(), *two.boxes.camera.tolist()})) if isinstance(
        boxes, Boxes2D) and isinstance(two.boxes, Boxes2D) else ()  # fmt: skip
    num = max(len(cameras), 1)
    steps = Steps(
        np.repeat(index, num), np.repeat(stamp_ns, num),
        np.repeat(segment, num) * num + np.tile(np.arange(num), len(index)), cameras * len(index),
    )  # fmt: skip
    truth, estimates = (_place(table, frames, cameras) for table, frames in ((one, index), (two, other)))
    return Steady(base.manifest.log.name, steps, truth, estimates)


def _place(table: BoxTable, frames: Int64, cameras: tuple[str, ...]) -> Objects:
    order = np.argsort(frames, kind="stable")
    at = np.minimum(np.searchsorted(frames[order], table.frames), max(len(frames) - 1, 0))
    held = frames[order][at] == table.frames if len(frames) else np.zeros(len(table.frames), bool)
    held &= finite(table.boxes)[0]
    boxes, step = table.boxes[held], order[at[held]] if len(frames) else np.zeros(0, np.int64)
    if isinstance(boxes, Boxes2D):
        step = step * len(cameras) + np.searchsorted(cameras, boxes.camera) if len(boxes) else step
    return objects_of(replace(boxes, score=None), step.astype(np.int64), np.ones(len(boxes), bool))


def _follow(base: Run, head: Run) -> tuple[Judgement, Problem, ClearPairs]:
    flat = isinstance(base.tracks.boxes, Boxes2D)
    return follow_tracks(_beside(base, head, base.tracks, head.tracks), _ANY, _match(flat))


def _rank(change: ObjectChange) -> tuple[float, str, str]:
    return -(change.weight or 0.0), change.cell, str(change)


def rank_changes(base: Run, head: Run, cell: str = "") -> list[ObjectChange]:
    """Return objects that only one side has, and those of the base that change their track in the head, those first
    that matter most: near and for long, see `_weigh`. By tracks, where both have them, as those have names.
    """
    if not (base.manifest.has_tracks and head.manifest.has_tracks):
        return []
    judged, _, pairs = _follow(base, head)
    c, frame = judged.candidates, judged.candidates.sequence.steps.frame
    found = np.zeros(len(c.truth_row), bool)
    found[judged.truth_of_estimate[judged.truth_of_estimate >= 0]] = True
    hit = judged.outcome != Outcome.FALSE_ALARM
    switched = (pairs.event & SWITCH) != 0
    sides: tuple[tuple[Kind, Objects, Bool, Int64, str], ...] = (
        ("LOST", c.truth, found, np.flatnonzero(~found), "base"),
        ("FOUND", c.estimates, hit, np.flatnonzero(~hit), "head"),
        ("NEW SWITCH", c.truth, found, np.flatnonzero(switched), "base"),
    )
    records = {record.index: record for record in base.frames}
    events, weights = list[Event](), dict[tuple[Kind, int], float]()
    for kind, objects, is_shared, rows, who in sides:
        weights |= {(kind, i): w for i, w in _weigh(kind, objects.track_id, is_shared).items()}
        for row in rows.tolist():
            sources = "" if objects.sources is None else name_sensors(int(objects.sources[row]))
            index = int(frame[objects.step[row]])
            gone = ", ".join(f"no {name}" for name in records[index].missing) if kind == "LOST" else ""
            why = "; ".join(part for part in (gone, f"{sources or who} had it") if part)
            why = "base kept its track" if kind == "NEW SWITCH" else why
            place = place_of(objects, row)
            events.append(Event(kind, int(objects.track_id[row]), str(objects.label[row]), "", index, place, why))
    ranked = []
    for change in join_events(events, cell, records):
        track = -1 if change.track_id is None else change.track_id
        near = _NEAR_M / max(change.range_m or _FAR_M, _NEAR_M)
        weight = change.num_frames * near * weights.get((change.kind, track), 1.0)
        ranked.append(replace(change, weight=weight))
    return sorted(ranked, key=_rank)


def _weigh(kind: Kind, track_id: Int64, is_shared: Bool) -> dict[int, float]:
    """Return how much a frame of a change of each track counts, by its id: less for the new than for what is lost, and
    for tracks of few frames, which may be false alarms; more where both sides have the object at other times, so that
    it is there and vanishes in view. A switch counts as several frames.
    """
    ids, at, frames = np.unique(track_id, return_inverse=True, return_counts=True)
    shared = np.bincount(at, is_shared, minlength=len(ids))
    weight = np.where(shared > 0, 2.0, 1.0) * np.minimum(frames / _LONG_FRAMES, 1.0)
    weight *= {"LOST": 1.0, "FOUND": 0.5}.get(kind, _SWITCH_FRAMES)
    return dict(zip(ids.tolist(), weight.tolist(), strict=True))


_STEADINESS: Mapping[str, tuple[str, str]] = {
    "deviation_m": ("m", "root mean square distance of tracks from themselves, smoothed over 5 frames"),
    "jerk_mps3": ("m/s^3", "root mean square change of acceleration of tracks"),
    "flicker": ("1", "gaps of up to 3 frames in tracks"),
    "identity_breaks": ("1", "tracks that end where another begins within 3 frames and 2 m"),
    "vanished": ("1", "tracks that end nearer than 40 m, and no other begins there"),
}
"""What of tracks can be judged without labels: unit and meaning."""


@dataclass(frozen=True, eq=False)
class _Track:
    frame: Int64  # (N,) ascending, of one segment
    time_s: Float64
    xy: Float64  # (N, 2) [m], in the world where poses are known
    range_m: Float64


def measure_steadiness(run: Run) -> dict[str, float | None]:
    """Return how steady the tracks of a run are, by name as in `_STEADINESS`; `None` where no track is long enough, and
    nothing of tracks in images.
    """
    if not isinstance(run.tracks.boxes, Boxes3D) or run.tracks.boxes.track_id is None:
        return {}
    tracks = list(_tracks(run))
    last = {f.segment: f.index for f in run.frames}
    ends = set(last.values())
    away, jerks = [], []
    flicker = sum(int(((gaps := np.diff(t.frame)) > 1).sum() - (gaps > 4).sum()) for t in tracks)
    for track in (t for t in tracks if len(t.frame) >= _LEAST_FRAMES):
        away.append(track.xy[2:-2] - _smooth(track.xy))
        step_s = np.diff(track.time_s)
        if (step_s > 0).all() and len(step_s) >= 3:
            jerks.append(np.diff(track.xy, 3, axis=0) / float(np.median(step_s)) ** 3)
    starts = [(int(t.frame[0]), t.xy[0]) for t in tracks]
    breaks = vanished = 0
    for track in tracks:
        end = int(track.frame[-1])
        if end in ends:
            continue
        near = any(0 < f - end <= _BREAK_FRAMES and np.hypot(*(xy - track.xy[-1])) <= _BREAK_M for f, xy in starts)
        breaks += near
        is_long = len(track.frame) >= _LEAST_FRAMES
        vanished += is_long and not near and bool(track.range_m[-1] < _VANISH_M)
    counts = {"flicker": float(flicker), "identity_breaks": float(breaks), "vanished": float(vanished)}
    return {"deviation_m": _rms(away), "jerk_mps3": _rms(jerks), **counts}


def _tracks(run: Run) -> Iterator[_Track]:
    boxes, frames = run.tracks.boxes, run.tracks.frames
    good = finite(boxes)[0]
    if not isinstance(boxes, Boxes3D) or boxes.track_id is None or not good.any():
        return
    boxes, frames = boxes[good], frames[good]
    xy = ground_points(run, frames, boxes.center_m) if has_poses(run) else boxes.center_m[:, :2]
    info = {f.index: (f.segment, f.stamp_ns) for f in run.frames}
    segment, stamp_ns = np.array([info[i] for i in frames.tolist()], np.int64).T
    track_id = np.zeros(len(boxes), np.int64) if boxes.track_id is None else boxes.track_id
    order = np.lexsort([frames, track_id, segment])
    key = np.column_stack([segment, track_id])[order]
    borders = [0, *(np.flatnonzero((np.diff(key, axis=0) != 0).any(axis=1)) + 1).tolist(), len(order)]
    far = np.hypot(boxes.center_m[:, 0], boxes.center_m[:, 1])
    for start, stop in pairwise(borders):
        rows = order[start:stop]
        yield _Track(frames[rows], (stamp_ns[rows] - stamp_ns[rows[0]]) * 1e-9, xy[rows], far[rows])


def _smooth(xy: Float64) -> Float64:
    """Places (N - 4, 2) by a parabola through five places each (Savitzky and Golay 1964)."""
    weights = np.array([-3.0, 12.0, 17.0, 12.0, -3.0]) / 35.0
    windows = np.lib.stride_tricks.sliding_window_view(xy, _SMOOTH, axis=0)
    return np.asarray((windows * weights).sum(axis=-1))


def _rms(parts: Sequence[Float64]) -> float | None:
    if not parts or not sum(len(part) for part in parts):
        return None
    values = np.concatenate(parts)
    return float(np.sqrt((values * values).sum(axis=1).mean()))
