"""Counts and scores of critical errors, weighted by what they cost the vehicle."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from fbench.metrics.core.exact import Counts, exact_sum
from fbench.metrics.core.ordering import number_tracks
from fbench.metrics.core.slices import ScoreKey
from fbench.metrics.criticality import contours
from fbench.metrics.criticality.conflict import Conflicts
from fbench.metrics.criticality.motion import EGO_UNKNOWN, MAX_GAP_S
from fbench.metrics.detection.outcomes import Judgement, Outcome
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Steps


@dataclass(frozen=True, eq=False)
class Errors:
    """What became of the boxes of one class that count: N of truth, K hits and M false alarms."""

    truth_row: Int64  # (N,) rows of the sequence's truth
    hit: Bool  # (N,)
    switched: Bool  # (N,) found by another track than before
    pairs: tuple[Int64, Int64]  # (K,) rows of the sequence's truth and estimates that are a hit together
    alarm_row: Int64  # (M,) rows of the sequence's estimates

    @classmethod
    def of(cls, judgement: Judgement, switched_row: Int64 | None = None) -> "Errors":
        """Return what was judged; `switched_row` are rows of the sequence's truth."""
        c = judgement.candidates
        found = np.flatnonzero(judgement.truth_of_estimate >= 0)
        of, hit = judgement.truth_of_estimate[found], np.zeros(len(c.truth_row), bool)
        hit[of] = True
        alarm = np.isin(judgement.outcome, (Outcome.FALSE_ALARM, Outcome.INVALID))
        switched = np.zeros(len(hit), bool) if switched_row is None else np.isin(c.truth_row, switched_row)
        pairs = c.truth_row[of], c.estimate_row[found]
        return cls(c.truth_row, hit, switched, pairs, c.estimate_row[alarm])


@dataclass(frozen=True)
class CriticalityCounts(Counts):
    """Sufficient statistics of one class. Weights are criticalities, see `Conflicts.weight`."""

    ego_frames: int = 0  # Steps at which the ego's motion is known
    truth: int = 0  # Truth boxes whose motion is known
    unknown_truth: int = 0
    critical: int = 0  # Truth boxes in a critical conflict
    misses: int = 0  # Of these
    alarms: int = 0  # False alarms whose motion is known
    unknown_alarms: int = 0
    critical_alarms: int = 0
    truth_weight: Fraction = Fraction(0)
    hit_weight: Fraction = Fraction(0)
    alarm_weight: Fraction = Fraction(0)
    switch_weight: Fraction = Fraction(0)
    missed: int = 0  # Objects that were in conflict while they were missed
    braking: Fraction = Fraction(0)  # [m/s^2] Sum over these objects of the largest deceleration
    evading: Fraction = Fraction(0)  # [m/s^2] Likewise of the lateral acceleration
    phantoms: int = 0  # False objects in conflict
    speed_loss: Fraction = Fraction(0)  # [m/s] that braking for them costs
    hits: int = 0
    surface: Fraction = Fraction(0)  # [m] Sums of absolute errors over hits
    surface_bias: Fraction = Fraction(0)  # [m] Signed: above 0 where results are too far away
    support: Fraction = Fraction(0)
    contour: Fraction = Fraction(0)


def count_errors(
    errors: Errors, truth: Objects, estimates: Objects, steps: Steps, conflicts: tuple[Conflicts, Conflicts],
    ego_speed_mps: Float64,
) -> CriticalityCounts:  # fmt: skip
    """Count the errors of one class. `conflicts` are of all truth and of all estimates of a sequence; `ego_speed_mps`
    (S,) is NaN where it isn't known.
    """
    of_truth, of_alarms = conflicts[0][errors.truth_row], conflicts[1][errors.alarm_row]
    weight, alarm_weight = (np.where(c.known, c.weight, 0.0) for c in (of_truth, of_alarms))
    missed, feared = ~errors.hit & (weight > 0), alarm_weight > 0
    lost = number_objects(truth, errors.truth_row[missed], steps)
    braking, evading = (
        exact_sum(_peaks(effort[missed], lost)) for effort in (of_truth.deceleration_mps2, of_truth.lateral_mps2)
    )
    rows = errors.alarm_row[feared]
    phantom, at = number_objects(estimates, rows, steps), estimates.step[rows]
    loss = np.bincount(phantom, (of_alarms.deceleration_mps2[feared] * step_lengths_s(steps)[at]))
    return CriticalityCounts(
        ego_frames=int(np.isfinite(ego_speed_mps).sum()),
        truth=int(of_truth.known.sum()),
        unknown_truth=int((~of_truth.known).sum()),
        critical=int(of_truth.critical.sum()),
        misses=int((of_truth.critical & ~errors.hit).sum()),
        alarms=int(of_alarms.known.sum()),
        unknown_alarms=int((~of_alarms.known).sum()),
        critical_alarms=int(of_alarms.critical.sum()),
        truth_weight=exact_sum(weight),
        hit_weight=exact_sum(weight[errors.hit]),
        alarm_weight=exact_sum(alarm_weight),
        switch_weight=exact_sum(weight[errors.switched]),
        missed=int(lost.max(initial=-1)) + 1,
        braking=braking,
        evading=evading,
        phantoms=len(loss),
        # Nobody loses more speed than there is.
        speed_loss=exact_sum(np.minimum(loss, _peaks(ego_speed_mps[at], phantom))),
    )


