"""The profile `waymo`."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from fbench.metrics.profiles.waymo.measure import ClassRule, CurveCounts, WaymoStatistics, measure
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.arrays import Float64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

RECALL_STEP = 0.05  # Along a curve, precision is read at least so often
CAMERA_M = (1.43, 0.0, 2.18)  # Where Waymo's cameras are on average, on the body


def average_precision(precision: Float64, recall: Float64) -> float:
    """Area under the curve of precision (K,) by recall (K,), the best precision at or beyond each recall counting.

    As `ComputeMeanAveragePrecision` of Waymo: trapezoids between the recalls that occur, and between recalls that are
    `RECALL_STEP` apart where none does; at recall 0 the precision is that of the point before.
    """
    best: dict[float, float] = {0.0: 1.0}
    for p, r in zip(precision.tolist(), recall.tolist(), strict=True):
        best[r] = max(best.get(r, 0.0), p)
    points: list[tuple[float, float]] = []
    last, highest = 0.0, 0.0
    for r in sorted(best, reverse=True):
        while last - r > RECALL_STEP + 1e-6:
            last -= RECALL_STEP
            points.append((last, highest))
        highest = max(highest, best[r])
        points.append((r, highest))
        last = r
    if len(points) > 1:
        points[-1] = points[-1][0], points[-2][1]
    r, p = np.array(points).T
    return float(((r[:-1] - r[1:]) * (p[:-1] + p[1:])).sum() / 2)


_CLASSES = (
    ClassRule("vehicle", ("vehicle", "car", "van", "truck", "bus", "trailer", "motorcycle"), 0.7),
    ClassRule("pedestrian", ("pedestrian",), 0.5),
    ClassRule("cyclist", ("cyclist", "bicycle"), 0.5),
    ClassRule("sign", ("sign",), 0.5),
)
_TOLERANT = {"vehicle": 0.5}  # All others 0.3


@dataclass(frozen=True)
class WaymoProfile:
    """Average precision of 3D boxes as the Waymo Open Dataset counts it (`compute_detection_metrics_main`).

    - At each of 101 cutoffs of the score, 0 to 1, the boxes of a frame are matched for the largest sum of overlaps.
    - `ap` is the area under the curve; `aph` weighs each hit in the precision by 1 - error of heading / pi.
    - Level 2 is all truth; level 1 doesn't ask for truth with up to 5 points. Truth without points doesn't count.
    - Overlaps of 0.7 (vehicles) and 0.5 match.

    With `--match let:NUMBER` it is longitudinally tolerant (`compute_detection_let_metrics_main`): estimates are moved
    along the line of sight from Waymo's cameras, `let_ap` and `let_aph` count as before, and `let_apl` weighs each hit
    in the precision by how good its distance is. Waymo takes 0.5 for vehicles and 0.3 for the rest, as does `let:0.5`;
    another number holds for all classes.

    Which of several equally good matches counts isn't settled by Waymo's rules; it can change `aph` and `let_apl`.
    """

    classes: tuple[ClassRule, ...] = _CLASSES
    camera_m: tuple[float, float, float] | None = None  # Of longitudinal tolerance; none without
    name: str = "waymo"
    summary: str = "AP and APH of 3D boxes, also longitudinally tolerant (LET), as the Waymo Open Dataset 1.6.1"

    @property
    def facts(self) -> Facts:
        """What it judges; with tolerance people look for other metrics."""
        metrics = ("ap", "aph") if self.camera_m is None else ("let_apl", "let_ap", "let_aph")
        return Facts(judges_tracks=False, space="3d", headlines=Headlines(metrics), cuts_up_to_1=True)

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(label for rule in self.classes for label in rule.labels)

    def with_match(self, match: Match) -> Self:
        """Return the profile with another overlap, `iou3d` or `let`. Raises ConfigError for another match."""
        if match.kind not in ("iou3d", "let"):
            raise ConfigError(f"profile waymo: can't match by {match.kind}, use iou3d or let")
        is_usual = match == Match("let", 0.5)
        classes = tuple(
            replace(rule, overlap=_TOLERANT.get(rule.name, 0.3) if is_usual else match.threshold)
            for rule in self.classes
        )
        return replace(self, classes=classes, camera_m=CAMERA_M if match.kind == "let" else None)

    def measure(self, sequence: Sequence) -> WaymoStatistics:
        """Return the counts of one sequence. Raises MetricError where boxes have no place in space."""
        return measure(sequence, self.classes, self.camera_m)

    def scores(self, statistics: WaymoStatistics, part: str) -> list[Score]:
        """Return rows of each class that occurs: of level 2, then of level 1, then of ranges."""
        rows = []
        curves = statistics.curves
        shown = [r for r in self.classes if _size(curves[r.name, "", 2]) or r.name == "vehicle"]
        for rule in shown:
            places = sorted({place[1:] for place in curves if place[0] == rule.name}, key=lambda p: (p[0] != "", -p[1]))
            for far, level in places:
                words = [part, *([far] if far else []), *(["level 1"] if level == 1 else [])]
                rows += self._rows(curves[rule.name, far, level], rule, ", ".join(words), statistics)
        return rows

    def _rows(self, n: CurveCounts, rule: ClassRule, slice_: str, of: WaymoStatistics) -> list[Score]:
        hits, alarms, misses = (np.array(each, np.float64) for each in (n.hits, n.alarms, n.misses))
        sums = {
            "ap": hits,
            "aph": np.array([float(x) for x in n.heading]),
            "apl": np.array([float(x) for x in n.affinity]),
        }
        names = ("apl", "ap", "aph") if self.camera_m is not None else ("ap", "aph")
        kind, first = ("let", "let_") if self.camera_m is not None else ("iou3d", "")
        recall = hits / np.maximum(hits + misses, 1)
        # Where nothing is found precision is 1 by definition.
        precisions = {k: np.where(recall > 0, sums[k] / np.maximum(hits + alarms, 1), 1.0) for k in names}
        reason = None if n.hits[0] + n.misses[0] else "no truth boxes (Waymo's tool prints 0)"
        counts = {
            "tp": n.hits[0], "fp": n.alarms[0], "fn": n.misses[0], "frames": of.num_frames,
            "invalid_truth": of.num_invalid_truth, "invalid_estimates": of.num_invalid_estimates,
        }  # fmt: skip
        values = {k: None if reason else average_precision(precisions[k], recall) for k in names}
        where = rule.name, slice_, f"{kind} {rule.overlap:g}"
        return [Score(first + k, *where, values[k], reason, "1", counts) for k in names]


def _size(n: CurveCounts) -> int:
    return n.hits[0] + n.misses[0] + n.alarms[0]
