"""Criticality of a run's errors: scores, and the list of critical errors with their times."""

from collections.abc import Iterator, Mapping
from collections.abc import Sequence as AbstractSequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fbench.metrics.core.slices import VEHICLE, Group, ScoreCounts, ScoreKey, find_labels, ground_range, label_group
from fbench.metrics.criticality.conflict import Conflicts, find_conflicts
from fbench.metrics.criticality.motion import find_ego_motion, move_ego, move_objects
from fbench.metrics.criticality.scores import (
    OF_DETECTIONS,
    OF_TRACKS,
    RULES,
    CriticalityCounts,
    Errors,
    Rule,
    count_errors,
    count_steps,
    measure_hits,
    number_objects,
    rows_of,
)
from fbench.metrics.detection.outcomes import compare_class, judge_detections
from fbench.metrics.runs.columns import View
from fbench.metrics.runs.places import once
from fbench.metrics.runs.spaces import ground_view, image_view, measure_classes
from fbench.metrics.runs.tracking import NO_TRACKS
from fbench.metrics.tracking.clear_events import SWITCH
from fbench.metrics.tracking.scores import follow_tracks
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import LABELS, VEHICLES, Boxes3D
from fbench.replay.data.criticality import CriticalError, Side
from fbench.replay.data.metadata import outline_of
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.data.sequences import Objects, Sequence
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import BoxTable

IN_IMAGES = "results are in images; what is critical needs 3D boxes"
_SIDES: Mapping[Side, Mapping[str, Rule]] = {"detections": OF_DETECTIONS, "tracks": OF_TRACKS}


class Criticality:
    """Errors weighted by what they cost the vehicle.

    The ego and each road user are predicted with constant turn rate and acceleration for 5 s. The motion of the ego is
    from the run's poses, that of truth and of results from their velocities, else from the places that boxes of one id
    have. The time to collision is that of the first touch of the footprints; the required deceleration is the constant
    one along the ego's path that avoids it. A conflict is critical up to 3 s or from 3 m/s^2 on; its weight is the
    larger of 1 - TTC / 5 s and of the deceleration over 8 m/s^2, at most 1. What meets the ego nowhere has no weight.

    FSR, MDR and LEA are fbench's own closed forms of the efforts that Kaul et al. (arXiv 2603.28029) name.
    """

    def scores(self, run: Run, options: ScoreOptions) -> AbstractSequence[Score]:
        """Return rows of all vehicles, then of labels, in 3D; null with the reason where motion isn't known."""
        return [
            row
            for side, rules in _SIDES.items()
            for entry in _measure(run, options, side)
            for row in rows_of(entry.counts, entry.key, rules)
        ]

    def value_of(self, metric: str, counts: Mapping[str, int | float]) -> float | None:
        """Return the value of a row from its counts, added over runs; `None` where it is undefined."""
        return RULES[metric].evaluate(counts)[0]


def find_critical_errors(run: Run, options: ScoreOptions) -> list[CriticalError]:
    """Return the critical errors of a run's detections and tracks in the order of time, of all vehicles and of each
    label that is no vehicle; none where nothing is known, see the rows of `Criticality`.
    """
    found: list[CriticalError] = []
    for side in _SIDES:
        table = _table(run, side)
        if not isinstance(table.boxes, Boxes3D) or (side == "tracks" and not run.manifest.has_tracks):
            continue
        view = ground_view(run, table, options)
        if view.key.reason:
            continue
        met = find_labels(view.sequence.truth, view.sequence.estimates) if table.boxes.label is not None else set()
        for group in (VEHICLE, *(label_group(label) for label in LABELS if label in met and label not in VEHICLES)):
            found += _list_errors(run, options, side, view, group)
    return sorted(found, key=lambda e: (e.stamp_ns, list(_SIDES).index(e.side), e.kind != "miss", e.ttc_s, e.range_m))


def _list_errors(run: Run, options: ScoreOptions, side: Side, view: View, group: Group) -> Iterator[CriticalError]:
    sequence, predicted = view.sequence, _predict(run, options, side, view.sequence)
    errors = judge_side(run, options, side, view, group)
    kinds: tuple[tuple[Literal["miss", "false alarm"], Objects, Int64, Conflicts], ...] = (
        ("miss", sequence.truth, errors.truth_row[~errors.hit], predicted.conflicts[0]),
        ("false alarm", sequence.estimates, errors.alarm_row, predicted.conflicts[1]),
    )
    steps = sequence.steps
    for kind, objects, of, conflicts in kinds:
        rows = of[conflicts.critical[of]]
        number, place = number_objects(objects, rows, steps), steps.places[objects.step[rows]]
        order = np.lexsort([place, number])
        ends = (np.diff(number[order]) != 0) | (np.diff(place[order]) > 1)
        for part in np.split(rows[order], np.flatnonzero(ends) + 1) if len(rows) else []:
            first, last = int(objects.step[part[0]]), int(objects.step[part[-1]])
            own, far, track_id = conflicts[part], ground_range(objects[part]), int(objects.track_id[part[0]])
            from_s, to_s = ((steps.stamp_ns[[first, last]] - steps.stamp_ns[0]) * 1e-9).tolist()
            yield CriticalError(
                kind, side, str(objects.label[part[0]]), track_id if track_id >= 0 else None,
                int(steps.stamp_ns[first]), from_s, to_s, int(steps.frame[first]), int(steps.frame[last]),
                len(part), float(np.min(far)) if far is not None else 0.0, float(own.ttc_s.min()),
                float(own.deceleration_mps2.max()), float(own.lateral_mps2.max()),
            )  # fmt: skip


