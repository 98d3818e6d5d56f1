"""Streaming scores: results compared with truth at the moment they are ready, as sAP does (Li et al. 2020, Towards
Streaming Perception, arXiv 2005.10420).

At the instant of each frame the latest finished output counts: of the frames up to it, in its segment, the last one
whose output was done when the frame was ready for the pipeline; nothing where there is none. So without latency each
frame is paired with its own output, as in lockstep, and how long messages travel is no latency of the pipeline.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fbench.metrics.core.slices import VEHICLE, ScoreCounts
from fbench.metrics.detection.scores import DetectionCounts, detection_counts
from fbench.metrics.runs import detection, tracking
from fbench.metrics.runs.combine import RunTable, measure_run
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import measure_classes, views
from fbench.metrics.tracking.scores import TrackingCounts
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Boxes3D, concatenate
from fbench.replay.data.scores import FORECAST, LOCKSTEP, STREAMING, Score, ScoreOptions
from fbench.replay.engine.service_queue import pair_outputs
from fbench.replay.geometry.iou import distance_bev, iou_2d, move_boxes
from fbench.replay.geometry.transforms import chain, inverse, pose_matrices
from fbench.replay.runs.folder import FrameRecord, Run
from fbench.replay.runs.tables import BoxTable

METRICS = ("f1", "precision", "recall", "ap", "mota", "idf1", "hota")
_NUM_PAST, _LONGEST_PAST_S = 5, 0.5
"""Outputs, the last one included, and time over which the motion of a box in an image is fitted: two of them alone are
too rough, since sides of boxes jitter by pixels."""
_NEAR_M, _NEAR_IOU = 2.0, 0.5  # A detection and a track that are so near are of one object
_SLOWEST_MPS = 1e-3  # Of what is slower nobody knows a direction
_NO_OUTPUT = "no output was ready at any instant"


def score_streaming(run: Run, options: ScoreOptions, lockstep: Sequence[Score]) -> list[Score]:
    """Return the rows of a run with latency: those of all vehicles in lockstep, taken from the scores of the same
    replay without latency, then streaming without and with a forecast, in each space, then how old outputs are.
    Raises MetricError where an id occurs twice in one frame.
    """
    source = pair_outputs(run.frames)
    rows = [replace(row, slice=LOCKSTEP) for row in _select(lockstep)]
    for name in (STREAMING, FORECAST):
        found, tracked = _measure(run, source, options, name == FORECAST)
        own = [row for entry in found for row in detection.rows_of(entry)]
        own += [row for entry in tracked for row in tracking.rows_of(entry)]
        rows += [replace(row, slice=name) for row in _select(own)]
    return [*rows, _staleness(_count_ages(run.frames, source))]


@dataclass(frozen=True)
class StreamingTable:
    """What must be known of a run with latency to score it with others."""

    parts: Mapping[str, RunTable]
    """By slice: `lockstep`, `streaming`, `streaming, forecast`."""
    ages: Mapping[str, int]

    def __add__(self, other: "StreamingTable") -> "StreamingTable":
        ages = {name: num + other.ages[name] for name, num in self.ages.items()}
        return StreamingTable({name: part + other.parts[name] for name, part in self.parts.items()}, ages)

    def rows(self) -> list[Score]:
        """Return the rows that `score_streaming` gives of one run."""
        rows = [replace(row, slice=name) for name, part in self.parts.items() for row in _select(part.rows())]
        return [*rows, _staleness(self.ages)]


def measure_streaming(run: Run, lockstep: Run, options: ScoreOptions) -> StreamingTable:
    """Measure a run with latency, and the same replay without. Raises MetricError where an id occurs twice in one
    frame.
    """
    source, whole = pair_outputs(run.frames), measure_run(lockstep, options).table
    parts = {LOCKSTEP: whole}
    for name in (STREAMING, FORECAST):
        found, tracked = _measure(run, source, options, name == FORECAST)
        parts[name] = replace(whole, detection=found, tracking=tracked)
    return StreamingTable(parts, _count_ages(run.frames, source))


def _measure(
    run: Run, source: Int64, options: ScoreOptions, has_forecast: bool
) -> tuple[tuple[ScoreCounts[DetectionCounts], ...], tuple[ScoreCounts[TrackingCounts], ...]]:
    streamed = StreamedRun(run.folder, run, source, has_forecast)
    detected, tracked = (views(streamed, table, options) for table in (streamed.detections, streamed.tracks))
    found = measure_classes(detected, streamed.detections, detection_counts, DetectionCounts())
    return found, tracking.measure_tracks(streamed, tracked)


def _select(rows: Sequence[Score]) -> list[Score]:
    wanted = (row for row in rows if row.slice == "all" and row.class_ == VEHICLE.name)
    return [replace(row, low=None, high=None, interval=None) for row in wanted if row.metric in METRICS]


def _count_ages(frames: Sequence[FrameRecord], source: Int64) -> dict[str, int]:
    stamps = np.array([frame.stamp_ns for frame in frames], np.int64)
    kept = source >= 0
    age_ns, num = int((stamps[kept] - stamps[source[kept]]).sum()), int(kept.sum())
    return {"age_ns": age_ns, "frames": num, "without_output": len(frames) - num}


def _staleness(ages: Mapping[str, int]) -> Score:
    num = ages["frames"]
    value, reason = (ages["age_ns"] / num / 1e6, None) if num else (None, _NO_OUTPUT)
    return Score("staleness", "all", STREAMING, "", value, reason, "ms", dict(ages))


@dataclass(frozen=True, eq=False)
class StreamedRun(SharedRun):
    """A run whose frames have the outputs that were the latest at their instants.

    As they are, outputs keep their coordinates: those of the body, or of the images, at the instant that they are
    about. A forecast moves them to the frame's instant. Boxes in space go on in a straight line and are seen from where
    the body is then, as far as the log has poses. Their velocity is that of the track, with the speed that the
    detection measured along its own velocity: a filter learns late from places what radar sees at once. Boxes in
    images go on as their track moved in its last outputs. A detection and the nearest track of its output, within 2 m
    or from an IoU of 0.5 on, are of one object; what nobody knows the velocity of stands still.
    """

    base: Run
    source: Int64
    """(F,) as `pair_outputs` returns."""
    has_forecast: bool

    @cached_property
    def frames(self) -> tuple[FrameRecord, ...]:
        """All frames, in order."""
        return self.base.frames

    @cached_property
    def detections(self) -> BoxTable:
        """Detections as they were known at each frame's instant."""
        table, tracks = self.base.detections, self.base.tracks
        lent, own = _take_nearest(self._rates(tracks), table, tracks), self._rates(table)
        if isinstance(table.boxes, Boxes3D):
            return self._place(table, _correct_rates(lent, own))
        return self._place(table, np.where(np.isfinite(own), own, lent))

    @cached_property
    def tracks(self) -> BoxTable:
        """Tracks as they were known at each frame's instant."""
        table, detections = self.base.tracks, self.base.detections
        rates = self._rates(table)
        if isinstance(table.boxes, Boxes3D) and isinstance(detections.boxes, Boxes3D):
            rates = _correct_rates(rates, _take_nearest(self._rates(detections), table, detections))
        return self._place(table, rates)

    def _place(self, table: BoxTable, rates: Float64) -> BoxTable:
        """Give each frame the boxes of the output that counts. `rates` (N, 3 or 4) as `_rates` returns."""
        parts, indices = [table.boxes[:0]], [np.zeros(0, np.int64)]
        for row, source in enumerate(self.source.tolist()):
            start, stop = np.searchsorted(table.frames, self._index[source] + np.arange(2)) if source >= 0 else (0, 0)
            boxes = table.boxes[start:stop]
            if self.has_forecast and source != row and len(boxes):
                boxes = self._move(boxes, np.nan_to_num(rates[start:stop], posinf=0.0, neginf=0.0), source, row)
            parts.append(boxes)
            indices.append(np.full(len(boxes), self._index[row]))
        return BoxTable(np.concatenate(indices), concatenate(parts))  # type: ignore[type-var]

    def _move(self, boxes: Boxes2D | Boxes3D, rates: Float64, source: int, row: int) -> Boxes2D | Boxes3D:
        """Move boxes (N,) of frame `source` to the instant of frame `row`."""
        shift = rates * ((self._stamp_ns[row] - self._stamp_ns[source]) * 1e-9)
        if isinstance(boxes, Boxes2D):
            low, high = np.split(boxes.xyxy_px + shift, 2, axis=1)
            return replace(boxes, xyxy_px=np.hstack([low, np.maximum(low, high)]))  # sides never pass each other
        moved, poses = replace(boxes, center_m=boxes.center_m + shift), self.base.poses[[source, row]]
        if not np.isfinite(poses).all():
            return moved
        world_T_source, world_T_row = pose_matrices(poses[:, :3], poses[:, 3:])
        return move_boxes(moved, chain(inverse(world_T_row), world_T_source))

    @cached_property
    def _index(self) -> Int64:
        return np.array([frame.index for frame in self.frames], np.int64)

    @cached_property
    def _stamp_ns(self) -> Int64:
        return np.array([frame.stamp_ns for frame in self.frames], np.int64)

    def _rates(self, table: BoxTable) -> Float64:
        """Velocity [m/s] (N, 3) in body axes of each box in space, or how fast the sides of a box in an image move
        [px/s] (N, 4), the least squares fit to its track so far (see `_NUM_PAST`); NaN where unknown.
        """
        boxes = table.boxes
        if isinstance(boxes, Boxes3D):
            return np.full((len(boxes), 3), np.nan) if boxes.velocity_mps is None else boxes.velocity_mps
        rates = np.full((len(boxes), 4), np.nan)
        if boxes.track_id is None:
            return rates
        row = np.searchsorted(self._index, table.frames)
        segment = np.array([frame.segment for frame in self.frames], np.int64)[row]
        camera = np.unique(boxes.camera, return_inverse=True)[1]
        order = np.lexsort([row, boxes.track_id, camera, segment])
        age_s = (self._stamp_ns[row[order]] - self._stamp_ns[row[order[:1]]]) * 1e-9
        keys = np.column_stack([segment, camera, boxes.track_id])[order]
        at = np.arange(len(order))[:, None] - np.arange(_NUM_PAST)
        past = np.maximum(at, 0)  # (N, P) places in `order` of the box itself and of those before it
        is_own: Bool = (at >= 0) & (keys[past] == keys[:, None]).all(axis=2) & (keys[:, 2:] >= 0)
        is_own &= np.abs(age_s[past] - age_s[:, None]) <= _LONGEST_PAST_S
        num = np.maximum(is_own.sum(axis=1), 1)[:, None]
        x, y = age_s[past] - age_s[:, None], boxes.xyxy_px[order][past]
        x = np.where(is_own, x - (x * is_own).sum(axis=1, keepdims=True) / num, 0.0)
        spread = (x**2).sum(axis=1)
        known = spread > 0
        rates[order[known]] = (x[:, :, None] * (y - y[:, :1])).sum(axis=1)[known] / spread[known, None]
        return rates


