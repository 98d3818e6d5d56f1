"""Robustness: how F1 changes, relative to clear weather, under other conditions on the same scene.

Runs of several scenes are put together by adding raw counts, never by averaging ratios.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from fbench.replay.data.scores import Figure, Score

Space = str  # `image` or `3D`
SPACES: Mapping[Space, str] = {"image": "iou ", "3D": "bev "}  # How the matching of each begins
CLEAR = "clear"
_CLASS = "vehicle"
_LEAST_F1 = 0.1  # In clear weather, for a relative change: one more object found would be tens of percent
_COUNTS = ("tp", "fp", "fn", "gt", "idsw")


@dataclass(frozen=True)
class ScoredRun:
    """The scores of one run of an experiment."""

    configuration: str
    condition: str
    scene: str  # What conditions are compared on: the same for each condition of one world and seed
    scores: Sequence[Score]


_NOTHING = {"f1": "no boxes, in truth nor detected", "precision": "nothing detected"}
"""Why there is no value where there is nothing to divide by; of the others: no truth boxes."""


def _fraction(metric: str, n: Counter[str]) -> tuple[float, float]:
    """Top and bottom of a metric: F1 = TP / (TP + FP/2 + FN/2); MOTA as in `metrics.runs.tracking`."""
    match metric:
        case "f1":
            return n["tp"], n["tp"] + n["fp"] / 2 + n["fn"] / 2
        case "precision" | "recall":
            return n["tp"], n["tp"] + n["fp" if metric == "precision" else "fn"]
        case _:
            return n["gt"] - n["fn"] - (n["fp"] if metric == "mota" else 0) - n["idsw"], n["gt"]


def spaces_of(runs: Iterable[ScoredRun]) -> list[Space]:
    """Return the spaces in which any of the runs was scored."""
    found = [score.matching for run in runs for score in run.scores if score.metric == "f1"]
    return [space for space, start in SPACES.items() if any(matching.startswith(start) for matching in found)]


def pool(runs: Iterable[ScoredRun], metric: str, space: Space) -> Figure:
    """Return a metric of all vehicles over several runs of one configuration: f1, precision, recall, mota or
    mota_no_fp, in the space `image` or `3D`.
    """
    of = (metric, _CLASS, "all")
    found = (
        [row for row in run.scores if row.key[:3] == of and row.matching.startswith(SPACES[space])] for run in runs
    )
    rows = [own[0] for own in found if own]
    if not rows:
        return Figure(None, "no run")
    counts: Counter[str] = Counter()
    for row in rows:
        counts.update({name: int(row.counts[name]) for name in _COUNTS if name in row.counts})
    reasons = [row.reason for row in rows if row.reason is not None]
    for row in rows:
        if row.reason is not None and _fraction(metric, Counter(row.counts))[1]:
            return Figure(None, row.reason, counts)  # for another reason than that there is nothing to divide by
    top, bottom = _fraction(metric, counts)
    if not bottom:
        return Figure(None, (*reasons, _NOTHING.get(metric, "no truth boxes"))[0], counts)
    return Figure(top / bottom, None, counts)


def change(runs: Sequence[ScoredRun], condition: str, space: Space) -> Figure:
    """Return the relative change of F1 against clear weather, (F1 - F1 clear) / F1 clear, on the scenes of which there
    are runs in both.

    `runs` are of one configuration, the condition is such as `fog`, the space `image` or `3D`.
    """
    scenes = {run.scene for run in runs if run.condition == CLEAR} & {r.scene for r in runs if r.condition == condition}
    if not scenes:
        return Figure(None, f"no scene was run both in {CLEAR} and in {condition}")
    base, found = (
        pool([run for run in runs if run.condition == name and run.scene in scenes], "f1", space)
        for name in (CLEAR, condition)
    )
    counts = {f"{name}_{key}": num for name, f in ((CLEAR, base), ("then", found)) for key, num in f.counts.items()}
    if base.value is None:
        return Figure(None, f"no F1 in {CLEAR}: {base.reason}", counts)
    if found.value is None:
        return Figure(None, f"no F1 in {condition}: {found.reason}", counts)
    if base.value < _LEAST_F1:
        return Figure(None, f"F1 is {base.value:.3g} in {CLEAR}, too little for a relative change", counts)
    return Figure((found.value - base.value) / base.value, None, counts)
