"""Counts of each frame of a run, whose sums are those of its scores."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fbench.metrics.core.slices import VEHICLE, VISIBILITY_SLICES, Group, Part, by_seen, find_labels, label_group
from fbench.metrics.criticality.metric import count_by_frame
from fbench.metrics.detection.outcomes import Candidates, Judgement, Outcome, compare_class, judge_detections
from fbench.metrics.runs.columns import View
from fbench.metrics.runs.detection import parts_of
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import views
from fbench.metrics.runs.streaming import stream_runs
from fbench.metrics.tracking.clear_events import SWITCH
from fbench.metrics.tracking.identity import find_identified
from fbench.metrics.tracking.scores import follow_tracks, require_unique_ids
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import LABELS
from fbench.replay.data.criticality import Side
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.runs.folder import Run

DETECTION = ("tp", "fp", "fn")
TRACKING = ("tp", "fp", "fn", "idsw", "idtp")
CRITICAL: Mapping[str, Side] = {"critical detection": "detections", "critical tracking": "tracks"}
Place = tuple[str, str, str, str]  # A key of `RATIOS`, class, slice, matching


def _ratio(top: Float64, bottom: Float64) -> Float64:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(bottom > 0, top / bottom, np.nan), np.float64)


def _f1(n: Float64) -> Float64:
    return _ratio(2 * n[..., 0], 2 * n[..., 0] + n[..., 1] + n[..., 2])


def _precision(n: Float64) -> Float64:
    return _ratio(n[..., 0], n[..., 0] + n[..., 1])


def _recall(n: Float64) -> Float64:
    return _ratio(n[..., 0], n[..., 0] + n[..., 2])


def _mota(n: Float64) -> Float64:
    return _ratio(n[..., 0] - n[..., 1] - n[..., 3], n[..., 0] + n[..., 2])


def _mota_no_fp(n: Float64) -> Float64:
    return _ratio(n[..., 0] - n[..., 3], n[..., 0] + n[..., 2])


def _idf1(n: Float64) -> Float64:
    return _ratio(2 * n[..., 4], 2 * n[..., 0] + n[..., 1] + n[..., 2])


def _count(column: int) -> Callable[[Float64], Float64]:
    return lambda n: np.asarray(n[..., column], np.float64)


def _rate_recall_by_weight(n: Float64) -> Float64:
    return _ratio(n[..., 2], n[..., 3])


def _rate_f1_by_weight(n: Float64) -> Float64:
    return _ratio(2 * n[..., 2], n[..., 2] + n[..., 3] + n[..., 4])


def _rate_mota_by_weight(n: Float64) -> Float64:
    return _ratio(n[..., 2] - n[..., 4] - n[..., 5], n[..., 3])


RATIOS: Mapping[str, Mapping[str, Callable[[Float64], Float64]]] = {
    "detection": {"f1": _f1, "precision": _precision, "recall": _recall},
    "tracking": {"mota": _mota, "mota_no_fp": _mota_no_fp, "idf1": _idf1, "idsw": _count(3)},
    "critical detection": {
        "critical_misses": _count(0), "critical_false_alarms": _count(1), "weighted_recall": _rate_recall_by_weight,
        "weighted_f1": _rate_f1_by_weight,
    },
    "critical tracking": {
        "critical_untracked": _count(0), "critical_false_tracks": _count(1), "weighted_mota": _rate_mota_by_weight,
    },
}  # fmt: skip
"""Metrics that are functions of counts (..., K), by what is counted. The identity of IDF1 is that of the whole log."""


@dataclass(frozen=True, eq=False)
class FrameCounts:
    """Counts of the F frames of a run that have truth."""

    stamp_ns: Int64  # (F,)
    segment: Int64  # (F,)
    counts: Mapping[Place, Int64]  # (F, 3) `DETECTION`, (F, 5) `TRACKING` or (F, 6) `STEP_COUNTS`

    @cached_property
    def totals(self) -> dict[tuple[str, str, str, str], float | None]:
        """Values of the whole run by the key of their score."""
        found: dict[tuple[str, str, str, str], float | None] = {}
        for place, counts in self.counts.items():
            for metric, ratio in metrics_of(place).items():
                value = float(ratio(counts.sum(axis=0, dtype=np.float64)))
                found[metric, *place[1:]] = value if np.isfinite(value) else None
        return found


def metrics_of(place: Place) -> Mapping[str, Callable[[Float64], Float64]]:
    """Return the metrics that mean something for a place: a false alarm has no visibility, so only recall there."""
    own = RATIOS[place[0]]
    return {"recall": own["recall"]} if place[2] in VISIBILITY_SLICES else own


def count_frames(run: Run, options: ScoreOptions, streamed: SharedRun | None = None) -> FrameCounts:
    """Count each frame of a run, or of what counts in it in streaming, as its scores do. Raises MetricError where an id
    occurs twice in one frame.
    """
    shared = streamed or SharedRun(run.folder)
    labeled = [frame for frame in shared.frames if frame.truth_spaces]
    frames = np.array([frame.index for frame in labeled], np.int64)
    found: dict[Place, Int64] = {}
    for name, one in stream_runs(run).items() if streamed is None else ():
        places = count_frames(run, options, one).counts.items()
        found |= {(k, c, name, m): counts for (k, c, part, m), counts in places if (c, part) == (VEHICLE.name, "all")}
    for view, group, part in _detections(shared, options):
        candidates = compare_class(view.sequence, group, view.match)
        judged = judge_detections(candidates if part is None else candidates.select(part))
        place = ("detection", group.name, "all" if part is None else part.name, view.key.matching)
        found[place] = count_outcomes(judged, frames)
    for view, group, part in _tracks(shared, options):
        place = ("tracking", group.name, "all" if part is None else part.name, view.key.matching)
        found[place] = _count_tracks(view, group, part, frames)
    for what, side in CRITICAL.items():
        for key, counts, own in count_by_frame(shared, options, side):
            place = (what, key.class_, key.slice, key.matching)
            found[place] = np.zeros((len(frames), counts.shape[1]), np.int64)
            np.add.at(found[place], np.searchsorted(frames, own), counts)
    stamps, segments = (np.array([getattr(f, name) for f in labeled], np.int64) for name in ("stamp_ns", "segment"))
    return FrameCounts(stamps, segments, found)


def _detections(run: SharedRun, options: ScoreOptions) -> Iterator[tuple[View, Group, Part | None]]:
    spaces = [view for view in views(run, run.detections, options) if view.key.reason is None]
    yield from ((view, group, None) for view, group in _classes(spaces, run.detections.boxes.label is not None))
    if spaces and spaces[0].key == views(run, run.detections, options)[0].key:
        yield from ((spaces[0], VEHICLE, part) for part in parts_of(run, spaces[0].sequence, options))


def _tracks(run: SharedRun, options: ScoreOptions) -> Iterator[tuple[View, Group, Part | None]]:
    if not run.manifest.has_tracks:
        return
    spaces = [view for view in views(run, run.tracks, options) if view.key.reason is None]
    for view in spaces:
        require_unique_ids(view.sequence, f"'{run.manifest.pipeline}' on log '{run.manifest.log.name}'")
    yield from ((view, group, None) for view, group in _classes(spaces, run.tracks.boxes.label is not None))
    if spaces and not options.seen:
        yield from ((spaces[0], VEHICLE, part) for part in by_seen(spaces[0].sequence))


def _classes(spaces: Sequence[View], has_labels: bool) -> Iterator[tuple[View, Group]]:
    yield from ((view, VEHICLE) for view in spaces)
    if spaces and has_labels:
        met = find_labels(spaces[0].sequence.truth, spaces[0].sequence.estimates)
        yield from ((spaces[0], label_group(label)) for label in LABELS if label in met)


def count_outcomes(judged: Judgement, frames: Int64) -> Int64:
    """Count hits, false alarms and misses (F, 3) of each of the frames, whose indices (F,) ascend."""
    c = judged.candidates
    truth, estimates = _frames_of(c, frames)
    tp = np.bincount(estimates[judged.outcome == Outcome.HIT], minlength=len(frames))
    false = np.isin(judged.outcome, (Outcome.FALSE_ALARM, Outcome.INVALID))
    fp = np.bincount(estimates[false], minlength=len(frames))
    return np.column_stack([tp, fp, np.bincount(truth, minlength=len(frames)) - tp]).astype(np.int64)


def _frames_of(c: Candidates, frames: Int64) -> tuple[Int64, Int64]:
    """Row of the frame of each truth box to be found, and of each estimate."""
    row = np.searchsorted(frames, c.sequence.steps.frame)
    return row[c.truth.step].astype(np.int64), row[c.estimates.step].astype(np.int64)


def _count_tracks(view: View, group: Group, part: Part | None, frames: Int64) -> Int64:
    """Hits, false alarms, misses, switches, and boxes under the right identity (F, 5) of each frame."""
    judged, problem, pairs = follow_tracks(view.sequence, group, view.match, part)
    truth, _ = _frames_of(judged.candidates, frames)
    has_id = np.append(judged.candidates.estimates.track_id[judged.is_used] >= 0, False)[pairs.estimate_of]
    rows = np.flatnonzero((pairs.event & SWITCH) != 0)
    if not has_id[pairs.estimate_of >= 0].all():  # matches without an id don't count
        rows = _find_switches(problem.truth_id, pairs.estimate_of, judged, has_id)
    switches, right = (
        np.bincount(truth[r], minlength=len(frames)) for r in (rows, find_identified(problem, view.match.floor))
    )
    return np.column_stack([count_outcomes(judged, frames), switches, right]).astype(np.int64)


def _find_switches(truth_id: Int64, estimate_of: Int64, judged: Judgement, has_id: Bool) -> Int64:
    """Rows of truth that are on another track than at the last match with an id."""
    track_id = judged.candidates.estimates.track_id[judged.is_used]
    rows = np.flatnonzero(has_id)
    rows = rows[np.argsort(truth_id[rows], kind="stable")]
    changed = (np.diff(truth_id[rows]) == 0) & (np.diff(track_id[estimate_of[rows]]) != 0)
    return np.sort(rows[1:][changed])


_SAME = 1e-6  # Weights are rounded
_BEV = re.compile(r"bev (?P<distance>[\d.e+-]+) m(?:,|$)")
_IOU = re.compile(r"iou (?P<iou>[\d.e+-]+)(?:,|$)")
_RANGE = re.compile(r", within (?P<range>[\d.e+-]+|inf) m")
_SEEN = re.compile(r", seen(?: with (\d+) points)?")
_CAMERAS = re.compile(r", in image of ([^,]+)")
_REGION = re.compile(r", in region (.+)$")


def options_of(scores: Sequence[Score]) -> ScoreOptions:
    """Return the options that scores were made with, from what their rows say of matching."""
    texts = list(dict.fromkeys(score.matching for score in scores))
    options, is_viewed = ScoreOptions(), any(", in view" in text for text in texts)
    for text in texts:
        if found := _BEV.match(text):
            options = replace(options, distance_m=float(found["distance"]))
        elif found := _IOU.match(text):
            options = replace(options, iou=float(found["iou"]))
        if found := _RANGE.search(text):
            options = replace(options, range_m=float(found["range"]))
        if found := _SEEN.search(text):
            options = replace(options, seen=int(found[1] or 1))
        if found := _CAMERAS.search(text):
            options = replace(options, cameras=tuple(found[1].split(" or ")))
        if found := _REGION.search(text):
            options = replace(options, regions=tuple(found[1].split(" or ")))
    return replace(options, in_view=is_viewed or not any(_RANGE.search(text) for text in texts))


def require_same_rules(counts: FrameCounts, scores: Sequence[Score], side: str) -> None:
    """Refuse scores that aren't the sums of these counts: another version of fbench made them, or other options. Raises
    MetricError naming the first such number.
    """
    for score in scores:
        known = counts.totals.get(score.key)
        # A score without a value lacks what it is counted of, such as ids.
        if known is not None and score.value is not None and abs(known - score.value) > _SAME:
            raise MetricError(
                f"{side}: {score.metric} of {score.class_} ({score.slice}) is {score.value} in scores.json, but this "
                f"version of fbench measures {known}; other versions of metrics can't be compared: run fbench score"
            )
