"""The city's experiment: logs, pipelines, and results."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.api.replays import short_name
from fbench.api.suites.cells import CellResult
from fbench.api.suites.logs import Drive
from fbench.api.suites.suite import SuiteCell, SuitePipeline
from fbench.datasets.city.rig import thesis_rig
from fbench.replay.data.scores import Results, ResultTable, ScoreOptions, format_count
from fbench.replay.runs.folder import Run
from fbench.replay.runs.host import describe_host
from fbench.replay.runs.manifest import package_versions
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import NO_CONFIG, LogRequest

if TYPE_CHECKING:
    from fbench.metrics.robustness.scenes import ScoredRun

CLEAR = "clear"
KINDS = ("camera", "lidar", "radar")


REGIONS = ("road", "sidewalk")
"""What alone counts in the thesis (9.3.3)."""
DISTURBED_S = 2.0
"""Length of the drives that are disturbed: from the beginning of those in clear weather."""
NUM_DISTURBED = 3  # Seeds of which drives are disturbed, in both worlds: six scenes
RENDERED = ("dusk", "low-sun")
"""Light that the city simulates; the other disturbances act on the messages of clear drives."""
DISTURBANCES: Mapping[str, str] = {
    "glare": "camera.glare:3",
    **{f"{kind} lost": f"loss.{kind}:100%@1s-" for kind in KINDS},
    **{f"{kind} away": f"loss.{kind}:100%@0.5s-1.5s" for kind in KINDS},
    "lidar late": "delay.lidar:100ms",
}
"""What replays take, by the name of the column: a sensor is lost from half of the drive on, or away for 1 s."""


@dataclass(frozen=True)
class ExperimentCell:
    """One drive through one pipeline, disturbed or not."""

    drive: Drive
    row: SuitePipeline
    request: ReplayRequest
    disturbance: str = ""
    """Its name; `clear` for what disturbed runs are compared with, empty in the rest of the experiment."""

    @property
    def name(self) -> str:
        """Of the pipeline, as tables have it."""
        return row_name(self.row)


Done = Sequence[tuple[ExperimentCell, CellResult]]


def row_name(row: SuitePipeline) -> str:
    """Return a pipeline's name as tables have it: `thesis/late3d`, or what the suite calls one with other settings."""
    if short_name(row.base) == row.name:
        return row.base
    return row.name.replace("thesis-", "thesis/", 1)


@dataclass(frozen=True)
class Experiment:
    """Every drive through every pipeline, and some drives disturbed."""

    drives: tuple[Drive, ...]
    pipelines: tuple[SuitePipeline, ...]
    folder: Path
    command: str  # That does it again
    content: str = ""  # Of the suite file, where there is one
    disturbed: tuple[Drive, ...] = ()  # In clear weather, of which the beginning is disturbed
    rendered: tuple[Drive, ...] = ()  # In other light, as long as that beginning
    scoring: ScoreOptions = field(default_factory=ScoreOptions)
    left_out: tuple[str, ...] = ()  # What these drives can't show, and why

    @property
    def conditions(self) -> list[str]:
        """In the order in which they first come."""
        return list(dict.fromkeys(drive.condition for drive in self.drives))

    @property
    def disturbances(self) -> list[str]:
        """Clear and all that is compared with it on the disturbed drives; none where there are no such drives."""
        light = dict.fromkeys(drive.condition for drive in self.rendered)
        return [CLEAR, *light, *DISTURBANCES] if self.disturbed else []

    def cells(self) -> list[ExperimentCell]:
        """Return all cells, drive by drive; only the runs that the report shows keep pictures."""
        return [
            *(self._cell(drive, row) for drive in self.drives for row in self.pipelines),
            *(self._cell(drive, row, drive.condition) for drive in self.rendered for row in self._detecting),
            *(self._cell(drive, row, name) for drive in self.disturbed for name in (CLEAR, *DISTURBANCES)
              for row in self._detecting if name == CLEAR or uses(row, DISTURBANCES[name])),
        ]  # fmt: skip

    @property
    def _shown(self) -> Drive | None:
        return next((drive for drive in self.drives if drive.condition == CLEAR), None)

    @property
    def _detecting(self) -> list[SuitePipeline]:
        """Rows whose detections aren't those of another: the filter of tracks alone doesn't change F1."""
        return [row for row in self.pipelines if not row.name.endswith("-filter")]

    def _cell(self, drive: Drive, row: SuitePipeline, disturbance: str = "") -> ExperimentCell:
        injected = bool(disturbance) and drive.condition == CLEAR
        name = f"{drive.name}-{disturbance.replace(' ', '-')}-{DISTURBED_S:g}s" if injected else drive.name
        return ExperimentCell(drive, row, ReplayRequest(
            # A configuration that somebody writes beside the logs is for other logs of theirs.
            LogRequest(drive.log, config=NO_CONFIG), row.base, list(row.settings), row.detect_every,
            list(row.sensors), to=f"{DISTURBED_S:g}" if injected else None,
            condition=DISTURBANCES.get(disturbance, "") if injected else "",
            out=self.folder / name / row.name, overwrite=True, scoring=self.scoring,
            no_media=bool(disturbance) or drive != self._shown,
        ), disturbance)  # fmt: skip

    def name_cells(self, done: Done) -> list[tuple[SuiteCell, CellResult]]:
        """Return the cells as a suite names them; the beginning of a drive is a log of its own."""
        return [
            (SuiteCell(f"{cell.drive.name}{f'-{DISTURBED_S:g}s' if result.cell.to else ''}", cell.row.name,
                       result.cell.condition or CLEAR, "max", 0, result.cell), result)
            for cell, result in done
        ]  # fmt: skip


