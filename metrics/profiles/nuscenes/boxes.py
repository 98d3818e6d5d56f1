"""Boxes that the nuScenes benchmarks count, and checks that stop an evaluation."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from fbench.metrics.profiles.nuscenes.settings import BoxRules
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import MAX_MAGNITUDE
from fbench.replay.data.sequences import Objects, Sequence


def check_sequence(sequence: Sequence, max_boxes: int) -> None:
    """Check what both benchmarks take for granted. Raises MetricError where boxes have no solid, an id is twice in a
    sample, a sample has too many results, or nobody tells where the ego is in a sample with boxes, while it is known in
    others.
    """
    for side, boxes in (("truth", sequence.truth), ("results", sequence.estimates)):
        _check_solids(sequence, side, boxes)
        _check_ids(sequence, side, boxes)
        _check_ego(sequence, side, boxes)
    most = np.bincount(sequence.estimates.step, minlength=1)
    if most.max(initial=0) > max_boxes:
        where = _place(sequence, int(most.argmax()))
        raise MetricError(f"{where}: {most.max()} results, nuScenes allows {max_boxes} a sample")


def check_tracked(sequence: Sequence, side: str, boxes: Objects) -> None:
    """Check that each box belongs to a track. Raises MetricError where one doesn't."""
    if (boxes.track_id < 0).any():
        step = int(boxes.step[np.argmax(boxes.track_id < 0)])
        raise MetricError(
            f"{_place(sequence, step)}: {side} without track id, nuscenes-tracking needs one for each box"
        )


def _check_solids(sequence: Sequence, side: str, boxes: Objects) -> None:
    if len(boxes) and (boxes.center_m is None or boxes.size_lwh_m is None or boxes.yaw_rad is None):
        raise MetricError(f"{sequence.name}: {side} without boxes in space, the nuScenes benchmarks need them")


def _check_ids(sequence: Sequence, side: str, boxes: Objects) -> None:
    order = np.lexsort((boxes.track_id, boxes.step))
    step, number = boxes.step[order], boxes.track_id[order]
    twice = np.flatnonzero((step[1:] == step[:-1]) & (number[1:] == number[:-1]) & (number[1:] >= 0))
    if len(twice):
        where = _place(sequence, int(step[twice[0]]))
        raise MetricError(f"{where}: {side} has id {number[twice[0]]} twice", "GT003")


def _check_ego(sequence: Sequence, side: str, boxes: Objects) -> None:
    """Ranges are about the ego."""
    if sequence.ego_m is None:
        return
    unknown = np.isnan(sequence.ego_m[boxes.step, :2]).any(axis=1)
    if unknown.any():
        where = _place(sequence, int(boxes.step[np.argmax(unknown)]))
        raise MetricError(
            f"{where}: nobody tells where the ego is, so not how far off {side} are; give each sample of the truth its "
            "ego_x, ego_y, ego_z in samples.csv"
        )


def _place(sequence: Sequence, step: int) -> str:
    return f"{sequence.name}, sample {sequence.steps.frame[step]}"


class Solids(NamedTuple):
    """N boxes."""

    center_m: Float64  # (N, 3)
    size_lwh_m: Float64  # (N, 3)
    yaw_rad: Float64  # (N,)


def solids(boxes: Objects) -> Solids:
    """Return what `check_sequence` has found to be there; no boxes, no solids."""
    center, size, yaw = boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad
    if center is None or size is None or yaw is None:
        return Solids(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    return Solids(center, size, yaw)


def content_order(boxes: Objects) -> Int64:
    """Return the order (N,) by step, then center x, y, z, yaw, size, score, velocity, label, attribute; never by id.

    nuscenes-devkit goes by the order in the file where this one decides: between equal scores, between truth boxes
    at equal distances, and between tracks that both want to go on with the same partner.
    """
    center, size, yaw = solids(boxes)
    order = np.lexsort((center[:, 0], boxes.step))
    if not _any_equal(center[order, 0], boxes.step[order]):
        return order
    keys: list[Array] = [boxes.step, *center.T, yaw, *size.T, boxes.score]
    if boxes.velocity_mps is not None:
        keys += [*boxes.velocity_mps.T]
    keys += [boxes.label] + ([] if boxes.attribute is None else [boxes.attribute])
    return np.lexsort(keys[::-1])


def _any_equal(x: Array, step: Array) -> bool:
    unordered: Bool = ~(x[1:] > x[:-1]) & (step[1:] == step[:-1])  # NaN counts as equal
    return bool(unordered.any())


@dataclass(frozen=True)
class LeftOut:
    """Boxes that neither side is judged on, except `invalid`, which are false positives; for reports."""

    unknown_class: int = 0  # Results of a class that the benchmark doesn't have
    unknown_class_truth: int = 0
    out_of_range: int = 0
    out_of_range_truth: int = 0
    no_points: int = 0  # Results said to have no point in them
    no_points_truth: int = 0
    in_rack: int = 0
    in_rack_truth: int = 0
    ignored: int = 0  # Results outside the region of interest, where there is one
    ignored_truth: int = 0  # Truth boxes outside of it, or marked as to be ignored
    invalid: int = 0
    """Results with a score or box that isn't finite, or without extent (PRD001): counted as false positives."""
    invalid_truth: int = 0  # Truth boxes that aren't finite or have no extent (GT004)

    def __add__(self, other: "LeftOut") -> "LeftOut":
        mine, theirs = asdict(self), asdict(other)
        return LeftOut(**{name: mine[name] + theirs[name] for name in mine})


@dataclass(frozen=True, eq=False)
class Side:
    """N boxes that count, in the order of `content_order`."""

    boxes: Objects
    kind: Int64  # (N,) index of the class in the rules
    invalid: Bool  # (N,) never match; truth has none


@dataclass(frozen=True, eq=False)
class Counted:
    """Both sides of one sequence."""

    truth: Side
    estimates: Side
    left_out: LeftOut


def select_counted(sequence: Sequence, rules: BoxRules) -> Counted:
    """Return the boxes of a sequence that count. Raises MetricError where it can't be scored."""
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
    """Which centers (N,) are inside a rack of their step, border included."""
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


def sort_groups(side: Side, num_classes: int, num_steps: int, by_score: bool = False) -> tuple[Int64, Int64]:
    """Return rows (N,) in the order of samples, then classes, and offsets (num_steps * num_classes + 1,) of groups.

    Within a group they keep the order of their content, or go by score, the best first, before that.
    """
    group = side.boxes.step * num_classes + side.kind
    keys = (_descending(side.boxes.score), group) if by_score else (group,)
    order = np.lexsort(keys).astype(np.int64)
    start = np.searchsorted(group[order], np.arange(num_steps * num_classes + 1)).astype(np.int64)
    return order, start


def centers_xy(side: Side) -> Float64:
    """Return centers (N, 2) in the ground plane [m]."""
    return np.ascontiguousarray(solids(side.boxes).center_m[:, :2])


def _descending(score: Float64) -> Float64:
    return np.where(np.isnan(score), -np.inf, -score)
