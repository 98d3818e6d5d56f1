"""Robustness suites: logs x pipelines x conditions x severities, as cells, and the results of their runs."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeAlias

from fbench.api.replays import require_device, short_name
from fbench.api.suites.cells import CellResult
from fbench.api.suites.suite import SuiteCell
from fbench.metrics.core.bootstrap import LEAST_UNITS, Bootstrap
from fbench.metrics.robustness.matrix import CLEAR, Cell, Matrix, matrix_tables, severity_curves
from fbench.metrics.robustness.recovery import Outage, find_outages, mean_recovery
from fbench.replay.conditions.disturb import Disturbance
from fbench.replay.conditions.spec import has_strength, parse_conditions
from fbench.replay.contracts.entry_points import entry_points_of
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import pipeline_parameters
from fbench.replay.data.scores import Column, Figure, Line, Results, ResultTable
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import package_versions
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import log_source

SuiteName: TypeAlias = Literal["thesis", "weather", "faults", "timing", "all"]
_WEATHERS = ("fog", "rain", "snow", "night")
SUITES: Mapping[SuiteName, Sequence[str]] = {
    "thesis": _WEATHERS,
    "weather": (*_WEATHERS, "wet", "camera.glare", "fog+night", "rain+night"),
    "faults": (
        "dropout.camera", "dropout.lidar", "dropout.radar", "loss.camera", "loss.lidar", "loss.radar",
        "camera.crash", "camera.frozen", "camera.lens_dirt", "lidar.beam_drop", "lidar.density", "lidar.crosstalk",
        "radar.point_loss", "radar.ghost", "radar.interference", "extrinsic.camera", "extrinsic.lidar", "intrinsic",
    ),
    "timing": (
        "delay.camera", "delay.lidar", "delay.radar", "offset.camera", "offset.lidar", "offset.radar", "jitter",
        "burst_loss", "drift", "duplicate", "reorder",
    ),
    "all": (),
}  # fmt: skip
"""Conditions of each suite, without severities; of `all` they are those that are installed."""


def suite_conditions(name: SuiteName) -> list[str]:
    """Return the conditions of a suite."""
    return list(SUITES[name]) or list(entry_points_of("conditions"))


def parse_severities(text: str) -> tuple[str, ...]:
    """Read `1-5`, `3` or `1,3,5`. Raises ConfigError where it can't be understood."""
    found: dict[str, None] = {}
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not re.fullmatch("[1-5]", first) or (dash and not re.fullmatch("[1-5]", last)) or (dash and last < first):
            raise ConfigError(f"--severity {text}: expected severities from 1 to 5, such as 1-5 or 1,3,5")
        found |= {str(number): None for number in range(int(first), int(last or first) + 1)}
    return tuple(sorted(found))


def fitting_settings(pipelines: Sequence[str], settings: Sequence[str]) -> dict[str, list[str]]:
    """Return the settings `NAME=VALUE` of each pipeline: those of parameters that it has; what is a parameter of none,
    but may be one of a sensor, goes to all that take it. Raises ConfigError for one that none of them takes.
    """
    found: dict[str, list[str]] = {name: [] for name in pipelines}
    known = {name: pipeline_parameters(name, []) for name in pipelines}
    for setting in settings:
        path, errors = setting.partition("=")[0], []
        having = [name for name in found if path in known[name]] or list(found)
        for name, own in ((name, found[name]) for name in having):
            try:
                pipeline_parameters(name, [*own, setting])
                own.append(setting)
            except ConfigError as error:
                errors.append(error)
        if len(errors) == len(having):
            raise errors[0]
    return found


@dataclass(frozen=True)
class RobustCell:
    """A cell of a suite, with its condition and severity apart."""

    condition: str
    severity: str
    cell: SuiteCell

    @property
    def log(self) -> str:
        """The log's name."""
        return self.cell.log

    @property
    def name(self) -> str:
        """The condition and its severity."""
        return f"{self.condition} {self.severity}".strip()

    @property
    def request(self) -> ReplayRequest:
        """How it is replayed."""
        return self.cell.request


