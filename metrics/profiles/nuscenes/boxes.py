"""Boxes that the nuScenes benchmarks count, and checks that stop an evaluation."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbench.metrics.core.exact import Counts
from fbench.metrics.core.ordering import find_twice
from fbench.metrics.profiles.nuscenes.settings import BoxRules
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import MAX_MAGNITUDE
from fbench.replay.data.sequences import Objects, Sequence


def check_sequence(sequence: Sequence, max_boxes: int) -> None:
    """Check what both benchmarks take for granted. Raises MetricError where boxes have no solid, an id is twice in a
    sample, a sample has too many results, or nobody tells where the ego is, about which ranges are, in a sample with
    boxes, while it is known in others.
    """
    for side, boxes in (("truth", sequence.truth), ("results", sequence.estimates)):
        if len(boxes) and (boxes.center_m is None or boxes.size_lwh_m is None or boxes.yaw_rad is None):
            raise MetricError(f"{sequence.name}: {side} without boxes in space, the nuScenes benchmarks need them")
        step, number = boxes.step[boxes.track_id >= 0], boxes.track_id[boxes.track_id >= 0]
        if (row := find_twice(step, number)) is not None:
            raise MetricError(f"{_place(sequence, int(step[row]))}: {side} has id {number[row]} twice", "GT003")
        ego_m = np.zeros((len(sequence.steps), 2)) if sequence.ego_m is None else sequence.ego_m
        unknown = np.isnan(ego_m[boxes.step, :2]).any(axis=1)
        if unknown.any():
            raise MetricError(
                f"{_place(sequence, int(boxes.step[np.argmax(unknown)]))}: nobody tells where the ego is, so not how "
                f"far off {side} are; give each sample of the truth its ego_x, ego_y, ego_z in samples.csv"
            )
    most = np.bincount(sequence.estimates.step, minlength=1)
    if most.max(initial=0) > max_boxes:
        where = _place(sequence, int(most.argmax()))
        raise MetricError(f"{where}: {most.max()} results, nuScenes allows {max_boxes} a sample")


def check_tracked(sequence: Sequence, side: str, boxes: Objects) -> None:
    """Check that each box belongs to a track. Raises MetricError where one doesn't."""
    if (boxes.track_id < 0).any():
        where = _place(sequence, int(boxes.step[np.argmax(boxes.track_id < 0)]))
        raise MetricError(f"{where}: {side} without track id, nuscenes-tracking needs one for each box")


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
    x, step = center[order, 0], boxes.step[order]
    if not (~(x[1:] > x[:-1]) & (step[1:] == step[:-1])).any():  # NaN counts as equal
        return order
    keys: list[Array] = [boxes.step, *center.T, yaw, *size.T, boxes.score]
    keys += [] if boxes.velocity_mps is None else [*boxes.velocity_mps.T]
    keys += [boxes.label] + ([] if boxes.attribute is None else [boxes.attribute])
    return np.lexsort(keys[::-1])


@dataclass(frozen=True)
class LeftOut(Counts):
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


@dataclass(frozen=True, eq=False)
class Side:
    """N boxes that count, in the order of `content_order`."""

    boxes: Objects
    kind: Int64  # (N,) index of the class in the rules
    invalid: Bool  # (N,) never match; truth has none


def select_counted(sequence: Sequence, rules: BoxRules) -> tuple[Side, Side, LeftOut]:
    """Return truth and results of a sequence that count. Raises MetricError where it can't be scored."""
    check_sequence(sequence, rules.max_boxes)
    racks = sequence.truth[sequence.truth.label == rules.rack_label]
    racks = racks[~find_invalid(racks)]
    truth, lost = _side(sequence, sequence.truth[sequence.truth.label != rules.rack_label], rules, racks)
    estimates, missed = _side(sequence, sequence.estimates, rules, racks)
    sound = ~truth.invalid
    left_out = LeftOut(
        **missed, **{f"{name}_truth": n for name, n in lost.items()},
        invalid=int(estimates.invalid.sum()), invalid_truth=int((~sound).sum()) + sequence.num_invalid_truth,
    )  # fmt: skip
    return Side(truth.boxes[sound], truth.kind[sound], truth.invalid[sound]), estimates, left_out


