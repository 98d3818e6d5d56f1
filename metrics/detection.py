"""Precision, recall and F1 of detections."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict

from fbench.metrics.counts import BoxCounts, count_boxes
from fbench.metrics.groups import VEHICLE, Group, label_group
from fbench.metrics.matching import Matches, match_greedy
from fbench.metrics.prepare import Problem, View, views
from fbench.replay.scores import Score, ScoreOptions, ratio
from fbench.replay.store import Run


class Detection:
    """F1, precision and recall of `run.detections` at the score threshold that the pipeline has.

    P = TP/(TP + FP), R = TP/(TP + FN), F1 = 2PR/(P + R) = TP/(TP + FN/2 + FP/2), each 0 to 1. Estimates are matched
    greedily by score to the nearest truth (see `match_greedy`); 3D within a distance in the ground plane, in images
    from an IoU on. Frames without truth aren't scored; empty frames are, and what is detected there is a false alarm.
    Null where the denominator is 0. Counts are summed over frames before dividing.
    """

    def scores(self, run: Run, options: ScoreOptions) -> Sequence[Score]:
        """Return rows for all vehicles as one class in each space, then for each label, then `coverage`."""
        spaces = views(run, run.detections, options)
        native = spaces[0]
        rows = [row for view in spaces for row in _rows(view, VEHICLE)]
        rows += [row for label in native.labels for row in _rows(native, label_group(label))]
        return [*rows, coverage(native)]


def detection_counts(problems: Iterable[Problem]) -> BoxCounts:
    """Match and count all problems."""
    return sum((count_boxes(p, _match(p)) for p in problems), BoxCounts())


def coverage(view: View) -> Score:
    """Return the share of the run's frames that have truth and so were scored."""
    frames = len(view.run.frames)
    counts = {"scored": view.num_scored, "frames": frames}
    return ratio("coverage", "all", view.space.matching, view.num_scored, frames, "no frames", counts)


def _match(problem: Problem) -> Matches:
    return match_greedy(problem.similarity, problem.threshold, problem.score, problem.inside)


def _rows(view: View, group: Group) -> list[Score]:
    n = detection_counts(view.problems(group))
    table: Mapping[str, tuple[float, float, str]] = {
        "f1": (n.tp, n.tp + n.fn / 2 + n.fp / 2, "no truth and no estimates"),
        "precision": (n.tp, n.estimates, "no estimates"),
        "recall": (n.tp, n.gt, "no truth boxes"),
    }
    counts = {**asdict(n), "frames": view.num_scored}
    matching = view.space.matching
    return [
        ratio(metric, group.name, matching, top, bottom, view.reason or why, counts)
        for metric, (top, bottom, why) in table.items()
    ]
