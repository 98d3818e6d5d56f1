"""`fbench score`."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from fbench.cli.options import (
    Config,
    DetectionsFile,
    DistanceM,
    InterpolateTruth,
    InView,
    Iou,
    Json,
    MinCoverage,
    RangeM,
    TruthFile,
    TruthFormat,
    TruthFrame,
)

Runs = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[RUN]...",
        help="A run folder, or several of one pipeline; without one, --truth and --detections are scored.",
        show_default=False,
    ),
]
DetectionsFormat = Annotated[
    str | None,
    typer.Option("--detections-format", metavar="FORMAT", help="Of --detections, where its content doesn't tell."),
]
Profile = Annotated[
    str | None,
    typer.Option(
        "--profile",
        metavar="NAME",
        help="Whose way to count, see fbench plugins profiles; else 'default', fbench's own.",
    ),
]
Match = Annotated[
    str | None,
    typer.Option("--match", metavar="HOW:NUMBER", help="What matches in the profile: iou3d:0.25, iou2d:0.5, bev:2 ..."),
]
Class = Annotated[list[str] | None, typer.Option("--class", metavar="NAME", help="Only this class; repeatable.")]
Sequences = Annotated[
    str | None, typer.Option("--sequences", metavar="NAMES", help="Of files: only these, with commas between.")
]
Seqmap = Annotated[
    Path | None,
    typer.Option(
        "--seqmap", metavar="FILE", help="Of files: a list of sequences with their lengths, as TrackEval reads it."
    ),
]
Missing = Annotated[
    str, typer.Option("--missing", metavar="WHAT", help="Sequences without a file of results: 'error' or 'empty'.")
]
Out = Annotated[
    Path | None,
    typer.Option(
        "-o", "--out", metavar="FILE", help="Write all rows there, as JSON: of a profile, or of several RUNs."
    ),
]
Region = Annotated[
    str | None,
    typer.Option("--region", metavar="KINDS", help="Only boxes in these regions of the log: road, or road,sidewalk."),
]
Seen = Annotated[
    int,
    typer.Option(
        "--seen",
        metavar="N",
        min=0,
        help="Score only objects that some sensor of the log sees, as its truth tells: with N points of a LiDAR or "
        "radar, such as 1, or in an image.",
    ),
]
Explain = Annotated[
    int | None, typer.Option("--explain", metavar="FRAME", help="What became of each box of this frame, and why.")
]
Intervals = Annotated[
    int,
    typer.Option(
        "--intervals",
        metavar="N",
        min=0,
        help="95 % confidence intervals from N bootstrap resamples, 20 to 100000; such as 1000.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Of the resamples.")]


def score(
    context: typer.Context,
    runs: Runs = None,
    truth: TruthFile = None,
    detections: DetectionsFile = None,
    profile: Profile = None,
    match: Match = None,
    class_: Class = None,
    explain: Explain = None,
    sequences: Sequences = None,
    seqmap: Seqmap = None,
    missing: Missing = "error",
    truth_format: TruthFormat = None,
    detections_format: DetectionsFormat = None,
    truth_frame: TruthFrame = "",
    range_m: RangeM = 50.0,
    in_view: InView = True,
    seen: Seen = 0,
    region: Region = None,
    distance_m: DistanceM = 2.0,
    iou: Iou = 0.5,
    interpolate_truth: InterpolateTruth = 0.0,
    config: Config = None,
    min_coverage: MinCoverage = 0.0,
    intervals: Intervals = 0,
    seed: Seed = 0,
    out: Out = None,
    json: Json = False,
) -> None:
    """Score runs again from their folders, or results of another system from files, without replaying a log."""
    from fbench.cli.score_request import ProfileWish, Resampling, require_fitting
    from fbench.replay.data.scores import ScoreOptions, region_kinds

    given = {name for name in context.params if str(context.get_parameter_source(name)).endswith("COMMANDLINE")}
    require_fitting(given, len(runs or ()))
    resampling = Resampling(intervals, seed)
    if resampling.is_rough:
        sys.stderr.write(f"--intervals {intervals}: so few resamples tell the ends only roughly; 1000 are usual\n")
    wish = ProfileWish("default" if profile is None else profile, match, tuple(class_ or ()), out, json, resampling)
    if not runs:
        from fbench.cli.score_jobs import FileWish, score_files

        files = FileWish(truth, detections, truth_format, detections_format, sequences, seqmap, missing)
        raise typer.Exit(score_files(files, wish))
    if profile is not None:
        from fbench.cli.score_jobs import score_runs_by

        raise typer.Exit(score_runs_by(runs, wish, min_coverage))
    from fbench.cli.score_jobs import OtherTruth, score_again, score_together

    options = ScoreOptions(range_m, in_view, distance_m, iou, region_kinds(region), seen)
    if explain is not None:
        from fbench.cli.explain import explain_run

        raise typer.Exit(explain_run(runs[0], options, explain, wish.only_class("vehicle"), json))
    if len(runs) > 1:
        raise typer.Exit(score_together(runs, options, wish.resampling.how(), out, json))
    other = OtherTruth(truth, truth_format, truth_frame, interpolate_truth, config)
    raise typer.Exit(score_again(runs[0], options, other, min_coverage, wish))
