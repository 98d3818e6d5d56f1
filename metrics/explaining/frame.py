"""Every box of one frame of a run: hit, missed, false alarm or ignored, and why."""

import numpy as np

from fbench.metrics.explaining.reasons import Judged, verdicts
from fbench.metrics.explaining.verdict import Explanation, Table
from fbench.metrics.runs.columns import of_steps
from fbench.metrics.runs.shared import SharedRun
from fbench.metrics.runs.view import View
from fbench.metrics.runs.views import views
from fbench.metrics.standard.counted import alike, counted
from fbench.metrics.standard.groups import VEHICLE, Group, label_group
from fbench.metrics.standard.judge import Outcome, judge_detections
from fbench.metrics.standard.tracking import Followed, followed, require_unique_ids
from fbench.replay.boxes import finite
from fbench.replay.data import LABELS
from fbench.replay.errors import ConfigError, MetricError
from fbench.replay.names import did_you_mean
from fbench.replay.scores import ScoreOptions
from fbench.replay.store import FrameRecord, Run


def explain_frame(run: Run, options: ScoreOptions, frame: int, class_: str = VEHICLE.name) -> Explanation:
    """Return what became of each box of a frame, in the pipeline's own space, as the scores count it.

    Args:
        run: A run with truth.
        options: As it is scored.
        frame: Index of the frame.
        class_: All vehicles as one class, or one label.

    Raises:
        ConfigError: where there is no such frame or class.
        MetricError: where the frame has no truth, so that it isn't scored, or an id is twice in a frame (GT003).
    """
    group, shared = _group(class_), SharedRun(run.folder)
    record = next((f for f in run.frames if f.index == frame), None)
    if record is None:
        known = f"{run.frames[0].index} to {run.frames[-1].index}" if run.frames else "none"
        raise ConfigError(f"{run.folder}: there is no frame {frame}; frames are {known}")
    found, tracked = (views(shared, table, options)[0] for table in (shared.detections, shared.tracks))
    reason = found.reason or (None if (found.sequence.steps.frame == frame).any() else "it has no truth")
    if reason is not None:
        raise MetricError(f"{run.folder}: frame {frame} isn't scored: {reason}", "GT001")
    require_unique_ids(tracked.sequence, str(run.folder))
    tables = (_detections(found, group, frame, options), _tracks(tracked, group, frame, options))
    return Explanation(frame, record.stamp_ns, class_, found.matching, _num_invalid(shared, record, found), tables)


def _num_invalid(run: Run, record: FrameRecord, view: View) -> int:
    is_recorded = view.match.likeness == "iou2d" and "2d" in record.truth_spaces.split()
    truth = run.truth2d(record.index) if is_recorded else run.truth3d(record.index)
    return 0 if truth is None else int((~finite(truth)[0]).sum())


def _group(class_: str) -> Group:
    if class_ == VEHICLE.name:
        return VEHICLE
    if class_ not in LABELS:
        raise ConfigError(f"unknown class '{class_}'{did_you_mean(class_, [VEHICLE.name, *LABELS])}")
    return label_group(class_)


def _detections(view: View, group: Group, frame: int, options: ScoreOptions) -> Table:
    own = of_steps(view.sequence, view.sequence.steps.frame == frame)
    found = judge_detections(counted(alike(own, group, view.match)))
    judged = Judged(
        "detection", group, found.counted, found.truth_of_estimate, found.outcome, options, {}
    )  # fmt: skip
    return verdicts(judged, np.arange(len(own.steps)))


def _tracks(view: View, group: Group, frame: int, options: ScoreOptions) -> Table:
    """Whom a track is on depends on the frames before."""
    found = followed(view.sequence, group, view.match)
    held, used = found.counted, np.flatnonzero(found.used)
    partner = np.full(len(held.estimate_row), -1, np.int64)
    partner[used] = found.pairs.truth_of
    outcome = found.judgement.outcome.copy()
    outcome[used] = np.where(found.pairs.truth_of >= 0, Outcome.HIT, Outcome.FALSE_ALARM)
    outcome[held.invalid] = Outcome.INVALID
    judged = Judged("track", group, held, partner, outcome, options, _switches(found))
    return verdicts(judged, np.flatnonzero(view.sequence.steps.frame == frame))


def _switches(found: Followed) -> dict[int, tuple[int, int]]:
    """Matches of truth with another id than at its last match: id and frame of that, by the estimate (M,)."""
    held, used = found.counted, np.flatnonzero(found.used)
    frames = held.sequence.steps.frame[held.truth.step]
    rows = np.flatnonzero(found.pairs.estimate_of >= 0)
    last: dict[int, tuple[int, int]] = {}
    switches: dict[int, tuple[int, int]] = {}
    for row, estimate in zip(rows.tolist(), used[found.pairs.estimate_of[rows]].tolist(), strict=True):
        number, truth = int(held.estimates.track_id[estimate]), int(found.problem.truth_id[row])
        if number < 0:
            continue
        if truth in last and last[truth][0] != number:
            switches[estimate] = last[truth]
        last[truth] = number, int(frames[row])
    return switches
