"""Scores of a run's detections."""

from collections.abc import Iterator
from collections.abc import Sequence as AbstractSequence
from dataclasses import replace

from fbench.metrics.core import slices
from fbench.metrics.core.slices import VEHICLE, VISIBILITY_SLICES, Part, ScoreCounts
from fbench.metrics.detection import scores
from fbench.metrics.detection.horizon import horizon_rows
from fbench.metrics.detection.outcomes import compare_class, judge_detections
from fbench.metrics.detection.scores import DetectionCounts
from fbench.metrics.runs.places import ground_points, has_poses, once, regions_of
from fbench.metrics.runs.spaces import measure_classes, views
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.metadata import inside
from fbench.replay.data.scores import Score, ScoreOptions, ratio
from fbench.replay.data.sequences import Sequence
from fbench.replay.runs.folder import Run

CONDITION = "condition "  # Begin of slices of several runs that are about the runs under one condition


class Detection:
    """F1, precision and recall of `run.detections` at the score threshold that the pipeline has.

    P = TP/(TP + FP), R = TP/(TP + FN), F1 = 2PR/(P + R) = TP/(TP + FN/2 + FP/2), each 0 to 1. Estimates are matched
    greedily by score to the nearest truth (see `match_greedy`); 3D within a distance in the ground plane, in images
    from an IoU on. Frames without truth aren't scored; empty frames are, and what is detected there is a false alarm.
    Null where the denominator is 0. Counts are summed over frames before dividing.
    """

    def scores(self, run: Run, options: ScoreOptions) -> AbstractSequence[Score]:
        """Return rows for all vehicles as one class in each space, for each label, for slices, then `coverage`."""
        entries = detection_entries(run, options)
        native = entries[0].key
        rows = [row for entry in entries for row in rows_of(entry)]
        return [*rows, coverage(native.matching, native.num_frames, len(run.frames))]


def detection_entries(
    run: Run, options: ScoreOptions, match: Match | None = None
) -> tuple[ScoreCounts[DetectionCounts], ...]:
    """Measure all vehicles in each space, then labels and slices in the run's own, or by `match`, see `views`."""
    return once(run, ("detection entries", options, match), lambda: _measure(run, options, match))


def _measure(run: Run, options: ScoreOptions, match: Match | None) -> tuple[ScoreCounts[DetectionCounts], ...]:
    spaces = views(run, run.detections, options, match)
    entries, native = measure_classes(spaces, run.detections, scores.detection_counts, DetectionCounts()), spaces[0]
    if native.key.reason:
        return entries
    sequence = native.sequence
    whole = compare_class(sequence, VEHICLE, native.match)
    own = (
        ScoreCounts(replace(native.key, slice=part.name), DetectionCounts(judge_detections(whole.select(part)).counts))
        for part in parts_of(run, sequence, options)
    )
    return *entries, *own


def parts_of(run: Run, sequence: Sequence, options: ScoreOptions) -> list[Part]:
    """Return the slices of a run's detections in its own space, in the order of its rows."""
    parts = [] if options.seen else [*slices.by_seen(sequence)]
    parts += [*slices.by_range(sequence, options.range_m), *slices.by_visibility(sequence)]
    return [*parts, *slices.by_source(sequence), *_by_region(run, sequence)]


def _by_region(run: Run, sequence: Sequence) -> Iterator[Part]:
    """Yield what lies in each kind of the log's regions, of a sequence in the ground plane of a log with poses."""
    truth, estimates, regions = sequence.truth, sequence.estimates, regions_of(run)
    if truth.center_m is None or estimates.center_m is None or not regions or not has_poses(run):
        return
    frame = sequence.steps.frame
    truth_points = ground_points(run, frame[truth.step], truth.center_m)
    estimate_points = ground_points(run, frame[estimates.step], estimates.center_m)
    for kind in dict.fromkeys(region.kind for region in regions):
        own = [region for region in regions if region.kind == kind]
        yield Part(f"region {kind}", inside(own, truth_points), inside(own, estimate_points))


def rows_of(entry: ScoreCounts[DetectionCounts]) -> list[Score]:
    """Return the rows of one entry; what depends on scores and distances only of the whole, horizons of conditions."""
    rows = scores.detection_rows(entry.counts, entry.key)
    if entry.key.slice.startswith(CONDITION):
        return [*rows, *horizon_rows(entry.counts.ranges, entry.counts.boxes.gt, entry.key)]
    if entry.key.slice != "all":
        # A false alarm has no visibility, so neither precision nor F1 means anything there.
        return [row for row in rows if row.metric == "recall" or row.slice not in VISIBILITY_SLICES]
    rows += scores.curve_rows(entry.counts, entry.key)
    rows += horizon_rows(entry.counts.ranges, entry.counts.boxes.gt, entry.key)
    if entry.key.matching.startswith("iou "):
        rows += scores.deviation_rows(entry.counts, entry.key)
    return rows


def coverage(matching: str, num_scored: int, num_frames: int) -> Score:
    """Return the share of frames that have truth and so were scored."""
    counts = {"scored": num_scored, "frames": num_frames}
    return ratio("coverage", "all", matching, num_scored, num_frames, "no frames", counts)
