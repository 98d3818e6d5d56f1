"""Explanation of every box of one frame: hit, missed, false alarm or ignored, and why."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from fbench.metrics.core.problem import faults
from fbench.metrics.core.slices import VEHICLE, Group, ground_range, label_group
from fbench.metrics.detection.outcomes import Judgement, compare_class, judge_detections
from fbench.metrics.detection.outcomes import Outcome as BoxOutcome
from fbench.metrics.runs.columns import View, of_steps
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import views
from fbench.metrics.tracking.scores import follow_tracks, require_unique_ids
from fbench.replay.contracts.errors import ConfigError, MetricError, did_you_mean
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import LABELS, finite
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.data.sequences import Objects
from fbench.replay.runs.folder import Run

Outcome = Literal["hit", "missed", "false alarm", "ignored", "invalid"]


@dataclass(frozen=True)
class Verdict:
    """One truth box, detection or track in one frame, or in one image of it."""

    side: Literal["truth", "detection", "track"]
    number: int  # Counted from 0 on in its frame or image and side, in an order that depends on the boxes alone
    camera: str  # Empty in 3D
    class_: str  # Its label; empty where there is none
    outcome: Outcome
    reason: str
    track_id: int | None
    score: float | None  # Of estimates; `None` where it isn't finite
    range_m: float | None
    """From the body in the ground plane in 3D; as the results tell it in images; `None` where unknown."""
    partner: int | None  # Number of the box of the other side that it was matched with
    partner_id: int | None
    similarity: float | None  # Distance [m] or intersection over union of the two


@dataclass(frozen=True)
class Table:
    """Truth beside detections, or beside tracks."""

    judged: Literal["detection", "track"]
    truth: tuple[Verdict, ...]
    estimates: tuple[Verdict, ...]


@dataclass(frozen=True)
class Explanation:
    """One frame of a run."""

    frame: int
    stamp_ns: int
    class_: str
    matching: str
    num_invalid_truth: int  # Truth boxes of the frame that aren't finite: left out and counted (GT004)
    tables: tuple[Table, ...]  # Of detections, then of tracks

    def content(self) -> dict[str, object]:
        """Return it as plain data, for JSON."""
        rows = asdict(self)
        for table in rows["tables"]:
            for side in ("truth", "estimates"):
                table[side] = [{("class" if k == "class_" else k): v for k, v in row.items()} for row in table[side]]
        return {("class" if key == "class_" else key): value for key, value in rows.items()}


@dataclass(frozen=True, eq=False)
class _Judged:
    """Outcomes of one class, and what they depend on."""

    what: Literal["detection", "track"]
    group: Group
    options: ScoreOptions
    judgement: Judgement
    switches: Mapping[int, tuple[int, int]]
    """Of estimates that are another track than the one that was on their truth before: its id, and its last frame."""

    @cached_property
    def estimate_on(self) -> Int64:
        """(N,) which estimate is on each truth box; -1: none."""
        found = np.full(len(self.judgement.candidates.truth_row), -1, np.int64)
        hits = np.flatnonzero(self.judgement.truth_of_estimate >= 0)
        found[self.judgement.truth_of_estimate[hits]] = hits
        return found

    def table(self, steps: Int64) -> Table:
        """Return what became of the boxes at these steps."""
        parts, c = [_Step(self, int(step)) for step in steps], self.judgement.candidates
        place = {row: n for n, row in enumerate(c.truth_row.tolist())}
        truth = [part.of_truth(row, place.get(row)) for part in parts for row in part.truth_rows]
        place = {row: m for m, row in enumerate(c.estimate_row.tolist())}
        estimates = [part.of_estimate(row, place.get(row)) for part in parts for row in part.estimate_rows]
        return Table(self.what, tuple(truth), tuple(estimates))


class _Step:
    """One step of a sequence. Boxes are numbered from 0 on, all of a side, whatever their class."""

    def __init__(self, judged: _Judged, step: int) -> None:
        c = judged.judgement.candidates
        self.judged, self.candidates, self.match = judged, c, c.match
        self.truth, self.estimates = c.sequence.truth, c.sequence.estimates
        self.camera = c.sequence.steps.camera[step] if c.sequence.steps.camera else ""
        self.place = "image" if self.camera else "frame"
        self.truth_rows = range(*np.searchsorted(self.truth.step, [step, step + 1]).tolist())
        self.estimate_rows = range(*np.searchsorted(self.estimates.step, [step, step + 1]).tolist())
        self.similarity, self.excuse = c.similarity.block(step), c.excuse.block(step)
        self.first_n, self.first_m = int(c.similarity.row_start[step]), int(c.similarity.column_start[step])
        self.first_k = int(c.excuse.row_start[step])

    def of_truth(self, row: int, n: int | None) -> Verdict:
        """Return the verdict on a truth box, the n-th of those to be found."""
        if n is None:
            return self._verdict("truth", row, "ignored", self._why_ignored(row))
        what, m = self.judged.what, int(self.judged.estimate_on[n])
        values = self.similarity[n - self.first_n]
        if m >= 0:
            near = float(values[m - self.first_m])
            reason = f"{self._estimate(m)} is on it, {self._reach(near)}"
            return self._verdict("truth", row, "hit", reason, int(self.candidates.estimate_row[m]), near)
        best, near = _nearest(values)
        if best is None:
            return self._verdict("truth", row, "missed", f"no {what} in this {self.place}")
        m = best + self.first_m
        nearest = f"{self._estimate(m)}, {self._reach(near)}"
        if near < self.match.floor:
            return self._verdict("truth", row, "missed", f"no {what} {self._limit()}; nearest is {nearest}")
        taken = int(self.judged.judgement.truth_of_estimate[m])
        busy = f"is on {self._truth(taken)}" if taken >= 0 else "doesn't count"
        return self._verdict("truth", row, "missed", f"{nearest}, {busy}")

    def of_estimate(self, row: int, m: int | None) -> Verdict:
        """Return the verdict on an estimate, the m-th of the class."""
        judged, what = self.judged, self.judged.what
        if m is None:
            own = self.estimates.label[row]
            label = f"labelled {own}" if own else "without a class"
            return self._verdict(what, row, "ignored", f"{label}, which isn't scored as {judged.group.name}")
        outcome = judged.judgement.outcome[m]
        if outcome == BoxOutcome.HIT:
            n = int(judged.judgement.truth_of_estimate[m])
            near = float(self.similarity[n - self.first_n, m - self.first_m])
            why = f"on {self._truth(n)}, {self._reach(near)}"
            why += "" if self.candidates.inside[m] else "; itself outside of the region"
            if m in judged.switches:
                number, frame = judged.switches[m]
                why += f"; id switch: was {number} at frame {frame}"
            return self._verdict(what, row, "hit", why, int(self.candidates.truth_row[n]), near)
        if outcome == BoxOutcome.INVALID:
            return self._verdict(what, row, "invalid", "; ".join(faults(self.estimates, row, self.match.kind)))
        if outcome == BoxOutcome.OUTSIDE:
            return self._verdict(what, row, "ignored", self._why_outside(self.estimates, row))
        if outcome == BoxOutcome.EXCUSED:
            k = self.first_k + int(np.nanargmax(self.excuse[:, m - self.first_m]))
            by = int(np.flatnonzero(~self.candidates.must)[k])
            why = f"on truth {by - self.truth_rows.start}, which needn't be found: {self._why_ignored(by)}"
            return self._verdict(what, row, "ignored", why)
        best, near = _nearest(self.similarity[:, m - self.first_m])
        if best is None:
            why = f"no truth to be found in this {self.place}"
        elif near < self.match.floor:
            why = f"no truth {self._limit()}; nearest is {self._truth(best + self.first_n)}, {self._reach(near)}"
        else:
            taker = self._estimate(int(judged.estimate_on[best + self.first_n]))
            why = f"{self._truth(best + self.first_n)}, {self._reach(near)}, is taken by {taker}"
        return self._verdict(what, row, "false alarm", why)

    def _why_ignored(self, row: int) -> str:
        if self.truth.ignore is not None and self.truth.ignore[row]:
            return "marked as ignored"
        if not self.judged.group.holds(self.truth)[row]:
            return f"not of class {self.judged.group.name}: {self.truth.label[row] or 'without a label'}"
        return self._why_outside(self.truth, row)

    def _why_outside(self, objects: Objects, row: int) -> str:
        options, range_m = self.judged.options, _range(objects, row)
        if range_m is not None and range_m > options.range_m:
            return f"outside of the region: {range_m:.1f} m away, and it ends at {options.range_m:g} m"
        if options.seen and objects.seen is not None and not objects.seen[row]:
            return "no sensor sees it"
        causes = ["no camera sees its center"] if options.in_view else []
        causes += [f"it isn't on {' or '.join(sorted(options.regions))}"] if options.regions else []
        return "outside of the region" + (f": {', or '.join(causes)}" if causes else "")

    def _limit(self) -> str:
        threshold = self.match.threshold
        return f"within {threshold:g} m" if self.match.is_distance else f"with an IoU of {threshold:g} or more"

    def _reach(self, near: float) -> str:
        return f"{-near:.2f} m away" if self.match.is_distance else f"IoU {near:.2f}"

    def _estimate(self, m: int) -> str:
        return f"{self.judged.what} {self.candidates.estimate_row[m] - self.estimate_rows.start}"

    def _truth(self, n: int) -> str:
        return f"truth {self.candidates.truth_row[n] - self.truth_rows.start}"

    def _verdict(
        self, side: Literal["truth", "detection", "track"], row: int, outcome: Outcome, reason: str,
        partner: int | None = None, near: float | None = None,
    ) -> Verdict:  # fmt: skip
        """Verdict on one row of a side, and its partner's row of the other."""
        own, other, rows, others = self.truth, self.estimates, self.truth_rows, self.estimate_rows
        if side != "truth":
            own, other, rows, others = other, own, others, rows
        return Verdict(
            side, row - rows.start, self.camera, str(own.label[row]), outcome, reason, _id(own, row),
            None if side == "truth" else _finite(own.score[row]), _range(own, row),
            None if partner is None else partner - others.start, None if partner is None else _id(other, partner),
            None if near is None else abs(near),
        )  # fmt: skip


