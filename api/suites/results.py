"""Tables of a suite: F1 by pipeline and condition, and what single sensors are worth."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from fbench.api.suites.ablation import Ablation
from fbench.api.suites.suite import Suite
from fbench.api.suites.tables import Done
from fbench.metrics.core.bootstrap import Bootstrap
from fbench.metrics.robustness.matrix import Cell, Matrix
from fbench.metrics.robustness.scenes import SPACES, ScoredRun, pool, spaces_of
from fbench.replay.data.scores import Column, Figure, Line, Results, ResultTable, format_count
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import package_versions

_METRICS = {"f1": "F1", "mota": "MOTA"}
_RESAMPLES = 1000


def results_of(suite: Suite, done: Done, ablations: Sequence[Ablation] = ()) -> Results:
    """Put all runs together: counts are added over logs, rates and seeds. Raises MetricError where a run can't be
    scored.
    """
    runs = {id(cell): Run(result.folder) for cell, result in done if result.has_run}
    scored = [
        ScoredRun(cell.pipeline, cell.condition, f"{cell.log} {cell.seed}", runs[id(cell)].scores)
        for cell, _ in done if id(cell) in runs
    ]  # fmt: skip
    frames = {cell.log: runs[id(cell)].manifest.num_frames for cell, _ in done if id(cell) in runs}
    facts = [
        ("suite", suite.title or Path(suite.where).stem),
        ("logs", f"{len(suite.logs)}: {_list(log.name for log in suite.logs)}"),
        ("pipelines", _list(pipeline.name for pipeline in suite.pipelines)),
        ("conditions", _list(suite.conditions)),
        ("rates", _list(suite.rates)),
        ("seeds", _list(map(str, suite.seeds))),
        ("frames", f"{sum(frames.values())}, each once a cell"),
        ("versions", ", ".join(f"{name} {version}" for name, version in package_versions().items())),
    ]
    problems = [
        f"{'left out' if result.state == 'unfit' else 'failed'}: {cell.pipeline} on {cell.log}, {cell.condition}"
        f"{f', seed {cell.seed}' if cell.seed else ''}: {result.reason}"
        for cell, result in done if not result.has_run
    ]  # fmt: skip
    tables = [_table(suite, scored, metric) for metric in _METRICS]
    if ablations:
        tables.append(_ablation_table(suite, done, ablations))
    return Results("Suite", tuple(facts), tuple(tables), (), tuple(problems))


def _list(names: Iterable[str]) -> str:
    found = list(names)
    return ", ".join(found if len(found) <= 12 else [*found[:12], f"and {len(found) - 12} more"])


def _table(suite: Suite, scored: Sequence[ScoredRun], metric: str) -> ResultTable:
    lines = []
    for pipeline in suite.pipelines:
        own = [run for run in scored if run.configuration == pipeline.name]
        for space in spaces_of(own) or list(SPACES)[-1:]:
            figures = [
                pool([run for run in own if run.condition == condition], metric, space)
                for condition in suite.conditions
            ]
            lines.append(Line(pipeline.name, space, tuple(figures)))
    logs = format_count(len(suite.logs), "log")
    columns = tuple(Column(condition) for condition in suite.conditions)
    notes = (f"All vehicles as one class; counts of {logs}, all rates and seeds, added before dividing.",)
    name, title = "accuracy" if metric == "f1" else metric, f"{_METRICS[metric]}, %"
    return ResultTable(name, title, columns, tuple(lines), notes, is_map=metric == "f1")


def _ablation_table(suite: Suite, done: Done, ablations: Sequence[Ablation]) -> ResultTable:
    """F1 of the whole minus F1 without the sensor, on the same stretches of the logs."""
    cells = [
        Cell(cell.pipeline, cell.condition, "", f"{cell.log}/{cell.seed}/{cell.rate}", Run(result.folder))
        for cell, result in done if result.has_run
    ]  # fmt: skip
    matrix = Matrix(cells, suite.options.scoring, Bootstrap(num=_RESAMPLES))
    lines = []
    for ablation in ablations:
        figures = tuple(_value(matrix, ablation, condition) for condition in suite.conditions)
        lines.append(Line(f"{ablation.sensor} of {ablation.whole}", matrix.space(ablation.whole), figures))
    columns = tuple(Column(condition, "change") for condition in suite.conditions)
    note = "F1 with all sensors minus F1 without the sensor, in points: above 0 the sensor helps."
    return ResultTable("ablation", "What each sensor is worth", columns, tuple(lines), (note, matrix.note))


def _value(matrix: Matrix, ablation: Ablation, condition: str) -> Figure:
    whole, part = (matrix.pool_cell(name, condition, "", "f1") for name in (ablation.whole, ablation.part))
    for name, figure in ((ablation.whole, whole), (ablation.part, part)):
        if figure.value is None:
            return Figure(None, f"no F1 of {name}: {figure.reason}")
    low, high = matrix.difference(ablation.part, ablation.whole, condition)
    counts = {f"{name}_{key}": num for name, f in (("whole", whole), ("part", part)) for key, num in f.counts.items()}
    return Figure((whole.value or 0.0) - (part.value or 0.0), None, counts, None, low, high)
