"""Scores of a run's detections."""

from collections.abc import Sequence as Sequence_of_abc

import numpy as np

from fbench.metrics.core.sequence import Objects, Sequence
from fbench.metrics.core.slices import (
    VEHICLE,
    VISIBILITY_SLICES,
    Entry,
    Group,
    Heading,
    Part,
    by_range,
    by_seen,
    by_source,
    by_visibility,
)
from fbench.metrics.detection.outcomes import compare_class, judge_detections
from fbench.metrics.detection.scores import (
    DetectionCounts,
    curve_rows,
    detection_counts,
    detection_rows,
    deviation_rows,
)
from fbench.metrics.profiles.profile import Match
from fbench.metrics.runs.columns import View
from fbench.metrics.runs.places import ground_points, has_poses, regions_of
from fbench.metrics.runs.spaces import label_groups, views
from fbench.replay.data.arrays import Float64
from fbench.replay.data.metadata import inside
from fbench.replay.data.scores import Score, ScoreOptions, ratio
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import BoxTable


def region_parts(run: Run, sequence: Sequence) -> list[Part]:
    """Return the part of a sequence in the ground plane that lies in each kind of the log's regions; none where the
    log has no regions or no poses.
    """
    if sequence.truth.center_m is None or sequence.estimates.center_m is None:
        return []
    regions = regions_of(run)
    kinds = dict.fromkeys(region.kind for region in regions)
    if not kinds or not has_poses(run):
        return []
    sides = [_points(run, sequence, objects) for objects in (sequence.truth, sequence.estimates)]
    return [
        Part(f"region {kind}", *(inside([r for r in regions if r.kind == kind], points) for points in sides))
        for kind in kinds
    ]


def _points(run: Run, sequence: Sequence, objects: Objects) -> Float64:
    center_m = np.zeros((0, 3)) if objects.center_m is None else objects.center_m
    return ground_points(run, sequence.steps.frame[objects.step], center_m)


class Detection:
    """F1, precision and recall of `run.detections` at the score threshold that the pipeline has.

    P = TP/(TP + FP), R = TP/(TP + FN), F1 = 2PR/(P + R) = TP/(TP + FN/2 + FP/2), each 0 to 1. Estimates are matched
    greedily by score to the nearest truth (see `match_greedy`); 3D within a distance in the ground plane, in images
    from an IoU on. Frames without truth aren't scored; empty frames are, and what is detected there is a false alarm.
    Null where the denominator is 0. Counts are summed over frames before dividing.
    """

    def scores(self, run: Run, options: ScoreOptions) -> Sequence_of_abc[Score]:
        """Return rows for all vehicles as one class in each space, for each label, for slices, then `coverage`."""
        entries = detection_entries(run, options)
        native = entries[0].heading
        rows = [row for entry in entries for row in rows_of(entry)]
        return [*rows, coverage(native.matching, native.num_frames, len(run.frames))]


def detection_entries(
    run: Run, options: ScoreOptions, match: Match | None = None
) -> tuple[Entry[DetectionCounts], ...]:
    """Measure the detections of a run: all vehicles in each space, then labels and slices in its own space, or in that
    of `match`, see `views`.
    """
    spaces = views(run, run.detections, options, match)
    slices = () if spaces[0].reason else _slices(run, spaces[0], options)
    return (*whole_entries(spaces, run.detections), *slices)


def whole_entries(spaces: Sequence_of_abc[View], table: BoxTable) -> tuple[Entry[DetectionCounts], ...]:
    """Measure all vehicles in each space, then labels in the first."""
    entries = [_entry(view, VEHICLE) for view in spaces]
    return (*entries, *(_entry(spaces[0], group) for group in label_groups(spaces[0], table)))


def rows_of(entry: Entry[DetectionCounts]) -> list[Score]:
    """Return the rows of one entry; what depends on scores and distances only of the whole."""
    rows = detection_rows(entry.counts, entry.heading)
    if entry.heading.slice != "all":
        # A false alarm has no visibility, so neither precision nor F1 means anything there.
        return [row for row in rows if row.metric == "recall" or row.slice not in VISIBILITY_SLICES]
    rows += curve_rows(entry.counts, entry.heading)
    if entry.heading.matching.startswith("iou "):
        rows += deviation_rows(entry.counts, entry.heading)
    return rows


def coverage(matching: str, num_scored: int, num_frames: int) -> Score:
    """Return the share of frames that have truth and so were scored."""
    counts = {"scored": num_scored, "frames": num_frames}
    return ratio("coverage", "all", matching, num_scored, num_frames, "no frames", counts)


def _entry(view: View, group: Group) -> Entry[DetectionCounts]:
    counts = DetectionCounts() if view.reason else detection_counts(view.sequence, group, view.match)
    return Entry(Heading(group.name, "all", view.matching, view.reason, view.num_scored), counts)


def _slices(run: Run, view: View, options: ScoreOptions) -> list[Entry[DetectionCounts]]:
    sequence = view.sequence
    parts = [] if options.seen else [*by_seen(sequence)]
    parts += [*by_range(sequence, options.range_m), *by_visibility(sequence), *by_source(sequence)]
    parts += region_parts(run, sequence)
    whole = compare_class(sequence, VEHICLE, view.match)
    return [
        Entry(
            Heading(VEHICLE.name, part.name, view.matching, None, view.num_scored),
            DetectionCounts(judge_detections(whole.select(part)).counts),
        )
        for part in parts
    ]
