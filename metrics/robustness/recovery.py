"""Recovery: how long after a sensor is back the tracks are as good again as if it had never been away."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.metrics.core.bootstrap import LEAST_UNITS, Bootstrap
from fbench.metrics.core.slices import VEHICLE
from fbench.metrics.detection.outcomes import Outcome, compare_class, judge_detections
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import views
from fbench.replay.data.arrays import Int64
from fbench.replay.data.scores import Figure, ScoreOptions
from fbench.replay.runs.folder import Run

AS_GOOD = 0.95  # Of the F1 of the same frames without the outage
STEADY = 3  # So many frames in a row


@dataclass(frozen=True)
class Outage:
    """A sensor that was away, and what it cost."""

    sensor: str
    first_frame: int
    last_frame: int
    silent_s: float  # From the first to the last frame without it
    recovery_s: float | None
    """From the last frame without it until tracks are as good again; 0 where they always were, `None`: never."""


def find_outages(clear: Run, disturbed: Run, options: ScoreOptions) -> list[Outage]:
    """Return the outages of sensors that a condition made: frames that lack a sensor which the clear run has there. The
    tracks are as good again from the first of three frames on, each with 95 % of the clear run's F1 of tracks. Both
    runs are of one log and pipeline.
    """
    before, after = ({f.index: f for f in run.frames} for run in (clear, disturbed))
    common = sorted(set(before) & set(after))
    lost = {index: sorted(set(after[index].missing) - set(before[index].missing)) for index in common}
    good = _is_as_good(_track_counts(clear, options), _track_counts(disturbed, options), common)
    found = []
    for sensor in sorted({name for names in lost.values() for name in names}):
        rows = [at for at, index in enumerate(common) if sensor in lost[index]]
        for first, last in _stretches(rows):
            stamps = [after[index].stamp_ns for index in common]
            back = [at for at in range(last + 1, len(common) - STEADY + 1) if all(good[at : at + STEADY])]
            recovery = None if not back else (stamps[back[0]] - stamps[last]) / 1e9
            recovery = 0.0 if all(good[first : last + 1]) else recovery  # the pipeline doesn't miss the sensor
            silent = (stamps[last] - stamps[first]) / 1e9
            found.append(Outage(sensor, common[first], common[last], silent, recovery))
    return found


def mean_recovery(outages: Sequence[Outage], how: Bootstrap) -> Figure:
    """Return the mean time of recovery [ms], from five outages on with the interval of resampled outages; none where
    the tracks didn't recover from one of them.
    """
    if not outages:
        return Figure(None, "no frame lacks a sensor")
    known = [outage.recovery_s for outage in outages if outage.recovery_s is not None]
    if (num := len(known)) < len(outages):
        return Figure(None, f"not recovered in {len(outages) - num} of {len(outages)} outages")
    mean_ms, counts = 1000 * sum(known) / num, {"outages": num}
    if num < LEAST_UNITS:
        return Figure(mean_ms, None, counts)
    rest = (1 - how.share) / 2
    low, high = np.quantile(how.times(num) @ np.array(known) * (1000 / num), [rest, 1 - rest]).tolist()
    return Figure(mean_ms, None, counts, None, low, high)


def _stretches(rows: list[int]) -> list[tuple[int, int]]:
    """First and last of each unbroken stretch of ascending rows."""
    found: list[tuple[int, int]] = []
    for row in rows:
        if found and row == found[-1][1] + 1:
            found[-1] = (found[-1][0], row)
        else:
            found.append((row, row))
    return found


def _track_counts(run: Run, options: ScoreOptions) -> dict[int, Int64]:
    """Hits, false alarms and misses (3,) of tracks by frame, in the pipeline's own space."""
    shared = SharedRun(run.folder)
    view = views(shared, shared.tracks, options)[0]
    judged = judge_detections(compare_class(view.sequence, VEHICLE, view.match))
    steps, c = view.sequence.steps.frame, judged.candidates
    counts = {int(frame): np.zeros(3, np.int64) for frame in steps}
    for step, outcome in zip(c.estimates.step.tolist(), judged.outcome.tolist(), strict=True):
        counts[int(steps[step])] += (outcome == Outcome.HIT, outcome in (Outcome.FALSE_ALARM, Outcome.INVALID), 0)
    for step in c.truth.step.tolist():
        counts[int(steps[step])][2] += 1
    for own in counts.values():
        own[2] -= own[0]
    return counts


def _is_as_good(clear: dict[int, Int64], disturbed: dict[int, Int64], frames: list[int]) -> list[bool]:
    """Whether each frame reaches its share of the clear run's F1; one without truth and tracks does."""

    def f1(counts: Int64 | None) -> float:
        if counts is None or not counts.any():
            return 1.0
        return float(2 * counts[0] / (2 * counts[0] + counts[1] + counts[2]))

    return [f1(disturbed.get(index)) >= AS_GOOD * f1(clear.get(index)) for index in frames]
