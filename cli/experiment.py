"""The city's experiment: logs, pipelines, and results."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from fbench.api.replays import short_name
from fbench.api.suites.cells import CellResult
from fbench.api.suites.logs import Drive
from fbench.api.suites.suite import SuiteCell
from fbench.datasets.city.rig import thesis_rig
from fbench.replay.data.scores import Results, format_count
from fbench.replay.runs.folder import Run
from fbench.replay.runs.host import describe_host
from fbench.replay.runs.manifest import package_versions
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import NO_CONFIG, LogRequest

CLEAR = "clear"


@dataclass(frozen=True)
class Experiment:
    """Every drive through every pipeline."""

    drives: tuple[Drive, ...]
    pipelines: tuple[str, ...]
    folder: Path
    command: str  # That does it again
    settings: Mapping[str, Sequence[str]] = field(default_factory=dict)  # `NAME=VALUE`, by pipeline
    content: str = ""  # Of the suite file, where there is one

    @property
    def conditions(self) -> list[str]:
        """In the order in which they first come."""
        return list(dict.fromkeys(drive.condition for drive in self.drives))

    def cells(self) -> list[tuple[Drive, ReplayRequest]]:
        """Return all cells, drive by drive; only runs in clear weather keep pictures, so that a report stays small."""
        return [
            (drive, ReplayRequest(
                # A configuration that somebody writes beside the logs is for other logs of theirs.
                LogRequest(drive.log, config=NO_CONFIG), pipeline, list(self.settings.get(pipeline, ())),
                out=self.folder / drive.name / short_name(pipeline), overwrite=True, no_media=drive.condition != CLEAR,
            ))
            for drive in self.drives for pipeline in self.pipelines
        ]  # fmt: skip

    def name_cells(self, done: Sequence[tuple[Drive, CellResult]]) -> list[tuple[SuiteCell, CellResult]]:
        """Return the cells as a suite names them."""
        return [
            (SuiteCell(drive.name, short_name(result.cell.pipeline), CLEAR, "max", 0, result.cell), result)
            for drive, result in done
        ]  # fmt: skip


def results_of(experiment: Experiment, done: Sequence[tuple[Drive, CellResult]]) -> Results:
    """Put all runs together into the thesis's tables."""
    from fbench.metrics.experiment import accuracy_table, condition_table, latency_table, robustness_table
    from fbench.metrics.latency import count_frames, warm_up_frames
    from fbench.metrics.robustness.scenes import ScoredRun

    runs = [(drive, result.cell.pipeline, Run(result.folder)) for drive, result in done if result.has_run]
    scored = [ScoredRun(pipeline, drive.condition, drive.scene, run.scores) for drive, pipeline, run in runs]
    conditions = experiment.conditions
    accuracy = accuracy_table(scored)
    tables = (accuracy, robustness_table(scored, conditions), condition_table(scored, conditions))
    timings: dict[str, list[dict[str, list[int]]]] = {line.name: [] for line in accuracy.lines}
    for drive, pipeline, run in runs:
        if drive.condition == CLEAR:
            cold = warm_up_frames(run.frame_times, run.compiled_frames)
            timings[pipeline].append(count_frames(run.frame_times, cold))
    host, facts, problems = describe_host(), tuple(_facts(experiment, runs)), tuple(_problems(done, runs))
    where = f"{host['cpu']}, {host['cores']} cores"
    note = f"Wall time on {where}; other replays may have run beside it, and it differs from run to run."
    measured = replace(latency_table(timings), notes=(note,))
    return Results("The simulated city as an experiment", facts, tables, (measured,), problems)


def runs_to_show(done: Sequence[tuple[Drive, CellResult]]) -> list[Run]:
    """Return the runs of the first drive in clear weather, for a report."""
    clear = [(drive, result) for drive, result in done if result.has_run and drive.condition == CLEAR]
    return [Run(result.folder) for drive, result in clear if drive == clear[0][0]]


def is_lossy(done: Sequence[tuple[Drive, CellResult]]) -> bool:
    """Tell whether a cell failed, or lost data."""
    failed = any(result.state == "failed" for _, result in done)
    return failed or any(not Run(result.folder).manifest.complete for _, result in done if result.has_run)


def _facts(experiment: Experiment, runs: Sequence[tuple[Drive, str, Run]]) -> Iterator[tuple[str, str]]:
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
    for _, _, run in runs:
        weights = run.manifest.parameters.get("camera.weights")
        if isinstance(weights, dict):
            detectors[f"{weights.get('file')} (sha256 {str(weights.get('sha256'))[:12]})"] = None
        elif any("no weights" in frame.missing.values() for frame in run.frames):
            detectors["none (no weights)"] = None
    yield "camera detector", "; ".join(detectors) or "none"
    # Figures of a detector on what it learned from are better than others, and must say so.
    if learned := sorted({drive.spec.seed for drive in drives} & set(TRAINING_SEEDS)):
        yield "seeds that fbench's own camera detector learned from", ", ".join(map(str, learned))
    frames = [frame for _, _, run in runs for frame in run.frames]
    num = {drive.name: len(run.frames) for drive, _, run in runs}
    num_labeled = sum(frame.truth_stamp_ns is not None for frame in frames)
    share = f"{100 * num_labeled / len(frames):.1f} %" if frames else "none"
    pipelines = len({name for _, name, _ in runs})
    yield (
        "frames",
        f"{sum(num.values())}, each through {format_count(pipelines, 'pipeline')}; {share} of outputs had truth",
    )
    yield "versions", ", ".join(f"{name} {version}" for name, version in package_versions().items())


def _problems(done: Sequence[tuple[Drive, CellResult]], runs: Sequence[tuple[Drive, str, Run]]) -> Iterator[str]:
    unfit = {result.cell.pipeline: (drive, result.reason) for drive, result in done if result.state == "unfit"}
    for pipeline, (drive, reason) in unfit.items():
        absent = [name for name in thesis_rig().names if name not in drive.spec.rig.names]
        cause = f"the drives are without {', '.join(absent)}, see --sensors; " if absent else ""
        yield f"left out: {pipeline} ({cause}{reason})"
    failed: dict[str | None, list[str]] = {}
    for drive, result in done:
        if result.state == "failed":
            failed.setdefault(result.reason, []).append(f"{result.cell.pipeline} on {drive.name}")
    for why, cells in failed.items():
        others = f" and {len(cells) - 1} more" if len(cells) > 1 else ""
        yield f"failed: {cells[0]}{others}: {why}"
    missing = Counter(
        (pipeline, sensor, reason.partition(" by ")[0])
        for _, pipeline, run in runs for frame in run.frames for sensor, reason in frame.missing.items()
    )  # fmt: skip
    for (pipeline, sensor, reason), num in sorted(missing.items()):
        yield f"missing: {sensor} ({reason}) in {format_count(num, 'frame')} of {pipeline}"
    for drive, pipeline, run in runs:
        if not run.manifest.complete:
            yield f"incomplete: {pipeline} on {drive.name} lost data"
