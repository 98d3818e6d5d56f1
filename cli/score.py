"""`fbench score`."""

import os
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from fbench.cli import options
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK, ConfigError, OutputError
from fbench.replay.data.files import make_parent

if TYPE_CHECKING:
    from fbench.api.scores import ScoreRequest

Runs = Annotated[
    list[Path] | None,
    Argument(
        metavar="[RUN]...",
        help="One or more run folders of one pipeline. Without any, score --detections against --truth.",
        show_default=False,
    ),
]
DetectionsFormat = Annotated[
    str | None, Option(metavar="FORMAT", help="Format of --detections if its content doesn't show it.")
]
Profile = Annotated[
    str | None, Option(metavar="NAME", help="Profile whose rules to score by; see `fbench plugins profiles`.")
]
Match = Annotated[
    str | None, Option(metavar="HOW:NUMBER", help="Matching rule of the profile: iou3d:0.25, iou2d:0.5, bev:2 ...")
]
Class = Annotated[list[str] | None, Option("--class", metavar="NAME", help="Only this class; repeatable.")]
Sequences = Annotated[str | None, Option(metavar="NAMES", help="For files: only these sequences, separated by commas.")]
Seqmap = Annotated[
    Path | None, Option(metavar="FILE", help="For files: list of sequences and their lengths, as TrackEval reads it.")
]
Missing = Annotated[str, Option(metavar="WHAT", help="Sequences without a results file: 'error', or 'empty' results.")]
Out = Annotated[
    Path | None,
    Option("-o", "--out", metavar="FILE", help="File for all rows, as JSON: of a profile, or of several RUNs."),
]
Region = Annotated[
    str | None, Option(metavar="KINDS", help="Only boxes in these regions of the log: road, or road,sidewalk.")
]
Seen = Annotated[
    int,
    Option(
        metavar="N",
        min=0,
        help="Score only objects that a sensor of the log sees, as its truth says: with at least N points of a LiDAR "
        "or radar, such as 1, or in an image.",
    ),
]
Explain = Annotated[int | None, Option(metavar="FRAME", help="Explain what became of each box of this frame.")]
Intervals = Annotated[
    int, Option(metavar="N", min=0, help="Add 95% confidence intervals from N bootstrap resamples (20 to 100000).")
]
Control = Annotated[
    list[Path] | None,
    Option(
        metavar="RUN",
        help="Where few frames are labeled: another pipeline's run of the same log, to narrow intervals. Repeatable.",
    ),
]
Seed = Annotated[int, Option(metavar="N", min=0, help="Seed of the resamples.")]


_OF_FILES = ("detections", "detections_format", "sequences", "seqmap", "missing")
_OF_RUNS = ("range_m", "in_view", "distance_m", "iou", "region", "seen")
_OF_OTHER_TRUTH = ("config", "truth_frame", "interpolate_truth_ms")
_TRUTH = ("truth", "truth_format", *_OF_OTHER_TRUTH)
_NOT_OF_CONTROL = (*_OF_RUNS, *_TRUTH, "profile", "min_coverage", "explain", "intervals", "out")
_CALLED = {"interpolate_truth_ms": "--interpolate-truth", "class_": "--class"}  # Others as their parameter
_INSTEAD = {"distance_m": "; use --match bev:M", "iou": "; use --match iou2d:SHARE"}