def _nearest(values: Float64) -> tuple[int | None, float]:
    """Where the best value is, and the value."""
    if not np.isfinite(values).any():
        return None, -np.inf
    at = int(np.nanargmax(values))
    return at, float(values[at])


def _id(objects: Objects, row: int) -> int | None:
    return int(objects.track_id[row]) if objects.track_id[row] >= 0 else None


def _range(objects: Objects, row: int) -> float | None:
    range_m = ground_range(objects[row : row + 1])
    return None if range_m is None else _finite(range_m[0])


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def explain_frame(run: Run, options: ScoreOptions, frame: int, class_: str = VEHICLE.name) -> Explanation:
    """Return what became of each box of a frame, by its index, in the pipeline's own space, as the scores count it.

    `class_` is all vehicles as one class, or one label. Raises ConfigError where there is no such frame or class.
    Raises MetricError where the frame has no truth, so that it isn't scored, or an id is twice in a frame (GT003).
    """
    if class_ not in (VEHICLE.name, *LABELS):
        raise ConfigError(f"unknown class '{class_}'{did_you_mean(class_, [VEHICLE.name, *LABELS])}")
    group, shared = VEHICLE if class_ == VEHICLE.name else label_group(class_), SharedRun(run.folder)
    record = next((f for f in run.frames if f.index == frame), None)
    if record is None:
        known = f"{run.frames[0].index} to {run.frames[-1].index}" if run.frames else "none"
        raise ConfigError(f"{run.folder}: there is no frame {frame}; frames are {known}")
    found, tracked = (views(shared, table, options)[0] for table in (shared.detections, shared.tracks))
    is_frame = found.sequence.steps.frame == frame
    reason = found.key.reason or (None if is_frame.any() else "it has no truth")
    if reason is not None:
        raise MetricError(f"{run.folder}: frame {frame} isn't scored: {reason}", "GT001")
    require_unique_ids(tracked.sequence, str(run.folder))
    is_recorded = found.match.kind == "iou2d" and "2d" in record.truth_spaces.split()
    truth = shared.truth2d(frame) if is_recorded else shared.truth3d(frame)
    num_invalid = 0 if truth is None else int((~finite(truth)[0]).sum())

    own = of_steps(found.sequence, is_frame)
    detections = judge_detections(compare_class(own, group, found.match))
    tables = (
        _Judged("detection", group, options, detections, {}).table(np.arange(len(own.steps))),
        # Whom a track is on depends on the frames before.
        _judge_tracks(tracked, group, options).table(np.flatnonzero(tracked.sequence.steps.frame == frame)),
    )
    return Explanation(frame, record.stamp_ns, class_, found.key.matching, num_invalid, tables)


def _judge_tracks(view: View, group: Group, options: ScoreOptions) -> _Judged:
    judgement, problem, pairs = follow_tracks(view.sequence, group, view.match)
    candidates, used = judgement.candidates, np.flatnonzero(judgement.is_used)
    frames = view.sequence.steps.frame[candidates.truth.step]
    rows = np.flatnonzero(pairs.estimate_of >= 0)
    last: dict[int, tuple[int, int]] = {}
    switches: dict[int, tuple[int, int]] = {}
    for row, estimate in zip(rows.tolist(), used[pairs.estimate_of[rows]].tolist(), strict=True):
        number, truth = int(candidates.estimates.track_id[estimate]), int(problem.truth_id[row])
        if number < 0:
            continue
        if truth in last and last[truth][0] != number:
            switches[estimate] = last[truth]
        last[truth] = number, int(frames[row])
    return _Judged("track", group, options, judgement, switches)