WEIGHT_BITS = 32
STEP_COUNTS = ("misses", "critical_alarms", "hit_weight", "truth_weight", "alarm_weight", "switch_weight")
"""What is counted of each step; weights in units of 2^-32, as whole numbers are exact in whatever order they are added.
"""


def count_steps(errors: Errors, at: tuple[Int64, Int64], num: int, conflicts: tuple[Conflicts, Conflicts]) -> Int64:
    """Count `STEP_COUNTS` (num, 6) of one class in each step; `at` are the steps of all truth and of all estimates."""
    of_truth, of_alarms = conflicts[0][errors.truth_row], conflicts[1][errors.alarm_row]
    truth, alarms = at[0][errors.truth_row], at[1][errors.alarm_row]
    weight, alarm_weight = (
        np.round(np.where(c.known, c.weight, 0.0) * 2**WEIGHT_BITS).astype(np.int64) for c in (of_truth, of_alarms)
    )
    parts = (
        (truth, of_truth.critical & ~errors.hit), (alarms, of_alarms.critical), (truth, weight * errors.hit),
        (truth, weight), (alarms, alarm_weight), (truth, weight * errors.switched),
    )  # fmt: skip
    counts = np.zeros((num, len(STEP_COUNTS)), np.int64)
    for column, (step, values) in enumerate(parts):
        np.add.at(counts[:, column], step, values)
    return counts


def number_objects(objects: Objects, rows: Int64, steps: Steps) -> Int64:
    """Number the objects that rows (K,) belong to from 0 on; a box without an id is one of its own."""
    own = objects.track_id[rows]
    return number_tracks(np.where(own < 0, -1 - np.arange(len(rows)), own), steps.stream[objects.step[rows]])


def _peaks(values: Float64, number: Int64) -> Float64:
    """Largest of the values (K,) of each number (K,), which are those from 0 on."""
    found = np.zeros(int(number.max(initial=-1)) + 1)
    np.maximum.at(found, number, values)
    return found


def step_lengths_s(steps: Steps) -> Float64:
    """Return how long (S,) each step lasts, until the next of its stream, `MAX_GAP_S` at most; the last of a stream as
    long as the one before.
    """
    length = np.zeros(len(steps))
    for stream in np.unique(steps.stream):
        own = np.flatnonzero(steps.stream == stream)
        if len(own) > 1:
            lapse = np.diff(steps.stamp_ns[own]) * 1e-9
            length[own] = np.clip(np.append(lapse, lapse[-1]), 0.0, MAX_GAP_S)
    return length


def measure_hits(truth: Objects, estimates: Objects, pairs: tuple[Int64, Int64]) -> CriticalityCounts:
    """Compare what the ego sees of hits, which are rows (K,) of truth and of estimates: nearest surface, support
    distances and contour, see `fbench.metrics.criticality.contours`. Counts nothing of boxes without a place in space.
    """
    real, found = (_outlines(side, rows) for side, rows in zip((truth, estimates), pairs, strict=True))
    if real is None or found is None or truth.yaw_rad is None:
        return CriticalityCounts()
    far = contours.surface_distances(found) - contours.surface_distances(real)
    support = np.abs(contours.support_distances(found) - contours.support_distances(real))
    return CriticalityCounts(
        hits=len(far),
        surface=exact_sum(np.abs(far)),
        surface_bias=exact_sum(far),
        support=exact_sum(np.maximum(support[:, 0], support[:, 1])),
        contour=exact_sum(contours.contour_errors(real, truth.yaw_rad[pairs[0]], found)),
    )


def _outlines(objects: Objects, rows: Int64) -> Float64 | None:
    if objects.center_m is None or objects.size_lwh_m is None or objects.yaw_rad is None:
        return None
    return contours.corners(objects.center_m[rows, :2], objects.size_lwh_m[rows, :2], objects.yaw_rad[rows])


