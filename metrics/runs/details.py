"""Details of a run's scores: curves over thresholds, objects with their tracks over time, and errors by frame."""

from collections.abc import Iterator

import numpy as np

from fbench.metrics.core.slices import VEHICLE, ground_range
from fbench.metrics.detection.outcomes import Judgement, Outcome, compare_class, judge_detections
from fbench.metrics.detection.scores import Ranking
from fbench.metrics.runs.detection import detection_entries
from fbench.metrics.runs.spaces import views
from fbench.metrics.tracking.clear_events import SWITCH
from fbench.metrics.tracking.scores import follow_tracks
from fbench.replay.data.arrays import Int64
from fbench.replay.data.details import Details, FrameErrors, ObjectTrack, ScoreCurve, Span
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.runs.folder import Run

MOST_POINTS = 200
"""Of a curve: those between are evenly thinned, the best F1 and both ends stay."""
_DIGITS = 6


def find_details(run: Run, options: ScoreOptions) -> Details:
    """Return what the scores of a run are made of, all vehicles as one class; curves of each class. Empty where there
    is nothing to score. Raises MetricError where boxes lack what the match compares.
    """
    spaces = views(run, run.detections, options)
    native = spaces[0]
    if native.key.reason:
        return Details()
    curves = tuple(
        _thin(entry.key.class_, entry.key.matching, entry.counts.ranking)
        for entry in detection_entries(run, options)
        if entry.key.slice == "all" and entry.key.reason is None and entry.counts.ranking.reason is None
    )
    judged = judge_detections(compare_class(native.sequence, VEHICLE, native.match))
    return Details(curves, tuple(_follow_objects(run, options)), _count_frames(judged))


def _thin(class_: str, matching: str, ranking: Ranking) -> ScoreCurve:
    recall, precision = ranking.curve()
    tp, fp = np.cumsum(ranking.tp), np.cumsum(ranking.fp)
    f1 = 2 * tp / (tp + fp + ranking.num_truth)
    kept = np.unique(np.round(np.linspace(0, len(f1) - 1, min(len(f1), MOST_POINTS))).astype(np.int64))
    kept = np.union1d(kept, np.argmax(f1))
    columns = (np.round(values[kept], _DIGITS).tolist() for values in (ranking.scores, precision, recall, f1))
    return ScoreCurve(class_, matching, *map(tuple, columns))


def _follow_objects(run: Run, options: ScoreOptions) -> Iterator[ObjectTrack]:
    """Yield truth objects with an id, those with most misses and switches first."""
    view = views(run, run.tracks, options)[0]
    if view.key.reason or not run.manifest.has_tracks:
        return
    judged, problem, pairs = follow_tracks(view.sequence, VEHICLE, view.match)
    candidates, steps = judged.candidates, view.sequence.steps
    truth, estimates = candidates.truth, candidates.estimates[judged.is_used]
    frame, distance = steps.frame[truth.step], ground_range(truth)
    track = np.append(estimates.track_id, -1)[pairs.estimate_of]
    found = []
    for own in _split(np.where(truth.track_id >= 0, problem.truth_id, -1)):
        rows = own[np.argsort(truth.step[own], kind="stable")]
        hit, first = pairs.estimate_of[rows] >= 0, rows[0]
        near = np.inf if distance is None else float(np.min(distance[rows]))
        num_found = int(np.count_nonzero(np.diff(hit.astype(np.int8)) == 1))  # After a miss
        ids = [one if is_hit else None for one, is_hit in zip(track[rows].tolist(), hit.tolist(), strict=True)]
        found.append(
            ObjectTrack(
                label=str(truth.label[first]), track_id=int(truth.track_id[first]),
                camera=steps.camera[truth.step[first]] if steps.camera else "", num_frames=len(rows),
                num_missed=int(np.count_nonzero(~hit)), num_switches=int(np.count_nonzero(pairs.event[rows] & SWITCH)),
                num_fragments=num_found - int(num_found > 0 and not hit[0]),
                range_m=round(near, 2) if np.isfinite(near) else None, spans=tuple(_spans(frame[rows].tolist(), ids)),
            )
        )  # fmt: skip
    yield from sorted(found, key=lambda o: (-o.num_missed, -o.num_switches, o.camera, o.track_id))


def _split(number: Int64) -> Iterator[Int64]:
    """Yield the rows of each number from 0 on."""
    order = np.argsort(number, kind="stable")
    _, first = np.unique(number[order], return_index=True)
    for rows in np.split(order, first[1:]):
        if len(rows) and number[rows[0]] >= 0:
            yield rows


def _spans(frames: list[int], tracks: list[int | None]) -> Iterator[Span]:
    """Join frames that follow each other among the object's own, and have the same track."""
    start = 0
    for at in range(1, len(frames) + 1):
        if at == len(frames) or tracks[at] != tracks[start]:
            yield Span(frames[start], frames[at - 1], tracks[start])
            start = at


def _count_frames(judged: Judgement) -> FrameErrors:
    candidates, steps = judged.candidates, judged.candidates.sequence.steps
    index, place = np.unique(steps.frame, return_inverse=True)
    hits = judged.outcome == Outcome.HIT
    alarms = np.isin(judged.outcome, (Outcome.FALSE_ALARM, Outcome.INVALID))
    step = candidates.estimates.step
    tp, fp = (np.bincount(place[step[rows]], minlength=len(index)) for rows in (hits, alarms))
    truth = np.bincount(place[candidates.truth.step], minlength=len(index))
    return FrameErrors(*(tuple(values.tolist()) for values in (index, tp, fp, truth - tp)))
