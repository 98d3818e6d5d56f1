"""Camera detectors side by side: what each finds on one log, how long it takes, and how large it is."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain, count
from pathlib import Path

import numpy as np

from fbench.api.replays import replay
from fbench.metrics.core.slices import RANGES_M, VEHICLE, Part, ground_range
from fbench.metrics.detection.outcomes import compare_class, judge_detections
from fbench.metrics.detection.scores import Ranking, detection_counts
from fbench.metrics.runs.columns import View
from fbench.metrics.runs.spaces import image_view
from fbench.pipelines.models.weights import resolve
from fbench.pipelines.sensors.camera.model import ModelFacts, describe_model
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.data.files import Draft, expand_user, replace_text
from fbench.replay.data.scores import DASH
from fbench.replay.runs.folder import Run
from fbench.replay.setup.request import ReplayRequest
from fbench.reports.html.charts import Axis, Chart, Curve, Page, Table, write_page

LOWEST_SCORE = 0.05
"""Boxes from this score on are ranked, so that AP is about all thresholds."""
_CHOSEN = (
    "Precision and recall are at the score that gives the best F1 on this log. It was chosen here, so expect a little "
    "less elsewhere. Vehicles count as one class."
)
RESULT, PAGE = "weights.json", "report.html"
"""Files of a comparison, beside the run folders."""


@dataclass(frozen=True)
class DetectorRequest:
    """Detectors to compare. Raises ConfigError where there are none, or one twice."""

    replay: ReplayRequest
    """Of `camera2d`; its `out` gets a folder a detector."""
    weights: Sequence[str]
    """ONNX files, or names of `fbench weights list`."""
    min_score: float = LOWEST_SCORE

    def __post_init__(self) -> None:
        if not self.weights:
            raise ConfigError("names no detector: give ONNX files, or names of `fbench weights list`")
        if not 0 <= self.min_score < 1:
            raise ConfigError(f"--min-score {self.min_score:g}: expected at least 0 and below 1")
        if twice := next((one for one in self.weights if self.weights.count(one) > 1), None):
            raise ConfigError(f"{twice}: given twice")


@dataclass(frozen=True)
class RangeRecall:
    """What was found of vehicles at one distance."""

    low_m: float
    high_m: float
    recall: float | None
    gt: int


@dataclass(frozen=True)
class DetectorRow:
    """One detector. Scores are about all vehicles as one class, and `None` where they are undefined."""

    name: str
    model: ModelFacts
    ap: float | None
    best_f1: float | None
    threshold: float | None
    """Score from which on boxes count for the best F1, for `precision`, and for recall."""
    precision: float | None
    recall: float | None
    recall_by_range: Sequence[RangeRecall]
    stage_ms: Mapping[str, float | None]
    """Mean time by stage; `total` without tracking."""
    curve: Sequence[tuple[float, float]]
    """Recall and precision at falling thresholds."""


@dataclass(frozen=True)
class DetectorComparison:
    """Finished runs of several detectors on one log."""

    folder: Path
    log: str
    matching: str
    num_frames: int
    rows: Sequence[DetectorRow]


def compare_detectors(
    request: DetectorRequest, progress: Callable[[int, int], None] = lambda done, total: None
) -> DetectorComparison:
    """Replay the log with each detector, one after the other, and write a folder with the runs, `weights.json`, and a
    page with plots, which gets its name when it is whole. `progress` gets how many detectors are done, of how many.

    Each replay decodes the images itself, so that times compare. Raises ConfigError where the folder exists or weights
    are missing; ModelError where they can't be used; MetricError where the images have no truth; else as `replay`.
    """
    folder = request.replay.out or Path("runs/weights")
    if folder.exists() and not request.replay.overwrite:
        raise ConfigError(f"{folder}: exists already; choose another with --out, or --overwrite it")
    if folder.exists() and not (folder / RESULT).is_file():
        raise ConfigError(f"{folder}: exists and isn't a comparison of detectors, so --overwrite doesn't touch it")
    files = [_find_file(weights) for weights in request.weights]
    facts, names = [describe_model(file) for file in files], _name_detectors(request.weights)
    rows, matching, num_frames = list[DetectorRow](), "", 0
    with Draft(folder, is_folder=True) as draft:
        for num, (name, file, fact) in enumerate(zip(names, files, facts, strict=True)):
            progress(num, len(names))
            own = (f"camera.weights={file}", f"camera.min_score={request.min_score:g}")
            settings = (*request.replay.settings, *own)
            run = replay(replace(request.replay, settings=settings, out=draft.path / name, overwrite=False)).run
            view = image_view(run, run.detections, request.replay.scoring)
            if view.key.reason:
                raise MetricError(f"{request.replay.log.path}: nothing to compare detectors with: {view.key.reason}")
            matching, num_frames = view.key.matching, view.key.num_frames
            rows.append(_measure(run, view, name, fact))
        found = DetectorComparison(folder, run.manifest.log.name, matching, num_frames, rows)
        replace_text(draft.path / RESULT, json.dumps(comparison_content(found), indent=1, allow_nan=False) + "\n")
        write_page(draft.path / PAGE, _page(found))
        draft.publish()
    return found


def _find_file(weights: str) -> Path:
    found = resolve(expand_user(weights))
    if not isinstance(found, Path):
        raise ConfigError(f"{weights}: expected an ONNX file, or a name of `fbench weights list`")
    return found


def _name_detectors(weights: Sequence[str]) -> list[str]:
    """Names without folder and suffix; numbered where one is taken, as by a file of the comparison."""
    names = list[str]()
    for stem in (Path(one).stem for one in weights):
        candidates = chain((stem,), (f"{stem}-{num}" for num in count(2)))
        names.append(next(name for name in candidates if name not in (*names, RESULT, PAGE)))
    return names


def _measure(run: Run, view: View, name: str, model: ModelFacts) -> DetectorRow:
    ranking = detection_counts(view.sequence, VEHICLE, view.match).ranking
    threshold = None if ranking.reason else ranking.best_f1()[1]
    precision, recall = (None, None) if threshold is None else _working_point(ranking, threshold)
    stages: dict[str, float | None] = {row["stage"]: row["mean_ms"] for row in run.json("latency.json")["stages"]}
    tracking = stages.pop("track", None)
    if (total := stages.get("total")) is not None:
        stages["total"] = total - (tracking or 0.0)
    return DetectorRow(
        name, model,
        None if ranking.reason else ranking.average_precision(),
        None if ranking.reason else ranking.best_f1()[0],
        threshold, precision, recall, _recall_by_range(view, threshold), stages,
        [] if ranking.reason else [(float(r), float(p)) for r, p in zip(*ranking.curve(), strict=True)],
    )  # fmt: skip


def _working_point(ranking: Ranking, threshold: float) -> tuple[float, float]:
    """Precision and recall of what has at least a score."""
    at = int(np.flatnonzero(ranking.scores >= threshold)[-1])
    recall, precision = ranking.curve()
    return float(precision[at]), float(recall[at])


def _recall_by_range(view: View, threshold: float | None) -> list[RangeRecall]:
    """Recall of what has at least a score, by distance of truth; nothing where distances aren't known."""
    sequence = view.sequence
    every = np.ones(len(sequence.truth), bool), np.ones(len(sequence.estimates), bool)
    given = sequence.estimates.score >= (np.inf if threshold is None else threshold)
    candidates = compare_class(sequence, VEHICLE, view.match).select(Part("", *every, given))
    range_m = ground_range(candidates.truth)
    if range_m is None or not np.isfinite(range_m).any():
        return []
    hit = np.isin(np.arange(len(range_m)), judge_detections(candidates).truth_of_estimate)
    rows, farthest = list[RangeRecall](), float(range_m[np.isfinite(range_m)].max())
    for low, high in zip(RANGES_M, (*RANGES_M[1:], np.inf), strict=True):
        own = (low <= range_m) & (range_m < high)
        if low <= farthest and high < np.inf:
            rows.append(RangeRecall(low, high, float(hit[own].mean()) if own.any() else None, int(own.sum())))
    return rows


