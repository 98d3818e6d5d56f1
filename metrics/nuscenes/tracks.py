"""Boxes as points of tracks, with the samples filled in at which a track has none."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fbench.metrics.matching.lives import content_ranks, life_ranks
from fbench.metrics.nuscenes.counted import Side
from fbench.metrics.nuscenes.grouping import centers_xy
from fbench.metrics.sequence import Sequence
from fbench.replay.arrays import Array, Bool, Float64, Int64
from fbench.replay.errors import MetricError


@dataclass(frozen=True, eq=False)
class TrackPoints:
    """N points of K tracks."""

    step: Int64
    """(N,)"""
    track: Int64
    """(N,) 0 to K - 1, numbered by first sample, place there and what follows; an id in two streams is two tracks."""
    kind: Int64
    """(N,) index of the class, which may change along a track."""
    xy: Float64
    """(N, 2) [m]"""
    score: Float64
    """(N,)"""
    invalid: Bool
    """(N,) results that match nothing; each is a track of its own."""

    @property
    def columns(self) -> tuple[Array, ...]:
        """Its fields, in their order."""
        return self.step, self.track, self.kind, self.xy, self.score, self.invalid

    def __getitem__(self, rows: Int64 | Bool) -> "TrackPoints":
        """Select rows by mask or index array."""
        return TrackPoints(*(column[rows] for column in self.columns))


def track_points(sequence: Sequence, side: Side) -> TrackPoints:
    """Return the points of one side: scores are means over their track, and gaps are filled in.

    Gaps are filled between boxes before and after, as nuscenes-devkit 1.2.0 does (eval/tracking/loaders.py,
    `create_tracks`), in results too. That uses the future; nothing but this profile does it.

    Raises:
        MetricError: where samples of a stream don't follow each other in time.
    """
    points = _points(sequence, side)
    points = points[np.lexsort((points.step, points.track))]
    bounds = np.flatnonzero(np.diff(points.track, prepend=-1, append=-1))
    means = [np.mean(points.score[start:end]) for start, end in pairwise(bounds)]
    points = replace(points, score=np.repeat(means, np.diff(bounds)))
    return _sorted(_filled(points, _time(sequence)))


def _points(sequence: Sequence, side: Side) -> TrackPoints:
    number = np.where(side.invalid, -1 - np.arange(len(side.kind)), side.boxes.track_id)
    step, xy = side.boxes.step, centers_xy(side)
    score = np.where(np.isfinite(side.boxes.score), side.boxes.score, np.inf)
    track = content_ranks((sequence.steps.stream[step], number))
    box = content_ranks((step, *xy.T, side.kind, score, side.invalid))
    return TrackPoints(step, life_ranks(box, track), side.kind, xy, score, side.invalid)


def _filled(points: TrackPoints, time: Int64) -> TrackPoints:
    """Add points, on a straight line in time, at the steps between two points of a track."""
    left = np.flatnonzero((np.diff(points.track) == 0) & (np.diff(points.step) > 1))
    missing = points.step[left + 1] - points.step[left] - 1
    row = np.repeat(left, missing)
    step = points.step[row] + 1 + np.arange(len(row)) - np.repeat(np.cumsum(missing) - missing, missing)
    before, after = points[row], points[row + 1]
    # As the devkit has it: the box after counts by the time still to go to it, so the nearer one counts less.
    weight = (time[after.step] - time[step]) / (time[after.step] - time[before.step])
    xy = (1.0 - weight)[:, None] * before.xy + weight[:, None] * after.xy
    score = (1.0 - weight) * before.score + weight * after.score
    added = TrackPoints(step, after.track, after.kind, xy, score, after.invalid)
    return TrackPoints(*map(np.concatenate, zip(points.columns, added.columns, strict=True)))


def _sorted(points: TrackPoints) -> TrackPoints:
    return points[np.lexsort((points.track, points.xy[:, 1], points.xy[:, 0], points.step))]


def _time(sequence: Sequence) -> Int64:
    """Stamps (S,), or frames where the source has no stamps."""
    steps = sequence.steps
    time = steps.stamp_ns if steps.stamp_ns.any() else steps.frame
    same = np.diff(steps.stream) == 0
    if (np.diff(time)[same] <= 0).any():
        frame = steps.frame[1:][same & (np.diff(time) <= 0)][0]
        raise MetricError(f"{sequence.name}, sample {frame}: not later than the sample before it")
    return time
