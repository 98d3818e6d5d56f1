"""Scoring of run folders and of results of other systems, from requests."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import add
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.replay.contracts.entry_points import entry_points_of, load
from fbench.replay.contracts.errors import ConfigError, MetricError, RunError, did_you_mean
from fbench.replay.contracts.faults import FAULTS, FaultLog
from fbench.replay.data.files import replace_text
from fbench.replay.data.scores import Score, ScoreOptions, save_scores

if TYPE_CHECKING:  # runs and truth take a while to import, which scores of files needn't
    from fbench.metrics.core.bootstrap import Bootstrap
    from fbench.replay.contracts.profiles import Headlines
    from fbench.replay.contracts.protocols import Metric
    from fbench.replay.logs.setup import BoxSource
    from fbench.replay.runs.folder import Run

FEWEST_RESAMPLES, MOST_RESAMPLES = 20, 100_000
"""Of fewer resamples the ends of 95 % are extremes of a handful; more take hours and memory and say nothing new."""
_USUAL_RESAMPLES = 100
OWN_PROFILE = "default"
LATENCY = "latency.json"
IN_LOCKSTEP = "lockstep"
"""Folder in that of a run with latency: the same replay without."""


@dataclass(frozen=True)
class Resampling:
    """Bootstrap resamples for confidence intervals."""

    intervals: int = 0
    """Number of resamples; 0: no intervals."""
    seed: int = 0

    def __post_init__(self) -> None:
        if self.intervals and not FEWEST_RESAMPLES <= self.intervals <= MOST_RESAMPLES:
            raise ConfigError(
                f"--intervals {self.intervals}: expected {FEWEST_RESAMPLES} to {MOST_RESAMPLES}, such as 1000"
            )

    @property
    def is_rough(self) -> bool:
        """Whether so few resamples give only rough limits."""
        return 0 < self.intervals < _USUAL_RESAMPLES

    def bootstrap(self) -> "Bootstrap | None":
        """Return how to resample; `None`: no intervals."""
        if not self.intervals:
            return None
        from fbench.metrics.core.bootstrap import Bootstrap

        return Bootstrap(self.seed, self.intervals)


@dataclass(frozen=True)
class ScoreRequest:
    """Scoring of runs."""

    runs: Sequence[Path]
    """One run folder, or several of one pipeline that are scored together."""
    options: ScoreOptions = field(default_factory=ScoreOptions)
    """Which boxes count and match, unless a profile says so."""
    profile: str | None = None
    """Whose way to count, see `fbench plugins profiles`; `None`: the runs' own scores."""
    match: str | None = None
    """What matches in the profile: `iou3d:0.25` ..."""
    classes: Sequence[str] = ()
    """Of a profile: only these; empty: all."""
    truth: "BoxSource | None" = None
    """Other truth for a single run, which replaces its own."""
    interpolate_truth_ms: float = 0.0
    config: str | None = None
    """`fbench.toml` with the classes of `truth`."""
    resampling: Resampling = field(default_factory=Resampling)

    def __post_init__(self) -> None:
        if not self.runs:
            raise ConfigError("what is to be scored? give a RUN folder, or --truth PATH and --detections PATH")
        if self.profile is not None:
            _require_name(self.profile)
        if self.truth is None and self.config is not None:
            raise ConfigError("--config gives the classes of --truth PATH, which is missing")
        if self.truth is None and self.interpolate_truth_ms:
            raise ConfigError(
                "--interpolate-truth is about --truth PATH, which is missing; for the log's own truth, replay with it"
            )


@dataclass(frozen=True)
class FileScoreRequest:
    """Scoring of results in files against truth in files."""

    truth: Path
    detections: Path
    truth_format: str | None = None
    detections_format: str | None = None
    sequences: str | None = None
    """Names with commas between; `None`: all."""
    seqmap: Path | None = None
    missing: str = "error"
    """What sequences without results are: an `error` or `empty`."""
    profile: str = OWN_PROFILE
    match: str | None = None
    classes: Sequence[str] = ()
    resampling: Resampling = field(default_factory=Resampling)

    def __post_init__(self) -> None:
        _require_name(self.profile)


def _require_name(profile: str) -> None:
    if not profile:
        raise ConfigError("--profile: names no profile; see fbench plugins profiles")


@dataclass(frozen=True, eq=False)
class ScoreResult:
    """Scores, and what there is to say about them."""

    rows: Sequence[Score]
    title: str
    """What was scored."""
    profile: str | None = None
    """`None`: the runs' own scores."""
    sequences: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    complete: bool = True
    """Whether no data was lost."""
    headlines: "Headlines | None" = None
    """Of the profile: which metrics people look for."""


def score(request: ScoreRequest) -> ScoreResult:
    """Score runs: a single run's own scores are written into its folder; all else leaves the folders as they are.
    Raises ConfigError where a folder isn't there, or options don't fit together. Raises RunError where a folder is no
    run, or nothing in it has truth. Raises MetricError where the runs can't be scored by the profile.
    """
    runs = [open_folder(folder) for folder in request.runs]
    if request.profile is not None:
        return _score_by_profile(runs, request)
    return _score_again(runs[0], request) if len(runs) == 1 else _score_together(runs, request)


