"""The boxes that count, of truth and results alike, and how many are left out and why."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np

from fbench.metrics.nuscenes.checks import check_sequence
from fbench.metrics.nuscenes.content import content_order
from fbench.metrics.nuscenes.rules import BoxRules
from fbench.metrics.nuscenes.solids import solids
from fbench.metrics.objects import Objects
from fbench.metrics.sequence import Sequence
from fbench.replay.arrays import Array, Bool, Float64, Int64
from fbench.replay.boxes import MAX_MAGNITUDE


@dataclass(frozen=True)
class LeftOut:
    """Boxes that neither side is judged on, except `invalid`, which are false positives; for reports."""

    unknown_class: int = 0
    """Results of a class that the benchmark doesn't have."""
    unknown_class_truth: int = 0
    out_of_range: int = 0
    out_of_range_truth: int = 0
    no_points: int = 0
    """Results said to have no point in them."""
    no_points_truth: int = 0
    in_rack: int = 0
    in_rack_truth: int = 0
    ignored: int = 0
    """Results outside the region of interest, where there is one."""
    ignored_truth: int = 0
    """Truth boxes outside of it, or marked as to be ignored."""
    invalid: int = 0
    """Results with a score or box that isn't finite, or without extent (PRD001): counted as false positives."""
    invalid_truth: int = 0
    """Truth boxes that aren't finite or have no extent (GT004)."""

    def __add__(self, other: "LeftOut") -> "LeftOut":
        mine, theirs = asdict(self), asdict(other)
        return LeftOut(**{name: mine[name] + theirs[name] for name in mine})


@dataclass(frozen=True, eq=False)
class Side:
    """N boxes that count, in the order of `content_order`."""

    boxes: Objects
    kind: Int64
    """(N,) index of the class in the rules."""
    invalid: Bool
    """(N,) never match; truth has none."""


@dataclass(frozen=True, eq=False)
class Counted:
    """Both sides of one sequence."""

    truth: Side
    estimates: Side
    left_out: LeftOut


def counted(sequence: Sequence, rules: BoxRules) -> Counted:
    """Return the boxes of a sequence that count.

    Raises:
        MetricError: where it can't be scored.
    """
    check_sequence(sequence, rules.max_boxes)
    racks = sequence.truth[sequence.truth.label == rules.rack_label]
    racks = racks[~_invalid(racks)]
    truth, lost = _side(sequence, sequence.truth[sequence.truth.label != rules.rack_label], rules, racks)
    estimates, missed = _side(sequence, sequence.estimates, rules, racks)
    sound = ~truth.invalid
    left_out = LeftOut(
        **missed, **{f"{name}_truth": n for name, n in lost.items()},
        invalid=int(estimates.invalid.sum()), invalid_truth=int((~sound).sum()) + sequence.num_invalid_truth,
    )  # fmt: skip
    return Counted(Side(truth.boxes[sound], truth.kind[sound], truth.invalid[sound]), estimates, left_out)


def _side(sequence: Sequence, boxes: Objects, rules: BoxRules, racks: Objects) -> tuple[Side, dict[str, int]]:
    kind = _kinds(boxes, rules.classes)
    counts = {"unknown_class": int((kind < 0).sum())}
    order = content_order(boxes)
    order = order[kind[order] >= 0]
    boxes, kind = boxes[order], kind[order]
    invalid = _invalid(boxes)
    kept = np.ones(len(boxes), bool)
    for reason, rows in _filters(sequence, boxes, kind, invalid, rules, racks):
        out = rows & kept & ~invalid
        counts[reason] = int(out.sum())
        kept &= ~out
    return Side(boxes[kept], kind[kept], invalid[kept]), counts


def _filters(
    sequence: Sequence, boxes: Objects, kind: Int64, invalid: Bool, rules: BoxRules, racks: Objects
) -> Iterator[tuple[str, Bool]]:
    """Reasons and which boxes (N,) they apply to, in the devkit's order."""
    yield "ignored", _ignored(boxes)
    limit_m = np.array([limit for _, limit in rules.class_range_m])[kind]
    yield "out_of_range", _distance_m(sequence, boxes, invalid) >= limit_m
    yield "no_points", np.zeros(len(boxes), bool) if boxes.num_points is None else boxes.num_points == 0
    racked = np.isin(kind, [rules.classes.index(name) for name in rules.rack_classes])
    racked[racked] = _inside(boxes[racked], racks)
    yield "in_rack", racked


def _kinds(boxes: Objects, classes: tuple[str, ...]) -> Int64:
    kind = np.full(len(boxes), -1, np.int64)
    for i, name in enumerate(classes):
        kind[boxes.label == name] = i
    return kind


def _ignored(boxes: Objects) -> Bool:
    ignored = np.zeros(len(boxes), bool) if boxes.ignore is None else boxes.ignore
    return ignored if boxes.inside is None else ignored | ~boxes.inside


def _invalid(boxes: Objects) -> Bool:
    center, size, yaw = solids(boxes)
    numbers = np.concatenate([center, size, yaw[:, None], boxes.score[:, None]], axis=1)
    bad: Bool = ~(np.abs(numbers) < MAX_MAGNITUDE).all(axis=1) | (size <= 0).any(axis=1)
    if boxes.velocity_mps is not None:  # NaN is an unknown velocity
        bad |= (np.abs(boxes.velocity_mps) >= MAX_MAGNITUDE).any(axis=1)
    return bad


def _distance_m(sequence: Sequence, boxes: Objects, invalid: Bool) -> Float64:
    """Distances (N,) from the ego in the ground plane; 0 for what has none."""
    xy = np.where(invalid[:, None], 0.0, solids(boxes).center_m[:, :2])
    if sequence.ego_m is not None:
        xy = xy - sequence.ego_m[boxes.step, :2]
    distance_m: Float64 = np.sqrt(xy[:, 0] ** 2 + xy[:, 1] ** 2)
    return distance_m


def _inside(boxes: Objects, racks: Objects) -> Bool:
    """Which centres (N,) are inside a rack of their step, border included."""
    inside = np.zeros(len(boxes), bool)
    centers = solids(boxes).center_m
    for step, center, size, yaw in zip(racks.step, *solids(racks), strict=True):
        rows = slice(*np.searchsorted(boxes.step, (step, step + 1)))
        inside[rows] |= _in_solid(centers[rows] - center, size, float(yaw))
    return inside


def _in_solid(offset: Array, size_lwh: Array, yaw: float) -> Bool:
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]
    local = np.abs(np.stack([x, y, offset[:, 2]], axis=1))
    inside: Bool = (local <= size_lwh / 2).all(axis=1)
    return inside