@dataclass(frozen=True)
class RobustSuite:
    """What to run."""

    requests: Sequence[ReplayRequest]
    """Each log with each pipeline and all options, without conditions."""
    conditions: Sequence[str]
    severities: Sequence[str]
    folder: Path
    command: str
    baseline: str | None = None
    asked: Sequence[str] = ()
    """Conditions that were named, not taken from a suite: what doesn't fit the log is an error then."""
    resamples: int = 1000
    left_out: dict[str, str] = field(default_factory=dict)

    def cells(self) -> Iterator[RobustCell]:
        """Yield all cells, log by log: of each pipeline clear weather first. Conditions that fit no sensor of a log
        are left out. Raises ConfigError where two logs have one name, or a condition can't be understood, and LogError
        where a log can't be read.
        """
        names: dict[str, Path] = {}
        for request in self.requests:
            log = request.log.path.resolve()
            if names.setdefault(log.stem, log) != log:
                raise ConfigError(f"two logs are called '{log.stem}'; rename one, results are listed by name")
        for request in self.requests:
            request.resolve()  # so that a wrong option is found before anything runs
            require_device(request.device)
            yield self._cell(request, CLEAR, "")
            for condition, severity, text in self._texts(request):
                yield self._cell(replace(request, condition=text), condition, severity)

    def _texts(self, request: ReplayRequest) -> Iterator[tuple[str, str, str]]:
        for condition in self.conditions:
            own = ("",) if has_strength(condition) else self.severities
            why = self._why_unfit(request, condition, own[0])
            if why is not None:
                self.left_out[f"{condition} on {request.log.path.stem}"] = why
                continue
            yield from ((condition, severity, with_severity(condition, severity)) for severity in own)

    def _why_unfit(self, request: ReplayRequest, condition: str, severity: str) -> str | None:
        """Say why a condition of a suite doesn't fit a log. Raises ConfigError and LogError where it was asked for, or
        the log can't be read.
        """
        parts, source = parse_conditions(with_severity(condition, severity)), log_source(request.log)
        span, rig = source.span(), source.open(FaultLog()).rig
        try:
            Disturbance(parts, request.seed, span).require_fits(rig)
        except (ConfigError, LogError) as error:
            if condition in self.asked:
                raise
            return str(error)
        return None

    def _cell(self, request: ReplayRequest, condition: str, severity: str) -> RobustCell:
        log, pipeline = request.log.path.stem, short_name(request.pipeline)
        name = re.sub(r"[^\w.+-]+", "_", f"{condition}-{severity}".strip("-"))
        out = self.folder / log / pipeline / name
        whole = replace(request, out=out, overwrite=True, no_media=True)
        name = request.condition or CLEAR
        return RobustCell(condition, severity, SuiteCell(log, pipeline, name, request.rate, request.seed, whole))


def with_severity(condition: str, severity: str) -> str:
    """Return a condition with a severity for each of its parts; one that says itself how strong it is stays."""
    return condition if not severity else "+".join(f"{part}:{severity}" for part in condition.split("+"))


def results_of(suite: RobustSuite, done: Sequence[tuple[RobustCell, CellResult]]) -> Results:
    """Put all runs together into tables. Raises MetricError where a run can't be scored."""
    cells = [
        Cell(
            short_name(cell.request.pipeline), cell.condition, cell.severity, cell.log,
            Run(result.folder) if result.has_run else None, result.reason or "",
        )
        for cell, result in done
    ]  # fmt: skip
    options = suite.requests[0].scoring
    matrix = Matrix(cells, options, Bootstrap(num=suite.resamples))
    tables = matrix_tables(matrix, suite.baseline)
    facts = [
        ("command", suite.command),
        ("logs", ", ".join(dict.fromkeys(cell.log for cell, _ in done))),
        ("pipelines", ", ".join(matrix.pipelines)),
        ("seed", str(suite.requests[0].seed)),
        ("frames", str(sum({c.log: len(c.run.frames) for c in cells if c.run is not None}.values()))),
        ("versions", ", ".join(f"{name} {version}" for name, version in package_versions().items())),
    ]
    problems = [f"left out: {what}: {why}" for what, why in suite.left_out.items()]
    problems += [
        f"failed: {cell.name} of {cell.request.pipeline} on {cell.log}: {result.reason}"
        for cell, result in done if not result.has_run
    ]  # fmt: skip
    outages = _outage_table(matrix, cells)
    tables = (*tables, *([outages] if outages.lines else []))
    return Results("Robustness", tuple(facts), tables, (), tuple(problems), severity_curves(matrix))


def _outage_table(matrix: Matrix, cells: Sequence[Cell]) -> ResultTable:
    """How long tracks take to be as good again after sensors were away, by condition and pipeline."""
    clear = {(cell.pipeline, cell.log): cell.run for cell in cells if cell.condition == CLEAR}
    outages: dict[tuple[str, str], dict[str, list[Outage]]] = {}
    for cell in cells:
        base = clear.get((cell.pipeline, cell.log))
        if "dropout" in cell.condition and base is not None and cell.run is not None:
            found = find_outages(base, cell.run, matrix.options)
            outages.setdefault((cell.condition, cell.severity), {}).setdefault(cell.pipeline, []).extend(found)
    lines = []
    for (condition, severity), own in sorted(outages.items()):
        figures = tuple(
            mean_recovery(own[name], matrix.how) if name in own else Figure(None, "no run") for name in matrix.pipelines
        )
        lines.append(Line(f"{condition} {severity}", "", figures))
    columns = tuple(Column(pipeline, "ms") for pipeline in matrix.pipelines)
    note = (
        "From the last frame without the sensor to the first of three frames whose tracks have 95 % of their F1 in "
        f"clear weather; the mean over outages. From {LEAST_UNITS} outages on, in brackets: an interval over them."
    )
    return ResultTable("recovery", "Recovery after a sensor is back, ms", columns, tuple(lines), (note,))


def is_lossy(done: Sequence[tuple[RobustCell, CellResult]]) -> bool:
    """Tell whether a cell failed."""
    return any(not result.has_run for _, result in done)