_USES: Mapping[str, tuple[str, ...]] = {
    "camera": ("camera",), "lidar": ("lidar",), "radar": ("radar",), "stereo": ("camera",),
}  # fmt: skip


def uses(row: SuitePipeline, condition: str) -> bool:
    """Tell whether a pipeline of an experiment uses the kind of sensor that a condition disturbs."""
    own = next((kinds for start, kinds in _USES.items() if row.base.rpartition("/")[2].startswith(start)), tuple(KINDS))
    return any(kind in condition for kind in own)


def results_of(experiment: Experiment, done: Done) -> Results:
    """Put all runs together into the thesis's tables."""
    from fbench.metrics import experiment as tables
    from fbench.metrics.latency import count_frames, warm_up_frames

    runs = [(cell, Run(result.folder)) for cell, result in done if result.has_run]
    main, other = ([(cell, run) for cell, run in runs if bool(cell.disturbance) == part] for part in (False, True))
    scored, conditions = [_score(cell, run) for cell, run in main], experiment.conditions
    accuracy = tables.accuracy_table(scored)
    shown = [
        accuracy, tables.robustness_table(scored, conditions), tables.gain_table(scored, conditions),
        tables.condition_table(scored, conditions),
    ]  # fmt: skip
    if experiment.disturbed:
        shown.append(_disturbance_table(experiment, other))
    options = [replace(experiment.scoring, regions=_regions_of(run)) for _, run in main]
    if main and all(own.regions for own in options):
        near = [_score(cell, run, own) for (cell, run), own in zip(main, options, strict=True)]
        shown += [
            tables.accuracy_table(near, region=True), tables.robustness_table(near, conditions, region=True),
            tables.gain_table(near, conditions, region=True), tables.condition_table(near, conditions, region=True),
        ]  # fmt: skip
    timings: dict[str, list[dict[str, list[int]]]] = {line.name: [] for line in accuracy.lines}
    for cell, run in main:
        if cell.drive.condition == CLEAR:
            cold = warm_up_frames(run.frame_times, run.compiled_frames)
            timings[cell.name].append(count_frames(run.frame_times, cold))
    host, facts, problems = describe_host(), tuple(_facts(experiment, runs)), tuple(_problems(experiment, done, runs))
    where = f"{host['cpu']}, {host['cores']} cores"
    note = f"Wall time on {where}; other replays may have run beside it, and it differs from run to run."
    measured = replace(tables.latency_table(timings), notes=(note,))
    return Results("The simulated city as an experiment", facts, tuple(shown), (measured,), problems)


def _score(cell: ExperimentCell, run: Run, options: ScoreOptions | None = None) -> "ScoredRun":
    """The scores of a run, as it has them or by other options."""
    from fbench.metrics.robustness.scenes import ScoredRun, score_vehicles

    own = cell.disturbance or cell.drive.condition
    scores = run.scores if options is None else score_vehicles(run, options, tracks=own == CLEAR)
    return ScoredRun(cell.name, own, cell.drive.scene, scores)


def _regions_of(run: Run) -> tuple[str, ...]:
    """Which of the thesis's regions a run's log has: beside a highway there is no sidewalk."""
    kinds = {region.kind for region in run.manifest.log_info.regions}
    return tuple(kind for kind in REGIONS if kind in kinds)


def _disturbance_table(experiment: Experiment, runs: Sequence[tuple[ExperimentCell, Run]]) -> ResultTable:
    """Table 9.5 for other disturbances; what doesn't use a disturbed sensor has the scores of the clear drive."""
    from fbench.metrics.experiment import disturbance_table

    scored = [_score(cell, run) for cell, run in runs]
    unused = {(row_name(row), name) for row in experiment.pipelines for name, text in DISTURBANCES.items()
              if not uses(row, text)}  # fmt: skip
    scored += [
        replace(run, condition=name) for run in scored if run.condition == CLEAR for name in DISTURBANCES
        if (run.configuration, name) in unused
    ]  # fmt: skip
    acting = "; ".join(f"{name} is {text}" for name, text in DISTURBANCES.items())
    notes = (
        f"The first {DISTURBED_S:g} s of {format_count(len(experiment.disturbed), 'drive')} in clear weather.",
        f"{' and '.join(RENDERED)} are simulated; the others act on the messages: {acting}.",
        "What is late arrives after its frame has been released (time-out 30 ms), so it counts as missing throughout.",
        "A pipeline that doesn't use the disturbed sensor has the scores of the clear drive.",
    )
    return disturbance_table(scored, experiment.disturbances, notes)


