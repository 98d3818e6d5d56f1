"""Similarity of truth and estimates: all pairs of each step, in one flat array."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fbench.metrics.core.tolerance import tolerant_overlaps
from fbench.replay.contracts.errors import LimitError, MetricError
from fbench.replay.contracts.profiles import SimilarityKind
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import MAX_BOXES
from fbench.replay.data.sequences import Objects, are_finite
from fbench.replay.geometry.iou import comparable, flat_iou

MAX_PAIRS = MAX_BOXES**2  # Of truth and estimates in one step: so many of each fit into memory several times
MAX_PAIRS_IN_ALL = 100 * MAX_PAIRS  # Of a sequence: each takes about 40 byte while it is scored


@dataclass(frozen=True, eq=False)
class Blocks:
    """One value for each pair of a row and a column of the same step: N rows, M columns, S steps.

    Those of step s are `values[start[s]:start[s + 1]]`, row-major.
    """

    row_start: Int64  # (S + 1,) step s has rows `row_start[s]:row_start[s + 1]`
    column_start: Int64  # (S + 1,)
    start: Int64  # (S + 1,)
    values: Float64  # (B,)

    @property
    def shape(self) -> tuple[int, int]:
        """N and M."""
        return int(self.row_start[-1]), int(self.column_start[-1])

    def block(self, step: int) -> Float64:
        """Values (n, m) of one step."""
        n, m = (int(start[step + 1] - start[step]) for start in (self.row_start, self.column_start))
        block: Float64 = self.values[self.start[step] : self.start[step + 1]].reshape(n, m)
        return block

    @cached_property
    def pairs(self) -> tuple[Int64, Int64]:
        """Row and column (B,) of each value; takes several times the memory of the values."""
        num_rows, num_columns = np.diff(self.row_start), np.diff(self.column_start)
        of_row = np.repeat(num_columns, num_rows)
        row = np.repeat(np.arange(self.row_start[-1]), of_row)
        left = np.repeat(np.repeat(self.column_start[:-1], num_rows), of_row)
        within = np.arange(len(row)) - np.repeat(np.cumsum(of_row) - of_row, of_row)
        return row.astype(np.int64), (left + within).astype(np.int64)

    def locate(self, place: Int64) -> tuple[Int64, Int64]:
        """Return row and column (K,) of the values at these places (K,)."""
        step = np.searchsorted(self.start, place, side="right") - 1
        row, column = np.divmod(place - self.start[step], np.diff(self.column_start)[step])
        return self.row_start[step] + row, self.column_start[step] + column

    def select(self, rows: Bool, columns: Bool) -> "Blocks":
        """Return the pairs of the marked rows (N,) and columns (M,), numbered from 0 on."""
        if rows.all() and columns.all():
            return self
        from fbench.metrics.core.similarity_kernel import select_pairs  # numba takes a while to import

        row_start, column_start = (
            np.concatenate([[0], np.cumsum(mask)])[start]
            for mask, start in ((rows, self.row_start), (columns, self.column_start))
        )
        start = block_starts(row_start, column_start)
        values = select_pairs(self.values, self.row_start, self.column_start, _mask(rows), _mask(columns), start)
        return Blocks(row_start, column_start, start, values)

    def only(self, rows: Bool, columns: Bool) -> "Blocks":
        """Return the pairs with -inf in place of those of which neither row (N,) nor column (M,) is marked."""
        if rows.all() or columns.all():
            return self
        from fbench.metrics.core.similarity_kernel import keep_pairs

        values = keep_pairs(self.values, self.row_start, self.column_start, _mask(rows), _mask(columns))
        return replace(self, values=values)


def _mask(marked: Bool) -> Bool:
    return np.require(marked, np.bool_, ["C", "W"])  # as kernels are compiled for writeable arrays


def block_starts(row_start: Int64, column_start: Int64) -> Int64:
    """Offsets (S + 1,) of the blocks in a flat array."""
    return np.concatenate([[0], np.cumsum(np.diff(row_start) * np.diff(column_start))]).astype(np.int64)


def blocks(
    truth: Objects, estimates: Objects, num_steps: int, similarity: SimilarityKind, ego_m: Array | None = None
) -> Blocks:
    """Return the similarity of all pairs of N truth boxes (rows) and M estimates (columns) of each step.

    A pair's value depends on the two boxes only, not on what else is in the step. Higher is nearer:

    - `iou2d`: rectangles in continuous coordinates, without a pixel added (as TrackEval and KITTI do).
    - `ioubev`, `iou3d`: upright boxes turned by yaw.
    - `bev`, `center3d`: negated distance of the centers [m].
    - `plane`: negated root mean square [m] of the distances in the ground plane of two corners: the two of truth that
      are nearest to the ego and the same two of the estimate, which is turned round where headings are more than
      90 deg apart (autoware_perception_evaluation, `PlaneDistanceMatching`; without its rounding to 10 digits).
      Where two corners are equally second, the front or rear counts, not a side.
    - `let`: `iou3d` of the estimate moved along the ego's line of sight; 0 where its distance is off by more than 10 %
      of the true one, and by more than 0.5 m. See `fbench.metrics.core.tolerance`.

    Boxes that aren't finite or have a negative size get -inf and so match nothing (for center distances only the
    center is looked at); boxes without area or volume have an intersection over union of 0. `ego_m` (S, 2 or 3) is
    where the body is at each step, for `plane`; `None`: at the origin. Raises MetricError where boxes have no
    rectangle, or no solid, as the similarity needs.
    """
    if similarity == "iou2d":
        return image_overlaps(truth, estimates, num_steps, np.zeros(len(truth), bool))
    starts = _starts(truth, estimates, num_steps)
    if similarity in ("ioubev", "iou3d"):
        return Blocks(*starts, flat_iou(_solids(truth), _solids(estimates), *starts[:2], similarity == "iou3d"))
    if similarity == "let":
        overlap, affinity = compare_tolerantly(truth, estimates, Blocks(*starts, np.zeros(0)), ego_m)
        return Blocks(*starts, np.where(affinity > 0, overlap, np.minimum(overlap, 0.0)))
    from fbench.metrics.core.similarity_kernel import distance_blocks, plane_blocks  # numba takes a while to import

    if similarity == "plane":
        a, b = _solids(truth), _solids(estimates)
        ego = np.zeros((num_steps, 2)) if ego_m is None else np.ascontiguousarray(ego_m[:, :2], np.float64)
        return Blocks(*starts, plane_blocks(a, b, comparable(a), comparable(b), *starts, ego))
    a, b = (_centers(objects, 2 if similarity == "bev" else 3) for objects in (truth, estimates))
    return Blocks(*starts, distance_blocks(a, b, are_finite(a), are_finite(b), *starts))


def compare_tolerantly(
    truth: Objects, estimates: Objects, pairs: Blocks, sensor_m: Array | None
) -> tuple[Float64, Float64]:
    """Return overlap and longitudinal affinity (B,) of pairs of rows, seen from `sensor_m` (S, 3) at each step; `None`:
    from the origin. -inf and 0 where a box isn't finite or has a negative size.
    """
    (row, column), a, b = pairs.pairs, _solids(truth), _solids(estimates)
    sensor = np.zeros((len(row), 3)) if sensor_m is None else np.asarray(sensor_m, np.float64)[truth.step[row]]
    overlap, affinity = tolerant_overlaps(a[row], b[column], sensor)
    sound = comparable(a)[row] & comparable(b)[column]
    return np.where(sound, overlap, -np.inf), np.where(sound, affinity, 0.0)


def image_overlaps(truth: Objects, estimates: Objects, num_steps: int, region: Bool) -> Blocks:
    """Return the `iou2d` of `blocks`, for truth where `region` (N,) the share of the estimate that lies in it.

    Regions hold any number of objects (KITTI's DontCare, COCO's crowds). 0 where the estimate has no area; -inf where
    one of the two isn't finite or has a negative size.
    """
    from fbench.replay.geometry.overlap_kernels import rectangle_blocks  # numba takes a while to import

    starts = _starts(truth, estimates, num_steps)
    a, b = _rectangles(truth), _rectangles(estimates)
    sound_a, sound_b = (are_finite(xyxy) & np.all(xyxy[:, 2:] >= xyxy[:, :2], axis=1) for xyxy in (a, b))
    return Blocks(*starts, rectangle_blocks(a, b, sound_a, sound_b, *starts[:2], region))


def _starts(truth: Objects, estimates: Objects, num_steps: int) -> tuple[Int64, Int64, Int64]:
    starts = truth.starts(num_steps), estimates.starts(num_steps)
    rows, columns = np.diff(starts[0]), np.diff(starts[1])
    advice = "leave out results with low scores"
    if (over := np.flatnonzero(rows * columns > MAX_PAIRS)).size:
        sides = f"{rows[over[0]]} truth boxes and {columns[over[0]]} results"
        limit = f"more than {MAX_PAIRS} pairs; {advice}"
        raise LimitError(f"frame number {over[0]} of the sequence: {sides} to compare, {limit}", "LIM005")
    of_blocks = block_starts(*starts)
    if of_blocks[-1] > MAX_PAIRS_IN_ALL:
        num = f"{of_blocks[-1]} pairs of truth boxes and results to compare"
        raise LimitError(
            f"the {num_steps} frames of the sequence: {num}, more than {MAX_PAIRS_IN_ALL}; {advice}, or split the log",
            "LIM005",
        )
    return *starts, of_blocks


def _rectangles(objects: Objects) -> Float64:
    if objects.xyxy_px is None:
        if len(objects):
            raise MetricError("iou2d: boxes have no rectangles in images; match them in 3D")
        return np.zeros((0, 4))
    return np.array(objects.xyxy_px)  # a copy, which is writeable


def _centers(objects: Objects, num_axes: int) -> Float64:
    if objects.center_m is None:
        if len(objects):
            raise MetricError("boxes have no place in space; match them in images (iou2d)")
        return np.zeros((0, num_axes))
    return np.array(objects.center_m[:, :num_axes], order="C")


def _solids(objects: Objects) -> Float64:
    centers = _centers(objects, 3)
    if objects.size_lwh_m is None or objects.yaw_rad is None:
        if len(objects):
            raise MetricError("boxes have no size or heading in space; match them by their centers (bev, center3d)")
        return np.zeros((0, 7))
    return np.column_stack([centers, objects.size_lwh_m, objects.yaw_rad])
