"""`fbench score`."""

import sys

import typer

from fbench.replay.cli.log_options import Config, DetectionsFile, TruthFile, TruthFormat, TruthFrame
from fbench.replay.cli.options import DistanceM, InterpolateTruth, InView, Iou, Json, MinCoverage, RangeM
from fbench.replay.cli.score_options import (
    Class,
    DetectionsFormat,
    Explain,
    Intervals,
    Match,
    Missing,
    Out,
    Profile,
    Region,
    Runs,
    Seed,
    Seen,
    Seqmap,
    Sequences,
)  # fmt: skip


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
    from fbench.replay.cli.score_wish import ProfileWish, Resampling, require_fitting
    from fbench.replay.scores import ScoreOptions, region_kinds

    given = {name for name in context.params if str(context.get_parameter_source(name)).endswith("COMMANDLINE")}
    require_fitting(given, len(runs or ()))
    resampling = Resampling(intervals, seed)
    if resampling.is_rough:
        sys.stderr.write(f"--intervals {intervals}: so few resamples tell the ends only roughly; 1000 are usual\n")
    wish = ProfileWish("default" if profile is None else profile, match, tuple(class_ or ()), out, json, resampling)
    if not runs:
        from fbench.replay.cli.score_files import FileWish, score_files

        files = FileWish(truth, detections, truth_format, detections_format, sequences, seqmap, missing)
        raise typer.Exit(score_files(files, wish))
    if profile is not None:
        from fbench.replay.cli.score_profile import score_runs_by

        raise typer.Exit(score_runs_by(runs, wish, min_coverage))
    from fbench.replay.cli.score_again import OtherTruth, score_again
    from fbench.replay.cli.score_together import score_together

    options = ScoreOptions(range_m, in_view, distance_m, iou, region_kinds(region), seen)
    if explain is not None:
        from fbench.replay.cli.explain import explain_run

        raise typer.Exit(explain_run(runs[0], options, explain, wish.only_class("vehicle"), json))
    if len(runs) > 1:
        raise typer.Exit(score_together(runs, options, wish.resampling.how(), out, json))
    other = OtherTruth(truth, truth_format, truth_frame, interpolate_truth, config)
    raise typer.Exit(score_again(runs[0], options, other, min_coverage, wish))