def comparison_content(found: DetectorComparison) -> dict[str, object]:
    """Return a comparison as it stands in `weights.json`."""
    rows = [{name: value for name, value in asdict(row).items() if name != "curve"} for row in found.rows]
    return {"log": found.log, "matching": found.matching, "frames": found.num_frames, "detectors": rows}


def comparison_table(found: DetectorComparison) -> tuple[list[str], list[list[str]]]:
    """Return the names of columns, and a row of texts a detector."""
    ranges = list(dict.fromkeys((r.low_m, r.high_m) for row in found.rows for r in row.recall_by_range))
    stages = list(dict.fromkeys(stage for row in found.rows for stage in row.stage_ms))
    header = ["detector", "family", "input", "MB", "parameters", "AP %", "best F1 %", "from score", "precision %"]
    header += ["recall %", *(f"{low:g}-{high:g} m %" for low, high in ranges), *(f"{stage} ms" for stage in stages)]
    rows = []
    for row in found.rows:
        known = {(r.low_m, r.high_m): r.recall for r in row.recall_by_range}
        model, shares = row.model, (row.ap, row.best_f1)
        rows.append([
            row.name, model.family, "x".join(map(str, model.input_wh)) if model.input_wh else "any",
            f"{model.num_bytes / 1e6:.1f}", f"{model.num_parameters / 1e6:.2f} M", *map(_percent, shares),
            DASH if row.threshold is None else f"{row.threshold:.2f}", _percent(row.precision), _percent(row.recall),
            *(_percent(known.get(one)) for one in ranges),
            *(DASH if (ms := row.stage_ms.get(stage)) is None else f"{ms:.1f}" for stage in stages),
        ])  # fmt: skip
    return header, rows


def _percent(share: float | None) -> str:
    return DASH if share is None else f"{100 * share:.1f}"


def _page(found: DetectorComparison) -> Page:
    header, rows = comparison_table(found)
    by_range = [
        Curve(row.name, [((r.low_m + r.high_m) / 2, r.recall) for r in row.recall_by_range]) for row in found.rows
    ]
    ranges = list(dict.fromkeys((r.low_m, r.high_m) for row in found.rows for r in row.recall_by_range))
    ticks = [((low + high) / 2, f"{low:g}-{high:g}") for low, high in ranges]
    shares = [(i / 5, f"{i / 5:g}") for i in range(6)]
    charts = [
        Chart("Average precision", Axis("mean time of an image without tracking, ms"),
              [Curve(row.name, [] if (ms := row.stage_ms.get("total")) is None else [(ms, row.ap)])
               for row in found.rows]),
        Chart("Precision", Axis("recall", shares), [Curve(row.name, row.curve) for row in found.rows]),
    ]  # fmt: skip
    if ticks:
        charts.append(Chart("Recall", Axis("distance of vehicles, m", ticks), by_range))
    facts = [("Frames with truth", str(found.num_frames)), ("Scored", found.matching)]
    table = Table(header, [(row[0], row[1:]) for row in rows])
    return Page("camera detectors side by side", found.log, facts, charts, table, [_CHOSEN])