def score_files(request: FileScoreRequest) -> ScoreResult:
    """Score results of another system, from files. Raises FbenchError where they can't be scored."""
    from fbench.metrics.files.sequences import MISSING, Choice, open_files
    from fbench.metrics.profiles.choose import choose_profile, evaluate, fit_profile, only, space_to_compare
    from fbench.metrics.profiles.remarks import Remarks

    profile = choose_profile(request.profile, request.match)
    formats = request.truth_format, request.detections_format
    missing = next((known for known in MISSING if known == request.missing), None)
    if missing is None:
        near = did_you_mean(request.missing, MISSING)
        raise ConfigError(f"--missing {request.missing}: expected error or empty{near}")
    names = tuple(name.strip() for name in (request.sequences or "").split(",") if name.strip())
    if request.sequences is not None and not names:
        raise ConfigError("--sequences: names no sequence")
    choice = Choice(names, request.seqmap, missing)
    pair = open_files(request.truth, request.detections, choice, *formats)
    profile = fit_profile(profile, pair, request.match is not None)
    remarks = Remarks(profile, str(request.detections), str(request.truth))
    result = evaluate(profile, remarks.watch(pair.sequences(space_to_compare(profile))))
    remarks.require_tracks()
    rows = only(result.scores(request.resampling.bootstrap()), tuple(request.classes))
    odd = [f"{request.detections}: {line}" for line in pair.warnings.lines()]
    faults = [_describe_fault(pair.faults, code, num) for code, num in sorted(pair.faults.counts.items())]
    warnings, found = (*pair.notes, *odd, *remarks.lines(), *faults), tuple(result.statistics)
    title, headlines = f"{request.detections} against {request.truth}", profile.facts.headlines
    return ScoreResult(rows, title, profile.name, found, warnings, not pair.faults.num_lost, headlines)


