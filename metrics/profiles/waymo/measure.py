"""Counts of the Waymo Open Dataset's detection metrics: each class matched anew at 101 thresholds of the score."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy.optimize import linear_sum_assignment

from fbench.metrics.core.exact import Counts
from fbench.metrics.core.problem import is_valid
from fbench.metrics.core.similarity import Blocks, blocks, compare_tolerantly
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.sequences import Objects, Sequence

CUTOFFS = np.append(np.arange(100) * 0.01, 1.0).astype(np.float32)
RANGES_M = (0.0, 30.0, 50.0, np.inf)
HARD_POINTS = 5  # Truth with so few points is of level 2, with none it doesn't count
_WEIGHT_STEPS = 1_000_000  # Waymo's matcher rounds weights to so many steps


@dataclass(frozen=True)
class ClassRule:
    """One class and what matches in it."""

    name: str
    labels: tuple[str, ...]
    overlap: float  # Least intersection over union


@dataclass(frozen=True)
class CurveCounts(Counts):
    """Counts at each of the cutoffs, of one class, range and level."""

    hits: tuple[int, ...] = (0,) * len(CUTOFFS)
    alarms: tuple[int, ...] = (0,) * len(CUTOFFS)
    misses: tuple[int, ...] = (0,) * len(CUTOFFS)
    heading: tuple[Fraction, ...] = (Fraction(0),) * len(CUTOFFS)  # Sums of heading accuracies over hits
    affinity: tuple[Fraction, ...] = (Fraction(0),) * len(CUTOFFS)  # Sums of longitudinal affinities over hits


Place = tuple[str, str, int]  # Class, range (`` or `0-30 m`), level


@dataclass(frozen=True)
class WaymoStatistics(Counts):
    """All classes over some sequences."""

    curves: Mapping[Place, CurveCounts]
    num_frames: int
    num_invalid_truth: int
    num_invalid_estimates: int  # Counted as false alarms


def measure(
    sequence: Sequence, rules: tuple[ClassRule, ...], sensor_m: tuple[float, float, float] | None
) -> WaymoStatistics:
    """Match a sequence; `sensor_m`: with longitudinal tolerance, seen from there on the body; `None`: without.

    Truth without points, or that is ignored, is left out, so that results on it are false. Raises MetricError where
    boxes have no place in space.
    """
    valid_truth, valid = (is_valid(objects, "iou3d") for objects in (sequence.truth, sequence.estimates))
    kept = valid_truth if sequence.truth.num_points is None else valid_truth & (sequence.truth.num_points != 0)
    if sequence.truth.ignore is not None:
        kept &= ~sequence.truth.ignore
    curves: dict[Place, CurveCounts] = {}
    wrong = 0
    for rule in rules:
        truth = sequence.truth[kept & np.isin(sequence.truth.label, rule.labels)]
        own = np.isin(sequence.estimates.label, rule.labels)
        estimates, invalid = sequence.estimates[own & valid], sequence.estimates[own & ~valid]
        wrong += len(invalid)
        problem = _compare(sequence, truth, estimates, rule.overlap, sensor_m)
        far = [_distances(side, sequence) for side in (truth, estimates, invalid)]
        for low, high in ((0.0, np.inf), *itertools.pairwise(RANGES_M)):
            parts, is_whole = [(low <= d) & (d < high) for d in far], (low, high) == (0.0, np.inf)
            name = "" if is_whole else f"{low:g}-{high:g} m" if high < np.inf else f"from {low:g} m"
            # Of what isn't valid, also what is nowhere.
            alarms = _count_held(invalid if is_whole else invalid[parts[2]])
            for level, counts in _count(problem, truth, estimates, *parts[:2]).items():
                curves[rule.name, name, level] = counts + CurveCounts(alarms=alarms)
    num_invalid = int((~valid_truth).sum())
    return WaymoStatistics(curves, len(sequence.steps), num_invalid, wrong)


def _count_held(invalid: Objects) -> tuple[int, ...]:
    """How many estimates that aren't valid each cutoff leaves; those without a finite score always stay."""
    score = np.where(np.isfinite(invalid.score), invalid.score, np.inf).astype(np.float32)
    return tuple((score[:, None] >= CUTOFFS).sum(axis=0).tolist())


def _distances(objects: Objects, sequence: Sequence) -> Float64:
    """Distance (N,) of centers from the body in space."""
    center = np.zeros((len(objects), 3)) if objects.center_m is None else objects.center_m
    ego = 0.0 if sequence.ego_m is None else sequence.ego_m[objects.step]
    return np.asarray(np.linalg.norm(center - ego, axis=1))


