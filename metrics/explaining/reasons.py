"""Why a box is a hit, missed, a false alarm or neither, in words."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from fbench.metrics.explaining.verdict import Outcome as Word
from fbench.metrics.explaining.verdict import Table, Verdict
from fbench.metrics.matching.blocks import Blocks
from fbench.metrics.objects import Objects
from fbench.metrics.profile import Match
from fbench.metrics.standard.counted import Counted
from fbench.metrics.standard.groups import Group
from fbench.metrics.standard.judge import Outcome
from fbench.metrics.validity import faults
from fbench.replay.arrays import Array, Float64, Int64
from fbench.replay.scores import ScoreOptions


@dataclass(frozen=True, eq=False)
class Judged:
    """Partners and outcomes of one class of one sequence."""

    what: Literal["detection", "track"]
    group: Group
    counted: Counted
    partner: Int64
    """(M,) which of the N truth boxes that must be found each estimate is on; -1: none."""
    outcome: Array
    """(M,) `judge.Outcome`."""
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
        outcome = Outcome(int(judged.outcome[m]))
        if outcome == Outcome.HIT:
            n = int(judged.partner[m])
            near = self.similarity.value(n, m)
            return self._verdict(what, row, "hit", self._why_hit(n, m, near), (n, near))
        if outcome == Outcome.INVALID:
            return self._verdict(what, row, "invalid", "; ".join(faults(estimates, row, judged.match.likeness)))
        if outcome == Outcome.OUTSIDE:
            return self._verdict(what, row, "ignored", self._why_outside(estimates, row))
        if outcome == Outcome.EXCUSED:
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
        outcome: Word,
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
