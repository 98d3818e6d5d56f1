"""Sufficient statistics of tracking: what CLEAR needs to count at any score."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fbench.metrics.core.ordering import content_ranks, life_ranks, number_tracks
from fbench.metrics.profiles.nuscenes.boxes import LeftOut, NearBoxes, Side, centers_xy
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.sequences import Sequence


@dataclass(frozen=True, eq=False)
class TrackPoints:
    """N points of K tracks."""

    step: Int64  # (N,)
    track: Int64
    """(N,) 0 to K - 1, numbered by first sample, place there and what follows; an id in two streams is two tracks."""
    kind: Int64  # (N,) index of the class, which may change along a track
    xy: Float64  # (N, 2) [m]
    score: Float64  # (N,)
    invalid: Bool  # (N,) results that match nothing; each is a track of its own

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
    `create_tracks`), in results too. That uses the future; nothing but this profile does it. Raises MetricError where
    samples of a stream don't follow each other in time.
    """
    steps, step, xy = sequence.steps, side.boxes.step, centers_xy(side)
    time = steps.stamp_ns if steps.stamp_ns.any() else steps.frame  # frames where the source has no stamps
    late = (np.diff(steps.stream) == 0) & (np.diff(time) <= 0)
    if late.any():
        raise MetricError(f"{sequence.name}, sample {steps.frame[1:][late][0]}: not later than the sample before it")
    number = np.where(side.invalid, -1 - np.arange(len(side.kind)), side.boxes.track_id)
    score = np.where(np.isfinite(side.boxes.score), side.boxes.score, np.inf)
    box = content_ranks((step, *xy.T, side.kind, score, side.invalid))
    track = life_ranks(box, number_tracks(number, steps.stream[step]))
    points = TrackPoints(step, track, side.kind, xy, score, side.invalid)
    points = points[np.lexsort((points.step, points.track))]
    bounds = np.flatnonzero(np.diff(points.track, prepend=-1, append=-1))
    means = [np.mean(points.score[start:end]) for start, end in pairwise(bounds)]
    points = replace(points, score=np.repeat(means, np.diff(bounds)))

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
    points = TrackPoints(*map(np.concatenate, zip(points.columns, added.columns, strict=True)))
    return points[np.lexsort((points.track, points.xy[:, 1], points.xy[:, 0], points.step))]


@dataclass(frozen=True, eq=False)
class Clip:
    """One class of one sequence; tracks of different streams are different tracks."""

    sequence: str
    kind: int  # Index of the class
    num_truth_tracks: int
    near: NearBoxes
    matched_score: Float64
    """(K,) of the results that match, without a switch, when all are taken."""


@dataclass(frozen=True, eq=False)
class TrackingStatistics:
    """Clips of any number of sequences; their order doesn't matter."""

    clips: tuple[Clip, ...]
    left_out: LeftOut

    def __add__(self, other: "TrackingStatistics") -> "TrackingStatistics":
        return TrackingStatistics(self.clips + other.clips, self.left_out + other.left_out)


def clips_of(
    sequence: str, truth: TrackPoints, estimates: TrackPoints, num_steps: int, num_classes: int, limit_m: float
) -> tuple[Clip, ...]:
    """Return a clip for each class of which there is any box."""
    from fbench.metrics.profiles.nuscenes.kernels import near_pairs, sweep  # numba takes a while to import

    clips, steps = [], np.arange(num_steps + 1)
    for kind in range(num_classes):
        true, said = truth[truth.kind == kind], estimates[estimates.kind == kind]
        if not len(true.step) and not len(said.step):
            continue
        truth_start, start = (np.searchsorted(side.step, steps).astype(np.int32) for side in (true, said))
        pairs = near_pairs(true.xy, truth_start, said.xy, start, said.invalid, limit_m)
        tracks, truth_track = np.unique(true.track, return_inverse=True)
        own, others = truth_track.astype(np.int32), said.track.astype(np.int32)
        near = NearBoxes(truth_start, own, start, others, said.score, *pairs)
        _, _, continued = sweep(np.array([-np.inf]), near, len(tracks))
        clips.append(Clip(sequence, kind, len(tracks), near, said.score[continued]))
    return tuple(clips)