def _measure(run: Run, options: ScoreOptions, side: Side) -> AbstractSequence[ScoreCounts[CriticalityCounts]]:
    """Count all vehicles, then labels, in 3D."""
    table = _table(run, side)
    is_solid, nothing = isinstance(table.boxes, Boxes3D), CriticalityCounts()
    view = ground_view(run, table, options) if is_solid else image_view(run, table, options)
    if not is_solid:
        return [ScoreCounts(replace(view.key, reason=view.key.reason or IN_IMAGES), nothing)]
    if side == "tracks" and not run.manifest.has_tracks:
        return [ScoreCounts(replace(view.key, reason=view.key.reason or NO_TRACKS), nothing)]

    def measure(sequence: Sequence, group: Group, match: Match) -> CriticalityCounts:
        predicted = _predict(run, options, side, sequence)
        errors = judge_side(run, options, side, view, group)
        return predicted.count(errors, sequence) + measure_hits(sequence.truth, sequence.estimates, errors.pairs)

    return measure_classes([view], table, measure, nothing)


def count_by_frame(run: Run, options: ScoreOptions, side: Side) -> Iterator[tuple[ScoreKey, Int64, Int64]]:
    """Yield `STEP_COUNTS` (F, 6) of all vehicles and of each label, as in the rows of `Criticality`, with the indices
    (F,) of the frames that are labeled in 3D. Nothing of results in images, nor without truth.
    """
    table = _table(run, side)
    if not isinstance(table.boxes, Boxes3D) or (side == "tracks" and not run.manifest.has_tracks):
        return
    view = ground_view(run, table, options)
    if view.key.reason:
        return
    sequence, predicted = view.sequence, _predict(run, options, side, view.sequence)
    met = find_labels(sequence.truth, sequence.estimates) if table.boxes.label is not None else set()
    steps = sequence.truth.step, sequence.estimates.step
    for group in (VEHICLE, *(label_group(label) for label in LABELS if label in met)):
        errors = judge_side(run, options, side, view, group)
        counts = count_steps(errors, steps, len(sequence.steps), predicted.conflicts)
        yield replace(view.key, class_=group.name), counts, sequence.steps.frame


def _table(run: Run, side: Side) -> BoxTable:
    return run.detections if side == "detections" else run.tracks


@dataclass(frozen=True, eq=False)
class _Predicted:
    """Conflicts of all boxes of a sequence."""

    ego_speed_mps: Float64  # (S,) NaN where it isn't known
    conflicts: tuple[Conflicts, Conflicts]  # Of truth, and of estimates

    def count(self, errors: Errors, sequence: Sequence) -> CriticalityCounts:
        sides = sequence.truth, sequence.estimates
        return count_errors(errors, *sides, sequence.steps, self.conflicts, self.ego_speed_mps)


def _predict(run: Run, options: ScoreOptions, side: Side, sequence: Sequence) -> _Predicted:
    def find() -> _Predicted:
        outline, steps = outline_of(run.manifest.log.metadata), sequence.steps
        frames = once(run, "ego motion", lambda: find_ego_motion(run))
        ego = move_ego(frames, steps)

        def predict(objects: Objects, is_truth: bool) -> Conflicts:
            size = np.zeros((len(objects), 2)) if objects.size_lwh_m is None else objects.size_lwh_m[:, :2]
            # Beyond the region nothing counts.
            size = size if objects.inside is None else np.where(objects.inside[:, None], size, np.nan)
            bodies = move_objects(objects, steps, frames, else_standing=not is_truth)
            return find_conflicts(ego[objects.step], outline, bodies, size)

        truth = once(run, ("conflicts of truth", options), lambda: predict(sequence.truth, True))
        return _Predicted(np.where(ego.known, ego.speed_mps, np.nan), (truth, predict(sequence.estimates, False)))

    return once(run, ("conflicts", side, options), find)


def judge_side(run: Run, options: ScoreOptions, side: Side, view: View, group: Group) -> Errors:
    """Return the errors of one class in a view of detections or tracks."""
    key = ("critical errors", side, options, group.name)
    return once(run, key, lambda: _match(side, view.sequence, group, view.match))


def _match(side: Side, sequence: Sequence, group: Group, match: Match) -> Errors:
    if side == "detections":
        return Errors.of(judge_detections(compare_class(sequence, group, match)))
    judgement, problem, pairs = follow_tracks(sequence, group, match)
    return Errors.of(judgement, problem.truth_row[(pairs.event & SWITCH) != 0])