def open_folder(folder: Path) -> "Run":
    """Return the run in a folder. Raises ConfigError where there is no such folder. Raises RunError where it isn't a
    run.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such run folder")
    from fbench.replay.runs.folder import Run

    run = Run(folder)
    _ = run.manifest
    return run


def open_folders(folders: Sequence[Path | str]) -> "list[Run]":
    """Return the runs in folders. Raises as `open_folder`, and where none is named."""
    if not folders:
        raise ConfigError("expected at least one run folder, got none")
    return [open_folder(Path(folder)) for folder in folders]


def score_folder(
    folder: Path, options: ScoreOptions, how: "Bootstrap | None" = None, budget_ms: float | None = None
) -> "Run":
    """Write `scores.json`, `criticality.json`, `details.json`, `outcomes.parquet` and `latency.json` into a run folder
    and return the run. Where the pipeline needed time, the same replay in lockstep, which is kept inside, is scored
    first, and streaming scores are written, too.

    Args:
        folder: Of the run.
        options: How boxes match, and which count.
        how: Resamples for confidence intervals of the scores; none by default.
        budget_ms: Time that a frame may take; `None`: as before, else 100.
    """
    from fbench.metrics.criticality.metric import find_critical_errors
    from fbench.metrics.latency import BUDGET_MS, summarize
    from fbench.metrics.runs.combine import score_run
    from fbench.metrics.runs.details import find_details
    from fbench.metrics.runs.outcomes import outcomes_of
    from fbench.metrics.runs.places import SharedRun
    from fbench.replay.data.criticality import save_critical_errors
    from fbench.replay.data.details import save_details
    from fbench.replay.runs.folder import Run
    from fbench.replay.runs.outcomes import save_outcomes

    run = SharedRun(folder)
    scores = score_run(run, options, _make_metrics())
    if how is not None:
        from fbench.metrics.runs.scoring import intervals_of_run

        scores = intervals_of_run(run, options, scores, how)
    if run.manifest.latency is not None:
        from fbench.metrics.runs.streaming import score_streaming

        scores += score_streaming(run, options, score_folder(folder / IN_LOCKSTEP, options).scores)
    times, budget = run.times, budget_ms or _read_budget_ms(run) or BUDGET_MS
    table = summarize(times.stages, times.compiled_frames, times.clock, budget, times.cpu, times.outside)
    latency = json.dumps(table, indent=1, allow_nan=False) + "\n"
    save_scores(folder / "scores.json", scores)
    save_critical_errors(folder, find_critical_errors(run, options))
    save_details(folder, find_details(run, options))
    save_outcomes(folder, outcomes_of(run, options))
    replace_text(folder / LATENCY, latency)
    return Run(folder)


def _read_budget_ms(run: "Run") -> float | None:
    """Return the budget that a run was measured against; `None` where it says none that makes sense."""
    try:
        given = float(run.json(LATENCY)["budget_ms"])
    except (RunError, LookupError, TypeError, ValueError):
        return None
    return given if 0 < given < math.inf else None


def _make_metrics() -> "list[Metric]":
    return [load("metrics", name)() for name in entry_points_of("metrics")]


def require_truth(run: "Run") -> None:
    """Refuse a run in which nothing can be scored. Raises RunError where none of its frames has truth."""
    if all(frame.truth_stamp_ns is None for frame in run.frames):
        strays = next(row["count"] for row in run.json("faults.json")["rows"] if row["code"] == "GT006")
        why = f"none of its {strays} truths belongs to a frame" if strays else "the log has no truth"
        raise RunError(f"{run.folder}: {why}, so there is nothing to score")


def _score_again(run: "Run", request: ScoreRequest) -> ScoreResult:
    from fbench.replay.runs.folder import Run

    warnings: tuple[str, ...] = ()
    if request.truth is not None:
        from fbench.replay.setup.source import classes_of
        from fbench.replay.truth.relabel import relabel
        from fbench.replay.truth.times import make_max_between_ns

        max_between_ns = make_max_between_ns(request.interpolate_truth_ms)
        found = relabel(run, request.truth, classes_of(request.config), max_between_ns)
        if run.manifest.latency is not None:
            relabel(Run(run.folder / IN_LOCKSTEP), request.truth, classes_of(request.config), max_between_ns)
        labeled = f"{found.num_matched} of {run.manifest.num_frames} frames"
        labeled += f", {found.num_between} of them by interpolation" if found.num_between else ""
        warnings = (f"truth: {request.truth.path.name} has {found.num_truths} instants and labels {labeled}",)
        run = Run(run.folder)
    require_truth(run)
    scored = score_folder(run.folder, request.options, request.resampling.bootstrap())
    return ScoreResult(scored.scores, str(run.folder), warnings=warnings, complete=scored.manifest.complete)


def _score_together(runs: "Sequence[Run]", request: ScoreRequest) -> ScoreResult:
    """Add the counts of several runs, one in memory at a time."""
    from fbench.metrics.runs.combine import combine_runs, describe_gaps, measure_run
    from fbench.replay.runs.folder import Run

    complete = all(run.manifest.complete for run in runs)
    metrics = _make_metrics()
    measured = [measure_run(run, request.options, metrics=metrics) for run in runs]
    rows, warnings = combine_runs(measured, request.resampling.bootstrap()), describe_gaps(measured)
    latencies = list(dict.fromkeys(str(run.manifest.latency or "none") for run in runs))
    if len(latencies) > 1:
        warnings.append(f"runs differ in latency ({'; '.join(latencies)}), so they have no streaming scores together")
    elif runs[0].manifest.latency is not None:
        from fbench.metrics.runs.streaming import measure_streaming

        tables = (measure_streaming(run, Run(run.folder / IN_LOCKSTEP), request.options) for run in runs)
        rows += reduce(add, tables).rows()
    return ScoreResult(rows, f"{len(runs)} runs together", warnings=tuple(warnings), complete=complete)


def _score_by_profile(runs: "Sequence[Run]", request: ScoreRequest) -> ScoreResult:
    from fbench.metrics.profiles.choose import choose_profile, evaluate, only, run_sequence
    from fbench.metrics.profiles.default import DefaultProfile
    from fbench.metrics.profiles.remarks import Remarks
    from fbench.replay.contracts.profiles import Match

    match = None if request.match is None else Match.parse(request.match)
    warnings: Sequence[str]
    profile, sequences = choose_profile(request.profile or OWN_PROFILE, request.match), tuple[str, ...]()
    title, how = ", ".join(str(run.folder) for run in runs), request.resampling.bootstrap()
    if isinstance(profile, DefaultProfile):
        from fbench.metrics.runs.scoring import own_rows

        for run in runs:
            require_truth(run)
        rows, warnings = own_rows(runs, match, how)
    else:
        if profile.facts.judges_tracks and not any(run.manifest.has_tracks for run in runs):
            raise MetricError(f"{title}: the pipeline gave no tracks, which {profile.name} judges")
        remarks = Remarks(profile, title)
        result = evaluate(profile, remarks.watch(run_sequence(run, profile, match) for run in runs))
        remarks.require_tracks()
        rows, warnings, sequences = result.scores(how), remarks.lines(), tuple(result.statistics)
    complete = all(run.manifest.complete for run in runs)
    rows, headlines = only(rows, tuple(request.classes)), profile.facts.headlines
    return ScoreResult(rows, title, profile.name, sequences, tuple(warnings), complete, headlines)


def _describe_fault(faults: FaultLog, code: str, num: int) -> str:
    """Describe a fault of files, which have no pipeline that the table of faults speaks of."""
    text = "result is no box, or its score isn't finite" if code == "PRD001" else FAULTS[code].text
    places = faults.places[code]
    others = len(places) - 1
    many = "many" if len(places) == faults.keep else others
    more = f"; {many} more {'place' if others == 1 else 'places'}" if others else ""
    return f"{num} x {text} [{code}]: {places[0]}{more}"