def _side(sequence: Sequence, boxes: Objects, rules: BoxRules, racks: Objects) -> tuple[Side, dict[str, int]]:
    """Boxes that count, and how many were left out for which reason, in the devkit's order."""
    kind = np.full(len(boxes), -1, np.int64)
    for i, name in enumerate(rules.classes):
        kind[boxes.label == name] = i
    counts = {"unknown_class": int((kind < 0).sum())}
    order = content_order(boxes)
    order = order[kind[order] >= 0]
    boxes, kind = boxes[order], kind[order]
    nobody, invalid = np.zeros(len(boxes), bool), find_invalid(boxes)
    ignored = nobody if boxes.ignore is None else boxes.ignore
    xy = np.where(invalid[:, None], 0.0, solids(boxes).center_m[:, :2])
    if sequence.ego_m is not None:  # the range is that from the ego in the ground plane
        xy = xy - sequence.ego_m[boxes.step, :2]
    racked = np.isin(kind, [rules.classes.index(name) for name in rules.rack_classes])
    racked[racked] = _inside(boxes[racked], racks)
    filters = {
        "ignored": ignored if boxes.inside is None else ignored | ~boxes.inside,
        "out_of_range": distances_m(xy) >= np.array([limit for _, limit in rules.class_range_m])[kind],
        "no_points": nobody if boxes.num_points is None else boxes.num_points == 0,
        "in_rack": racked,
    }
    kept = ~nobody
    for reason, rows in filters.items():
        out = rows & kept & ~invalid
        counts[reason] = int(out.sum())
        kept &= ~out
    return Side(boxes[kept], kind[kept], invalid[kept]), counts


def find_invalid(boxes: Objects) -> Bool:
    """Tell which boxes (N,) aren't finite, in score or velocity, or have no extent; an unknown velocity is fine."""
    center, size, yaw = solids(boxes)
    numbers = np.concatenate([center, size, yaw[:, None], boxes.score[:, None]], axis=1)
    bad: Bool = ~(np.abs(numbers) < MAX_MAGNITUDE).all(axis=1) | (size <= 0).any(axis=1)
    if boxes.velocity_mps is not None:  # NaN is an unknown velocity
        bad |= (np.abs(boxes.velocity_mps) >= MAX_MAGNITUDE).any(axis=1)
    return bad


def distances_m(xy: Float64) -> Float64:
    """Return the lengths (N,) of vectors (N, 2)."""
    return np.asarray(np.sqrt(xy[:, 0] ** 2 + xy[:, 1] ** 2))


def _inside(boxes: Objects, racks: Objects) -> Bool:
    """Which centers (N,) are inside a rack of their step, border included."""
    inside, centers = np.zeros(len(boxes), bool), solids(boxes).center_m
    for step, center, size, yaw in zip(racks.step, *solids(racks), strict=True):
        rows = slice(*np.searchsorted(boxes.step, (step, step + 1)))
        offset, cos, sin = centers[rows] - center, np.cos(yaw), np.sin(yaw)
        x, y = cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]
        inside[rows] |= (np.abs(np.stack([x, y, offset[:, 2]], axis=1)) <= size / 2).all(axis=1)
    return inside


def sort_groups(side: Side, num_classes: int, num_steps: int, by_score: bool = False) -> tuple[Int64, Int64]:
    """Return rows (N,) in the order of samples, then classes, and offsets (num_steps * num_classes + 1,) of groups.

    Within a group they keep the order of their content, or go by score, the best first, before that.
    """
    group, score = side.boxes.step * num_classes + side.kind, side.boxes.score
    keys = (np.where(np.isnan(score), -np.inf, -score), group) if by_score else (group,)
    order = np.lexsort(keys).astype(np.int64)
    return order, np.searchsorted(group[order], np.arange(num_steps * num_classes + 1)).astype(np.int64)


def centers_xy(side: Side) -> Float64:
    """Return centers (N, 2) in the ground plane [m]."""
    return np.ascontiguousarray(solids(side.boxes).center_m[:, :2])


class NearBoxes(NamedTuple):
    """Boxes of one class of one sequence: S steps, N truth boxes, M results, P pairs of them that are near each other.

    int32 and float64 only, so that many can be held.
    """

    truth_start: Array  # (S + 1,) offsets of steps
    truth_track: Array  # (N,)
    estimate_start: Array  # (S + 1,)
    estimate_track: Array  # (M,)
    score: Float64  # (M,) mean of the track; infinite for a result that isn't valid and has no finite score
    pair_start: Array  # (N + 1,) offsets of the pairs of each truth box
    pair_estimate: Array  # (P,) rows
    pair_m: Float64  # (P,) distances