def _ratio(top: float, bottom: float) -> float | None:
    return top / bottom if bottom > 0 else None


@dataclass(frozen=True)
class Rule:
    """How a metric follows from counts."""

    names: tuple[str, ...]  # Of the counts that its row has, with those that say whether motion is known
    value: Callable[[Mapping[str, int | float]], int | float | None]
    why: str = ""  # Why it is null where counts give no value
    unit: str = "1"
    needs: tuple[str, ...] = ("ego_frames", "truth")
    """Counts of what must be known, if there is any; `unknown_...` counts the rest of it."""

    @property
    def counts(self) -> tuple[str, ...]:
        """Names of all counts of its row."""
        unknown = (f"unknown_{name}" for name in self.needs if name != "ego_frames")
        return tuple(dict.fromkeys((*self.names, *self.needs, *unknown)))

    def evaluate(self, n: Mapping[str, int | float]) -> tuple[int | float | None, str | None]:
        """Return the value that counts give, or why there is none."""
        for name in self.needs:
            if not n[name] and (name == "ego_frames" or n[f"unknown_{name}"]):
                return None, _UNKNOWN[name]
        value = self.value(n)
        return value, self.why if value is None else None


_UNKNOWN = {
    "ego_frames": EGO_UNKNOWN,
    "truth": "truth has no velocities, nor ids to derive them from",
    "alarms": "no false alarm is a finite box",
}
_HITS, _COURSE = "no hits", "nothing was on a collision course"
_MISSED = "no object was missed on a collision course"
_EGO, _BOTH = ("ego_frames", "alarms"), ("ego_frames", "truth", "alarms")
OF_DETECTIONS: Mapping[str, Rule] = {
    "critical_misses": Rule(("misses", "critical"), lambda n: n["misses"]),
    "critical_false_alarms": Rule(("critical_alarms",), lambda n: n["critical_alarms"], needs=_EGO),
    "weighted_recall": Rule(
        ("hit_weight", "truth_weight"), lambda n: _ratio(n["hit_weight"], n["truth_weight"]),
        _COURSE,
    ),
    "weighted_f1": Rule(
        ("hit_weight", "truth_weight", "alarm_weight"),
        lambda n: _ratio(2 * n["hit_weight"], n["hit_weight"] + n["truth_weight"] + n["alarm_weight"]),
        "nothing was on a collision course, nor seemed to be", needs=_BOTH,
    ),
    "surface_error": Rule(
        ("hits", "surface", "surface_bias"), lambda n: _ratio(n["surface"], n["hits"]), _HITS, "m", needs=()
    ),
    "support_distance_error": Rule(
        ("hits", "support"), lambda n: _ratio(n["support"], n["hits"]), _HITS, "m", needs=()
    ),
    "contour_error": Rule(("hits", "contour"), lambda n: _ratio(n["contour"], n["hits"]), _HITS, "m", needs=()),
}  # fmt: skip
OF_TRACKS: Mapping[str, Rule] = {
    "critical_untracked": Rule(("misses", "critical"), lambda n: n["misses"]),
    "critical_false_tracks": Rule(("critical_alarms",), lambda n: n["critical_alarms"], needs=_EGO),
    "weighted_mota": Rule(
        ("hit_weight", "truth_weight", "alarm_weight", "switch_weight"),
        lambda n: _ratio(n["hit_weight"] - n["alarm_weight"] - n["switch_weight"], n["truth_weight"]),
        _COURSE, needs=_BOTH,
    ),
    "mdr": Rule(("braking", "missed"), lambda n: _ratio(n["braking"], n["missed"]), _MISSED, "m/s2"),
    "lea": Rule(("evading", "missed"), lambda n: _ratio(n["evading"], n["missed"]), _MISSED, "m/s2"),
    "fsr": Rule(("speed_loss", "phantoms"), lambda n: n["speed_loss"], "", "m/s", needs=_EGO),
}  # fmt: skip
RULES = {**OF_DETECTIONS, **OF_TRACKS}


def rows_of(n: CriticalityCounts, head: ScoreKey, rules: Mapping[str, Rule]) -> list[Score]:
    """Return one row a rule."""
    rows = []
    for metric, rule in rules.items():
        numbers = ((name, getattr(n, name)) for name in rule.counts)
        counts = {name: number if isinstance(number, int) else float(number) for name, number in numbers}
        value, why = rule.evaluate(counts)
        rows.append(head.score(metric, value, head.reason or why, counts, rule.unit))
    return rows
