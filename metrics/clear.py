"""CLEAR MOT: misses, false alarms and identity switches of tracks."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from fbench.metrics.counts import BoxCounts, count_boxes
from fbench.metrics.groups import VEHICLE, Group, label_group
from fbench.metrics.matching import Matches, match_hungarian
from fbench.metrics.prepare import Problem, View, views
from fbench.replay.arrays import Array, Int64
from fbench.replay.errors import MetricError
from fbench.replay.scores import Score, ScoreOptions, ratio
from fbench.replay.store import Run


class Clear:
    """MOTA, MOTP and identity switches of `run.tracks` (Bernardin and Stiefelhagen 2008).

    - `mota` = 1 - sum(FN + FP + IDSW) / sum(GT), up to 1, not clipped below.
    - `mota_no_fp` = 1 - sum(FN + IDSW) / sum(GT): leaves out false alarms, and so is not MOTA; it rewards a tracker
      that floods the scene. Kept because the thesis that fbench follows prints it as MOTA.
    - `motp`: mean over all matches, of the distance [m] in the ground plane or of the IoU in images.
    - `idsw`: how often truth was matched to another track than at its last match, any gap of frames between them.

    A pair of the previous scored frame stays while it is inside the threshold; the rest is matched for most pairs,
    then best total. Identities don't continue over segment borders, nor from one camera to another. Without truth
    boxes, or where truth or tracks have no ids, what needs them is null.
    """

    def scores(self, run: Run, options: ScoreOptions) -> Sequence[Score]:
        """Return rows for all vehicles as one class in each space, then for each label.

        Raises:
            MetricError: where an id occurs twice in one frame.
        """
        spaces = views(run, run.tracks, options)
        for view in spaces:
            _require_unique_ids(view)
        rows = [row for view in spaces for row in _rows(view, VEHICLE)]
        return rows + [row for label in spaces[0].labels for row in _rows(spaces[0], label_group(label))]


@dataclass(frozen=True)
class ClearCounts:
    """Raw counts of CLEAR MOT; can be added over runs."""

    boxes: BoxCounts = field(default_factory=BoxCounts)
    idsw: int = 0
    similarity_sum: float = 0.0
    """Over all matches."""
    num_truth_ids: int = 0
    """Truth boxes with an id."""
    num_estimates: int = 0
    num_estimate_ids: int = 0

    def __add__(self, other: "ClearCounts") -> "ClearCounts":
        return ClearCounts(
            self.boxes + other.boxes,
            self.idsw + other.idsw,
            self.similarity_sum + other.similarity_sum,
            self.num_truth_ids + other.num_truth_ids,
            self.num_estimates + other.num_estimates,
            self.num_estimate_ids + other.num_estimate_ids,
        )


@dataclass
class _Memory:
    """What one sequence remembers of its past: track id by truth id."""

    previous: dict[int, int] = field(default_factory=dict)
    """Pairs of the frame before."""
    last: dict[int, int] = field(default_factory=dict)
    """Last match of each truth, any number of frames ago."""


def clear_counts(problems: Iterable[Problem]) -> ClearCounts:
    """Match and count problems in the order of their frames; each segment and stream is a sequence of its own."""
    memories: dict[tuple[int, str], _Memory] = {}
    total = ClearCounts()
    for problem in problems:
        total += _step(problem, memories.setdefault((problem.segment, problem.stream), _Memory()))
    return total


def _step(problem: Problem, memory: _Memory) -> ClearCounts:
    matches = _match(problem, memory.previous)
    truth = np.flatnonzero(matches.estimate_of_truth >= 0)
    estimates = matches.estimate_of_truth[truth]
    memory.previous = dict(_known_pairs(problem.truth_id[truth], problem.estimate_id[estimates]))
    switches = [t for t, e in memory.previous.items() if memory.last.get(t, e) != e]
    memory.last.update(memory.previous)
    return ClearCounts(
        boxes=count_boxes(problem, matches),
        idsw=len(switches),
        similarity_sum=math.fsum(problem.similarity[truth, estimates].tolist()),
        num_truth_ids=int((problem.truth_id >= 0).sum()),
        num_estimates=len(problem.estimate_id),
        num_estimate_ids=int((problem.estimate_id >= 0).sum()),
    )


def _known_pairs(truth: Int64, estimates: Int64) -> Iterator[tuple[int, int]]:
    """Pairs in which both sides have an id."""
    return ((t, e) for t, e in zip(truth.tolist(), estimates.tolist(), strict=True) if t >= 0 and e >= 0)


def _match(problem: Problem, previous: dict[int, int]) -> Matches:
    """Keep the pairs of the previous frame that are still valid, and match the rest."""
    kept_truth, kept = _kept(problem, previous)
    rows = np.setdiff1d(np.arange(len(problem.truth_id)), kept_truth)
    columns = np.setdiff1d(np.arange(len(problem.estimate_id)), kept)
    rest = match_hungarian(problem.similarity[np.ix_(rows, columns)], problem.threshold, problem.inside[columns])
    new = np.flatnonzero(rest.estimate_of_truth >= 0)
    truth = np.concatenate([kept_truth, rows[new]])
    estimates = np.concatenate([kept, columns[rest.estimate_of_truth[new]]])
    return Matches.of((len(problem.truth_id), len(problem.estimate_id)), truth, estimates)


def _kept(problem: Problem, previous: dict[int, int]) -> tuple[Array, Array]:
    """Rows and columns of the pairs of the previous frame that are still inside the threshold."""
    column = {e: i for i, e in enumerate(problem.estimate_id.tolist())}
    pairs = [(row, column.get(previous.get(t, -1), -1)) for row, t in enumerate(problem.truth_id.tolist())]
    kept = [(r, c) for r, c in pairs if c >= 0 and problem.similarity[r, c] >= problem.threshold]
    both = np.array(kept, np.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def _rows(view: View, group: Group) -> list[Score]:
    n = clear_counts(view.problems(group))
    counts = {**asdict(n.boxes), "gt": n.boxes.gt, "idsw": n.idsw, "frames": view.num_scored}
    boxes, space = n.boxes, view.space
    nothing = view.reason or (None if boxes.gt else "no truth boxes")
    undefined = nothing or _no_ids(n)
    gt = 0 if undefined else boxes.gt
    why = undefined or ""
    name, text = group.name, space.matching
    found = boxes.gt - boxes.fn - n.idsw
    idsw = None if undefined else float(n.idsw)
    distance = {**counts, "similarity_sum": n.similarity_sum}
    return [
        ratio("mota", name, text, found - boxes.fp, gt, why, counts),
        ratio("mota_no_fp", name, text, found, gt, why, counts),
        ratio(
            "motp", name, text, space.measure(n.similarity_sum), boxes.tp, nothing or "no matches", distance, space.unit
        ),
        Score("idsw", name, "all", text, idsw, undefined, "1", counts),
    ]


def _no_ids(n: ClearCounts) -> str | None:
    if not n.num_truth_ids:
        return "truth has no track ids"
    return "tracks have no ids" if n.num_estimates and not n.num_estimate_ids else None


def _require_unique_ids(view: View) -> None:
    for scene in view.scenes:
        for what, items in (("truth", scene.truth), ("tracks", scene.estimates)):
            ids, times = np.unique(items.track_id[items.track_id >= 0], return_counts=True)
            if (times > 1).any():
                twice = int(ids[times > 1][0])
                image = f", camera {scene.stream}" if scene.stream else ""
                # The folder may still have a name that nobody knows.
                which = f"'{view.run.manifest.pipeline}' on log '{view.run.manifest.log.name}'"
                raise MetricError(
                    f"{which}: frame {scene.frame}{image}: {what} has id {twice} twice; "
                    "an id names one object of a frame",
                    "GT003",
                )
