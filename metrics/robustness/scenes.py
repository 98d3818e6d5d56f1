"""Robustness: how F1 changes, relative to clear weather, under other conditions on the same scene.

Runs of several scenes are put together by adding raw counts, never by averaging ratios. Intervals are those of
resampled scenes: what differs within a scene, such as its frames, depends on each other.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fbench.metrics.core.bootstrap import LEAST_UNITS, Bootstrap
from fbench.metrics.core.slices import VEHICLE
from fbench.metrics.detection.outcomes import compare_class, judge_detections
from fbench.metrics.detection.scores import DetectionCounts, detection_rows
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import views
from fbench.metrics.runs.tracking import NO_TRACKS
from fbench.metrics.tracking.scores import tracking_counts, tracking_rows
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.scores import Figure, Score, ScoreOptions
from fbench.replay.runs.folder import Run

Space = str  # `image` or `3D`
SPACES: Mapping[Space, str] = {"image": "iou ", "3D": "bev "}  # How the matching of each begins
CLEAR = "clear"
_CLASS = "vehicle"
_LEAST_F1 = 0.1  # In clear weather, for a relative change: one more object found would be tens of percent
_COUNTS = ("tp", "fp", "fn", "gt", "idsw")
HOW = Bootstrap()
"""How scenes are resampled."""


@dataclass(frozen=True)
class ScoredRun:
    """The scores of one run of an experiment."""

    configuration: str
    condition: str
    scene: str  # What conditions are compared on: the same for each condition of one world and seed
    scores: Sequence[Score]


_NOTHING = {"f1": "no boxes, in truth nor detected", "precision": "nothing detected"}
"""Why there is no value where there is nothing to divide by; of the others: no truth boxes."""


def score_vehicles(run: Run, options: ScoreOptions, *, tracks: bool) -> list[Score]:
    """Return the rows of all vehicles in each space, as `scores.json` has them, by other options: F1, precision and
    recall of detections, and where asked for MOTA of `tracks`. Raises ConfigError where the log lacks their regions.
    """
    shared, rows = SharedRun(run.folder), list[Score]()
    for view in views(shared, shared.detections, options):
        judged = None if view.key.reason else judge_detections(compare_class(view.sequence, VEHICLE, view.match))
        rows += detection_rows(DetectionCounts() if judged is None else DetectionCounts(judged.counts), view.key)
    for view in views(shared, shared.tracks, options) if tracks else ():
        reason = view.key.reason or (None if run.manifest.has_tracks else NO_TRACKS)
        counts = tracking_counts(view.sequence, VEHICLE, view.match)
        found = tracking_rows(counts, replace(view.key, reason=reason), "m")
        rows += [row for row in found if row.metric in ("mota", "mota_no_fp")]
    return rows


def _fraction(metric: str, n: Mapping[str, Array | int]) -> tuple[Array | float, Array | float]:
    """Top and bottom of a metric: F1 = TP / (TP + FP/2 + FN/2); MOTA as in `metrics.runs.tracking`."""
    match metric:
        case "f1":
            return n["tp"], n["tp"] + n["fp"] / 2 + n["fn"] / 2
        case "precision" | "recall":
            return n["tp"], n["tp"] + n["fp" if metric == "precision" else "fn"]
        case _:
            return n["gt"] - n["fn"] - (n["fp"] if metric == "mota" else 0) - n["idsw"], n["gt"]


def spaces_of(runs: Iterable[ScoredRun]) -> list[Space]:
    """Return the spaces in which any of the runs was scored."""
    found = [score.matching for run in runs for score in run.scores if score.metric == "f1"]
    return [space for space, start in SPACES.items() if any(matching.startswith(start) for matching in found)]


def _rows(run: ScoredRun, metric: str, space: Space) -> list[Score]:
    """The row of a metric of all vehicles, or none."""
    of = (metric, _CLASS, "all")
    return [row for row in run.scores if row.key[:3] == of and row.matching.startswith(SPACES[space])][:1]


def pool(runs: Iterable[ScoredRun], metric: str, space: Space, how: Bootstrap | None = None) -> Figure:
    """Return a metric of all vehicles over several runs of one configuration: f1, precision, recall, mota or
    mota_no_fp, in the space `image` or `3D`; with resamples of their scenes, `how`, it has an interval.
    """
    runs = list(runs)
    rows = [row for run in runs for row in _rows(run, metric, space)]
    if not rows:
        return Figure(None, "no run")
    counts: Counter[str] = Counter()
    for row in rows:
        counts.update({name: int(row.counts[name]) for name in _COUNTS if name in row.counts})
    reasons = [row.reason for row in rows if row.reason is not None]
    for row in rows:
        if row.reason is not None and _fraction(metric, Counter(_ints(row)))[1]:
            return Figure(None, row.reason, counts)  # for another reason than that there is nothing to divide by
    top, bottom = _fraction(metric, counts)
    if not bottom:
        return Figure(None, (*reasons, _NOTHING.get(metric, "no truth boxes"))[0], counts)
    value = float(top / bottom)
    low, high = (None, None) if how is None else how.interval(resample(runs, metric, space, how))
    return Figure(value, None, counts, None, low, high)


def _ints(row: Score) -> dict[str, int]:
    return {name: int(num) for name, num in row.counts.items() if name in _COUNTS}


def resample(
    runs: Iterable[ScoredRun], metric: str, space: Space, how: Bootstrap, scenes: Sequence[str] | None = None
) -> Float64 | None:
    """Return a metric in each resample (num,) of the scenes, NaN where it is undefined: for one seed and number of
    scenes the same scenes are drawn, so that runs of the same scenes can be subtracted. `None` below five scenes.

    `scenes` are those that are drawn, of which there may be no run; else those of the runs.
    """
    runs = list(runs)
    scenes = sorted({run.scene for run in runs}) if scenes is None else scenes
    if len(scenes) < LEAST_UNITS:
        return None
    counts = np.zeros((len(scenes), len(_COUNTS)), np.int64)
    for run in runs:
        for row in _rows(run, metric, space):
            own = _ints(row)
            counts[scenes.index(run.scene)] += [own.get(name, 0) for name in _COUNTS]
    totals = (how.times(len(scenes))[:, :, None] * counts).sum(axis=1)
    top, bottom = _fraction(metric, dict(zip(_COUNTS, totals.T, strict=True)))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(np.asarray(bottom) != 0, np.asarray(top) / bottom, np.nan), np.float64)


def change(runs: Sequence[ScoredRun], condition: str, space: Space, how: Bootstrap | None = None) -> Figure:
    """Return the relative change of F1 against clear weather, (F1 - F1 clear) / F1 clear, on the scenes of which there
    are runs in both; with resamples of these scenes, `how`, it has an interval.

    `runs` are of one configuration, the condition is such as `fog`, the space `image` or `3D`.
    """
    scenes = {run.scene for run in runs if run.condition == CLEAR} & {r.scene for r in runs if r.condition == condition}
    if not scenes:
        return Figure(None, f"no scene was run both in {CLEAR} and in {condition}")
    both = [[run for run in runs if run.condition == name and run.scene in scenes] for name in (CLEAR, condition)]
    base, found = (pool(own, "f1", space) for own in both)
    counts = {f"{name}_{key}": num for name, f in ((CLEAR, base), ("then", found)) for key, num in f.counts.items()}
    if base.value is None:
        return Figure(None, f"no F1 in {CLEAR}: {base.reason}", counts)
    if found.value is None:
        return Figure(None, f"no F1 in {condition}: {found.reason}", counts)
    if base.value < _LEAST_F1:
        return Figure(None, f"F1 is {base.value:.3g} in {CLEAR}, too little for a relative change", counts)
    low: float | None = None
    high: float | None = None
    if how is not None and len(scenes) >= LEAST_UNITS:
        clear, then = (resample(own, "f1", space, how) for own in both)
        if clear is not None and then is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                low, high = how.interval((then - clear) / clear)
    return Figure((found.value - base.value) / base.value, None, counts, None, low, high)


def difference(
    one: Sequence[ScoredRun], other: Sequence[ScoredRun], space: Space, how: Bootstrap, metric: str = "f1"
) -> Figure:
    """Return a metric of a configuration minus that of another, on the scenes of which both have runs, with its
    interval; see `pool`.
    """
    scenes = sorted({run.scene for run in one} & {run.scene for run in other})
    both = [[run for run in own if run.scene in scenes] for own in (one, other)]
    head, base = (pool(own, metric, space) for own in both)
    if head.value is None or base.value is None:
        return Figure(None, head.reason or base.reason)
    ours, theirs = (resample(own, metric, space, how, scenes) for own in both)
    ends = (None, None) if ours is None or theirs is None else how.interval(ours - theirs)
    return Figure(head.value - base.value, None, {}, None, *ends)