def stream_runs(run: Run) -> dict[str, StreamedRun]:
    """Return a run as it counts in streaming, by slice: without and with a forecast; none where it has no latency."""
    if run.manifest.latency is None:
        return {}
    source = pair_outputs(run.frames)
    return {name: StreamedRun(run.folder, run, source, name == FORECAST) for name in (STREAMING, FORECAST)}


def _take_nearest(rates: Float64, table: BoxTable, others: BoxTable) -> Float64:
    """Return of `rates` (M, 3 or 4) of the other boxes that of the nearest in the same frame, within `_NEAR_M` or from
    an IoU of `_NEAR_IOU` on, for each box (N, 3 or 4); NaN: there is none.
    """
    taken = np.full((len(table.boxes), rates.shape[1]), np.nan)
    for frame in np.unique(table.frames):
        (a, b), (c, d) = (np.searchsorted(side.frames, [frame, frame + 1]) for side in (table, others))
        if c == d:
            continue
        found, known = table.boxes[a:b], others.boxes[c:d]
        if isinstance(found, Boxes2D) and isinstance(known, Boxes2D):
            is_same = found.camera[:, None] == known.camera
            similarity = np.where(is_same, iou_2d(found.xyxy_px, known.xyxy_px), 0) - _NEAR_IOU
        elif isinstance(found, Boxes3D) and isinstance(known, Boxes3D):
            similarity = _NEAR_M - distance_bev(found.center_m, known.center_m)
        else:
            continue
        best = np.nan_to_num(similarity, nan=-1.0).argmax(axis=1)
        near = similarity[np.arange(b - a), best] >= 0
        taken[a:b][near] = rates[c:d][best[near]]
    return taken


def _correct_rates(rates: Float64, measured: Float64) -> Float64:
    """Give velocities (N, 3) the speed that was measured along the direction in which it was measured: radar knows the
    part along the line of sight well, and nothing of the rest. Where only one of the two is known, it counts.
    """
    speed = np.linalg.norm(measured, axis=1, keepdims=True)
    direction = measured / np.maximum(speed, _SLOWEST_MPS)
    corrected = rates + direction * (speed - (direction * rates).sum(axis=1, keepdims=True))
    both = np.isfinite(corrected) & (speed >= _SLOWEST_MPS)
    return np.where(both, corrected, np.where(np.isfinite(rates), rates, measured))