@dataclass(frozen=True, eq=False)
class _Problem:
    """All pairs of one class: which may match, what a match weighs, and what it is worth."""

    pairs: Blocks
    weight: Int64  # (B,) -1 where boxes can't match
    heading: Float64  # (B,) heading accuracy, 0 to 1
    affinity: Float64  # (B,) longitudinal affinity, 0 to 1; 1 without tolerance


def _compare(
    sequence: Sequence, truth: Objects, estimates: Objects, least: float, sensor_m: tuple[float, float, float] | None
) -> _Problem:
    pairs = blocks(truth, estimates, len(sequence.steps), "iou3d")
    overlap, affinity = pairs.values, np.ones(len(pairs.values))
    if sensor_m is not None:
        ego = np.zeros((len(sequence.steps), 3)) if sequence.ego_m is None else sequence.ego_m
        overlap, affinity = compare_tolerantly(truth, estimates, pairs, ego + np.array(sensor_m))
    # Waymo's matcher holds overlaps, thresholds and weights as 32-bit floats.
    short = overlap.astype(np.float32)
    can = (short >= np.float32(least)) & (affinity > 0)
    weight = np.round(np.where(can, short * affinity.astype(np.float32), 0) * _WEIGHT_STEPS).astype(np.int64)
    row, column = pairs.pairs
    apart = np.zeros(len(row))
    if truth.yaw_rad is not None and estimates.yaw_rad is not None:
        apart = np.abs((estimates.yaw_rad[column] - truth.yaw_rad[row] + np.pi) % (2 * np.pi) - np.pi)
    return _Problem(pairs, np.where(can, weight, -1), 1 - apart / np.pi, affinity)


def _count(
    problem: _Problem, truth: Objects, estimates: Objects, truth_part: Bool, estimate_part: Bool
) -> dict[int, CurveCounts]:
    """Counts of a range by level: all truth (2), and only that of level 1."""
    num = len(CUTOFFS)
    hits, alarms = np.zeros(num, np.int64), np.zeros(num, np.int64)
    misses, values = np.zeros((2, num), np.int64), [[Fraction(0)] * num for _ in range(2)]
    hard = np.zeros(len(truth), bool)
    if truth.num_points is not None:
        hard = (truth.num_points >= 0) & (truth.num_points <= HARD_POINTS)
    pairs = problem.pairs
    for step in range(len(pairs.start) - 1):
        rows = np.arange(pairs.row_start[step], pairs.row_start[step + 1])
        columns = np.arange(pairs.column_start[step], pairs.column_start[step + 1])
        own, said = np.flatnonzero(truth_part[rows]), np.flatnonzero(estimate_part[columns])
        block = slice(pairs.start[step], pairs.start[step + 1])
        weight, heading, affinity = (
            values_of[block].reshape(len(rows), len(columns))[np.ix_(own, said)]
            for values_of in (problem.weight, problem.heading, problem.affinity)
        )
        score = estimates.score[columns[said]].astype(np.float32)
        # Cutoffs that leave the same estimates give the same match.
        matched: dict[int, tuple[int, int, int, Fraction, Fraction]] = {}
        for k, cutoff in enumerate(CUTOFFS):
            held = np.flatnonzero(score >= cutoff)
            if len(held) not in matched:
                i, j = linear_sum_assignment(np.maximum(weight[:, held], 0), maximize=True)
                good = weight[i, held[j]] >= 0
                i, j = i[good], held[j[good]]
                free = np.ones(len(own), bool)
                free[i] = False
                easy = int((free & ~hard[rows[own]]).sum())
                turned, placed = (sum(map(Fraction, each[i, j].tolist()), Fraction(0)) for each in (heading, affinity))
                matched[len(held)] = len(i), easy, int(free.sum()), turned, placed
            found, missed_easy, missed, accuracy, affine = matched[len(held)]
            hits[k] += found
            alarms[k] += len(held) - found
            misses[:, k] += (missed_easy, missed)
            values[0][k] += accuracy
            values[1][k] += affine
    sums = tuple(values[0]), tuple(values[1])
    return {
        level: CurveCounts(tuple(hits.tolist()), tuple(alarms.tolist()), tuple(misses[level - 1].tolist()), *sums)
        for level in (1, 2)
    }