def runs_to_show(done: Done) -> list[Run]:
    """Return the runs of the first drive in clear weather, for a report."""
    clear = [
        (cell.drive, result) for cell, result in done
        if result.has_run and cell.drive.condition == CLEAR and not cell.disturbance
    ]  # fmt: skip
    return [Run(result.folder) for drive, result in clear if drive == clear[0][0]]


def is_lossy(done: Done) -> bool:
    """Tell whether a cell failed, or lost data."""
    failed = any(result.state == "failed" for _, result in done)
    return failed or any(not Run(result.folder).manifest.complete for _, result in done if result.has_run)


def _facts(experiment: Experiment, runs: Sequence[tuple[ExperimentCell, Run]]) -> Iterator[tuple[str, str]]:
    from fbench.datasets.city.request import TRAINING_SEEDS

    drives = experiment.drives
    worlds = list(dict.fromkeys(drive.spec.world for drive in drives))
    seeds = {world: sorted({drive.spec.seed for drive in drives if drive.spec.world == world}) for world in worlds}
    yield "command", experiment.command
    yield "logs", f"{len(drives)}: {', '.join(worlds)}; {', '.join(experiment.conditions)}"
    yield "length", f"{', '.join(dict.fromkeys(f'{drive.spec.seconds:g} s' for drive in drives))} each"
    yield "seeds", "; ".join(f"{world} {', '.join(map(str, own))}" for world, own in seeds.items())
    yield "sensors", ", ".join(dict.fromkeys(name for drive in drives for name in drive.spec.rig.names))
    detectors: dict[str, None] = {}
    for _, run in runs:
        weights = run.manifest.parameters.get("camera.weights")
        if isinstance(weights, dict):
            detectors[f"{weights.get('file')} (sha256 {str(weights.get('sha256'))[:12]})"] = None
        elif any("no weights" in frame.missing.values() for frame in run.frames):
            detectors["none (no weights)"] = None
    yield "camera detector", "; ".join(detectors) or "none"
    # Figures of a detector on what it learned from are better than others, and must say so.
    if learned := sorted({drive.spec.seed for drive in drives} & set(TRAINING_SEEDS)):
        yield "seeds that fbench's own camera detector learned from", ", ".join(map(str, learned))
    frames = [frame for _, run in runs for frame in run.frames]
    num = {cell.drive.name: len(run.frames) for cell, run in runs if not cell.disturbance}
    num_labeled = sum(frame.truth_stamp_ns is not None for frame in frames)
    share = f"{100 * num_labeled / len(frames):.1f} %" if frames else "none"
    pipelines = len({cell.name for cell, _ in runs})
    yield (
        "frames",
        f"{sum(num.values())}, each through {format_count(pipelines, 'pipeline')}; {share} of outputs had truth",
    )
    yield "versions", ", ".join(f"{name} {version}" for name, version in package_versions().items())


def _problems(experiment: Experiment, done: Done, runs: Sequence[tuple[ExperimentCell, Run]]) -> Iterator[str]:
    yield from (f"left out: {what}" for what in experiment.left_out)
    unfit = {cell.name: (cell.drive, result.reason) for cell, result in done if result.state == "unfit"}
    for pipeline, (drive, reason) in unfit.items():
        absent = [name for name in thesis_rig().names if name not in drive.spec.rig.names]
        cause = f"the drives are without {', '.join(absent)}, see --sensors; " if absent else ""
        yield f"left out: {pipeline} ({cause}{reason})"
    failed: dict[str | None, list[str]] = {}
    for cell, result in done:
        if result.state == "failed":
            failed.setdefault(result.reason, []).append(f"{cell.name} on {cell.drive.name}")
    for why, cells in failed.items():
        others = f" and {len(cells) - 1} more" if len(cells) > 1 else ""
        yield f"failed: {cells[0]}{others}: {why}"
    missing = Counter(
        (cell.name, sensor, reason.partition(" by ")[0])
        for cell, run in runs if not cell.disturbance
        for frame in run.frames for sensor, reason in frame.missing.items()
    )  # fmt: skip
    for (pipeline, sensor, reason), num in sorted(missing.items()):
        yield f"missing: {sensor} ({reason}) in {format_count(num, 'frame')} of {pipeline}"
    for cell, run in runs:
        if not run.manifest.complete:
            yield f"incomplete: {cell.name} on {cell.drive.name} lost data"
