"""Explanation of every box of one frame: hit, missed, false alarm or ignored, and why."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from fbench.metrics.core.problem import faults
from fbench.metrics.core.sequence import Objects
from fbench.metrics.core.similarity import Blocks
from fbench.metrics.core.slices import VEHICLE, Group, label_group
from fbench.metrics.detection.outcomes import Counted, alike, counted, judge_detections
from fbench.metrics.detection.outcomes import Outcome as Outcome_of_outcomes
from fbench.metrics.profiles.profile import Match
from fbench.metrics.runs.columns import View, of_steps
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import views
from fbench.metrics.tracking.scores import Followed, follow_tracks, require_unique_ids
from fbench.replay.contracts.errors import ConfigError, MetricError, did_you_mean
from fbench.replay.data.arrays import Array, Float64, Int64
from fbench.replay.data.boxes import LABELS, finite
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.runs.folder import FrameRecord, Run

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
    likeness: float | None  # Distance [m] or intersection over union of the two


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
class Judged:
    """Partners and outcomes of one class of one sequence."""

    what: Literal["detection", "track"]
    group: Group
    counted: Counted
    partner: Int64  # (M,) which of the N truth boxes that must be found each estimate is on; -1: none
    outcome: Array  # (M,) `judge.Outcome`
    options: ScoreOptions
    switches: Mapping[int, tuple[int, int]]
    """Of estimates that are another track than the one that was on their truth before: its id, and its last frame."""

    @cached_property
    def found_by(self) -> Int64:
        """(N,) which estimate is on each truth box; -1: none."""
        found = np.full(len(self.counted.truth_row), -1, np.int64)
        hits = np.flatnonzero(self.partner >= 0)
        found[self.partner[hits]] = hits
        return found

    @property
    def match(self) -> Match:
        """What matches."""
        return self.counted.match


def verdicts(judged: Judged, steps: Int64) -> Table:
    """Return what became of the boxes at these steps."""
    one_by_one = [_Step(judged, int(step)) for step in steps]
    truth = (verdict for step in one_by_one for verdict in step.truth())
    estimates = (verdict for step in one_by_one for verdict in step.estimates())
    return Table(judged.what, tuple(truth), tuple(estimates))


class _Step:
    """One step of a sequence. Boxes are numbered from 0 on, all of a side, whatever their class."""

    def __init__(self, judged: Judged, step: int) -> None:
        self.judged, self.step = judged, step
        sequence, counted = judged.counted.sequence, judged.counted
        self.camera = sequence.steps.camera[step] if sequence.steps.camera else ""
        self.place = "image" if self.camera else "frame"
        self.truth_rows, self.estimate_rows = (
            np.flatnonzero(objects.step == step) for objects in (sequence.truth, sequence.estimates)
        )
        self.similarity = _Near(counted.similarity, step)
        self.excuse = _Near(counted.excuse, step)

    def truth(self) -> list[Verdict]:
        """All truth boxes."""
        place = {int(row): n for n, row in enumerate(self.judged.counted.truth_row)}
        return [self._of_truth(int(row), place.get(int(row))) for row in self.truth_rows]

    def estimates(self) -> list[Verdict]:
        """All estimates."""
        place = {int(row): m for m, row in enumerate(self.judged.counted.estimate_row)}
        return [self._of_estimate(int(row), place.get(int(row))) for row in self.estimate_rows]

    def _of_truth(self, row: int, n: int | None) -> Verdict:
        truth = self.judged.counted.sequence.truth
        if n is None:
            return self._verdict("truth", row, "ignored", self._why_ignored(truth, row))
        m = int(self.judged.found_by[n])
        if m < 0:
            return self._verdict("truth", row, "missed", self._why_missed(n))
        near = self.similarity.value(n, m)
        return self._verdict("truth", row, "hit", f"{self._estimate(m)} is on it, {self._said(near)}", (m, near))

    def _of_estimate(self, row: int, m: int | None) -> Verdict:
        judged, what = self.judged, self.judged.what
        estimates = judged.counted.sequence.estimates
        if m is None:
            told = f"labelled {estimates.label[row]}, which" if estimates.label[row] else "without a class, which"
            why = f"{told} isn't scored as {judged.group.name}"
            return self._verdict(what, row, "ignored", why)
        outcome = Outcome_of_outcomes(int(judged.outcome[m]))
        if outcome == Outcome_of_outcomes.HIT:
            n = int(judged.partner[m])
            near = self.similarity.value(n, m)
            return self._verdict(what, row, "hit", self._why_hit(n, m, near), (n, near))
        if outcome == Outcome_of_outcomes.INVALID:
            return self._verdict(what, row, "invalid", "; ".join(faults(estimates, row, judged.match.likeness)))
        if outcome == Outcome_of_outcomes.OUTSIDE:
            return self._verdict(what, row, "ignored", self._why_outside(estimates, row))
        if outcome == Outcome_of_outcomes.EXCUSED:
            return self._verdict(what, row, "ignored", self._why_excused(m))
        return self._verdict(what, row, "false alarm", self._why_false(m))

    def _why_ignored(self, truth: Objects, row: int) -> str:
        if truth.ignore is not None and truth.ignore[row]:
            return "marked as ignored"
        if not self.judged.group.holds(truth)[row]:
            return f"not of class {self.judged.group.name}: {truth.label[row] or 'without a label'}"
        return self._why_outside(truth, row)

    def _why_missed(self, n: int) -> str:
        m, near = self.similarity.of_row(n)
        if m is None:
            return f"no {self.judged.what} in this {self.place}"
        if near < self.judged.match.floor:
            return f"no {self.judged.what} {self._reach}; nearest is {self._estimate(m)}, {self._said(near)}"
        taken = int(self.judged.partner[m])
        busy = f"is on {self._truth(taken)}" if taken >= 0 else "doesn't count"
        return f"{self._estimate(m)}, {self._said(near)}, {busy}"

    def _why_hit(self, n: int, m: int, near: float) -> str:
        why = f"on {self._truth(n)}, {self._said(near)}"
        if not self.judged.counted.inside[m]:
            why += "; itself outside of the region"
        if m in self.judged.switches:
            number, frame = self.judged.switches[m]
            why += f"; id switch: was {number} at frame {frame}"
        return why

    def _why_false(self, m: int) -> str:
        n, near = self.similarity.of_column(m)
        if n is None:
            return f"no truth to be found in this {self.place}"
        if near < self.judged.match.floor:
            return f"no truth {self._reach}; nearest is {self._truth(n)}, {self._said(near)}"
        return f"{self._truth(n)}, {self._said(near)}, is taken by {self._estimate(int(self.judged.found_by[n]))}"

    def _why_excused(self, m: int) -> str:
        k, _ = self.excuse.of_column(m)
        counted = self.judged.counted
        row = int(counted.rest_row[k or 0])
        return f"on truth {self._number(row, self.truth_rows)}, which needn't be found: " + self._why_ignored(
            counted.sequence.truth, row
        )

    def _why_outside(self, objects: Objects, row: int) -> str:
        options, range_m = self.judged.options, _range(objects, row)
        if range_m is not None and range_m > options.range_m:
            return f"outside of the region: {range_m:.1f} m away, and it ends at {options.range_m:g} m"
        if options.seen and objects.seen is not None and not objects.seen[row]:
            return "no sensor sees it"
        causes = ["no camera sees its centre"] if options.in_view else []
        causes += [f"it isn't on {' or '.join(sorted(options.regions))}"] if options.regions else []
        return "outside of the region" + (f": {', or '.join(causes)}" if causes else "")

    @property
    def _reach(self) -> str:
        match = self.judged.match
        return f"within {match.threshold:g} m" if match.is_distance else f"with an IoU of {match.threshold:g} or more"

    def _said(self, near: float) -> str:
        return f"{-near:.2f} m away" if self.judged.match.is_distance else f"IoU {near:.2f}"

    def _estimate(self, m: int) -> str:
        row = int(self.judged.counted.estimate_row[m])
        return f"{self.judged.what} {self._number(row, self.estimate_rows)}"

    def _truth(self, n: int) -> str:
        return f"truth {self._number(int(self.judged.counted.truth_row[n]), self.truth_rows)}"

    def _number(self, row: int, rows: Int64) -> int:
        return row - int(rows[0])

    def _verdict(
        self,
        side: Literal["truth", "detection", "track"],
        row: int,
        outcome: Outcome,
        reason: str,
        partner: tuple[int, float] | None = None,
    ) -> Verdict:
        counted = self.judged.counted
        own, other, rows, others, of = (
            (counted.sequence.truth, counted.sequence.estimates, self.truth_rows, self.estimate_rows,
             counted.estimate_row)
            if side == "truth" else
            (counted.sequence.estimates, counted.sequence.truth, self.estimate_rows, self.truth_rows,
             counted.truth_row)
        )  # fmt: skip
        with_row = None if partner is None else int(of[partner[0]])
        return Verdict(
            side, self._number(row, rows), self.camera, str(own.label[row]), outcome, reason, _id(own, row),
            None if side == "truth" else _finite(own.score[row]), _range(own, row),
            None if with_row is None else self._number(with_row, others),
            None if with_row is None else _id(other, with_row), None if partner is None else abs(partner[1]),
        )  # fmt: skip


class _Near:
    """Values of the pairs of one step, by the rows and columns of the whole sequence."""

    def __init__(self, blocks: Blocks, step: int) -> None:
        self.values = blocks.block(step)
        self.first = int(blocks.row_start[step]), int(blocks.column_start[step])

    def value(self, row: int, column: int) -> float:
        """Of one pair."""
        return float(self.values[row - self.first[0], column - self.first[1]])

    def of_row(self, row: int) -> tuple[int | None, float]:
        """The column that is nearest, and how near."""
        at, value = _best(self.values[row - self.first[0]])
        return (None if at is None else at + self.first[1]), value

    def of_column(self, column: int) -> tuple[int | None, float]:
        """The row that is nearest, and how near."""
        at, value = _best(self.values[:, column - self.first[1]])
        return (None if at is None else at + self.first[0]), value


def _best(values: Float64) -> tuple[int | None, float]:
    if not np.isfinite(values).any():
        return None, -np.inf
    at = int(np.nanargmax(values))
    return at, float(values[at])


def _id(objects: Objects, row: int) -> int | None:
    number = int(objects.track_id[row])
    return number if number >= 0 else None


def _range(objects: Objects, row: int) -> float | None:
    if objects.center_m is not None:
        return _finite(np.hypot(objects.center_m[row, 0], objects.center_m[row, 1]))
    return None if objects.distance_m is None else _finite(objects.distance_m[row])


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


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
    found = follow_tracks(view.sequence, group, view.match)
    held, used = found.counted, np.flatnonzero(found.used)
    partner = np.full(len(held.estimate_row), -1, np.int64)
    partner[used] = found.pairs.truth_of
    outcome = found.judgement.outcome.copy()
    outcome[used] = np.where(found.pairs.truth_of >= 0, Outcome_of_outcomes.HIT, Outcome_of_outcomes.FALSE_ALARM)
    outcome[held.invalid] = Outcome_of_outcomes.INVALID
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