def score(
    context: typer.Context,
    runs: Runs = None,
    truth: options.TruthFile = None,
    detections: options.DetectionsFile = None,
    profile: Profile = None,
    match: Match = None,
    class_: Class = None,
    explain: Explain = None,
    sequences: Sequences = None,
    seqmap: Seqmap = None,
    missing: Missing = "error",
    truth_format: options.TruthFormat = None,
    detections_format: DetectionsFormat = None,
    truth_frame: options.TruthFrame = "",
    range_m: options.RangeM = 50.0,
    in_view: options.InView = True,
    seen: Seen = 0,
    region: Region = None,
    distance_m: options.DistanceM = 2.0,
    iou: options.Iou = 0.5,
    interpolate_truth_ms: options.InterpolateTruthMs = 0.0,
    config: options.Config = None,
    min_coverage: options.MinCoverage = 0.0,
    intervals: Intervals = 0,
    seed: Seed = 0,
    control: Control = None,
    out: Out = None,
    json: options.Json = False,
) -> None:
    """Score runs again from their folders, or results of another system from files, without replaying a log."""
    from fbench.api.scores import OWN_PROFILE, FileScoreRequest, Resampling, ScoreRequest, score_files
    from fbench.cli.options import box_source
    from fbench.cli.score_show import explain_run, show_controlled, show_profile
    from fbench.replay.data.scores import ScoreOptions, region_kinds

    given = {name for name in context.params if str(context.get_parameter_source(name)).endswith("COMMANDLINE")}
    require_fitting(given, len(runs or ()))
    resampling = Resampling(intervals, seed)
    if resampling.is_rough:
        sys.stderr.write(f"--intervals {intervals}: so few resamples give only rough limits; 1000 are usual\n")
    if out is not None:
        _require_writable(out)
    classes = tuple(class_ or ())
    if not runs and truth is not None and detections is not None:
        files = FileScoreRequest(
            truth, detections, truth_format, detections_format, sequences, seqmap, missing,
            OWN_PROFILE if profile is None else profile, match, classes, resampling,
        )  # fmt: skip
        result = score_files(files)
        show_profile(result, out, json)
        raise typer.Exit(EXIT_OK if result.complete else EXIT_LOSSY)
    if runs and control:
        _refuse(given, _NOT_OF_CONTROL, "doesn't go with --control, which takes runs as they were scored")
        show_controlled(runs, control, json)
        raise typer.Exit(EXIT_OK)
    options = ScoreOptions(range_m, in_view, distance_m, iou, region_kinds(region), seen)
    if runs and explain is not None:
        if len(classes) > 1:
            raise ConfigError(f"--explain is about one class, not {len(classes)}: {', '.join(classes)}")
        explain_run(runs[0], options, explain, classes[0] if classes else "vehicle", json)
        raise typer.Exit(EXIT_OK)
    other = box_source(truth, truth_format, truth_frame)
    request = ScoreRequest(
        runs or (), options, profile, match, classes, other, interpolate_truth_ms, config, resampling
    )
    raise typer.Exit(_score_runs(request, min_coverage, out, json))


def _score_runs(request: "ScoreRequest", min_coverage: float, out: Path | None, as_json: bool) -> int:
    from fbench.api.scores import score as score_runs
    from fbench.cli.run_summary import require_coverage, show_run
    from fbench.cli.score_show import show_profile, show_together
    from fbench.replay.runs.folder import Run

    result = score_runs(request)
    if request.profile is not None:
        show_profile(result, out, as_json)
    elif len(request.runs) > 1:
        show_together(result, request.runs, out, as_json)
    else:
        sys.stderr.writelines(f"{line}\n" for line in result.warnings)
        show_run(Run(request.runs[0]), as_json)
    code = EXIT_OK if result.complete else EXIT_LOSSY
    return require_coverage(Run(request.runs[0]), min_coverage, code) if len(request.runs) == 1 else code


def _require_writable(path: Path) -> None:
    """Refuse what no file can be written to before anything is computed. Raises ConfigError naming the path as the user
    did.
    """
    if path.is_dir():
        raise ConfigError(f"-o {path}: is a folder; name a file in it")
    make_parent(path)
    if not os.access(path.parent, os.W_OK):
        raise OutputError(f"-o {path}: the folder {path.parent} can't be written to")


def require_fitting(given: Collection[str], num_runs: int) -> None:
    """Refuse options that would do nothing: `given` are the names of the parameters that the user gave, with so many
    run folders. Raises ConfigError naming the first such option.
    """
    if "seed" in given and "intervals" not in given:
        raise ConfigError("--seed is for the resamples of --intervals N, which is missing")
    if not num_runs:
        missing = [f"--{name}" for name in ("truth", "detections") if name not in given]
        if missing:
            none = "what is to be scored? give a RUN folder, or --truth PATH and --detections PATH"
            one = f"{missing[0]} PATH is missing: results in files are scored against truth in files"
            raise ConfigError(none if len(missing) == 2 else one)
        _refuse(given, (*_OF_RUNS, *_OF_OTHER_TRUTH, "min_coverage", "explain", "control"), "is for run folders")
        return
    if "detections" in given:
        raise ConfigError("--detections are scored without a RUN: leave out one of them")
    _refuse(given, _OF_FILES, "goes with --truth and --detections, without a RUN")
    if num_runs > 1:
        _refuse(given, (*_TRUTH, "min_coverage", "explain"), f"is for one RUN, not {num_runs}")
    if "profile" in given:
        if "truth" in given:
            why = "--profile takes the truth that the run has; give it other truth first"
            raise ConfigError(f"{why}: fbench score RUN --truth PATH")
        _refuse(given, (*_OF_RUNS, *_TRUTH, "explain"), "doesn't go with --profile")
    elif "explain" in given:
        _refuse(given, (*_TRUTH, "match", "min_coverage", "intervals", "out"), "doesn't go with --explain")
    else:
        _refuse(given, ("match", "class_"), "goes with --profile")
        if num_runs == 1:
            _refuse(given, ("out",), "goes with --profile or several RUNs; a RUN has its own scores.json")


def _refuse(given: Collection[str], names: Sequence[str], why: str) -> None:
    for name in names:
        if name in given:
            option = _CALLED.get(name, f"--{name.replace('_', '-')}")
            raise ConfigError(f"{option} {why}{_INSTEAD.get(name, '')}")
