"""`fbench score`."""

import typer

from fbench.replay.cli.log_options import Config, TruthFile, TruthFormat, TruthFrame
from fbench.replay.cli.options import DistanceM, InView, Iou, Json, RangeM, RunFolder


def score(
    run: RunFolder,
    range_m: RangeM = 50.0,
    in_view: InView = True,
    distance_m: DistanceM = 2.0,
    iou: Iou = 0.5,
    config: Config = None,
    truth: TruthFile = None,
    truth_format: TruthFormat = None,
    truth_frame: TruthFrame = "",
    json: Json = False,
) -> None:
    """Score a run again from its folder, without replaying the log."""
    from fbench.replay.cli.log_options import box_source
    from fbench.replay.cli.run_summary import open_run, show_run
    from fbench.replay.cli.scoring import score_folder
    from fbench.replay.cli.truth_job import label_run
    from fbench.replay.config.source import classes_of
    from fbench.replay.errors import EXIT_LOSSY, EXIT_OK, ConfigError, RunError
    from fbench.replay.scores import ScoreOptions

    opened = open_run(run)
    source = box_source(truth, truth_format, truth_frame)
    if source is None and config is not None:
        raise ConfigError("--config gives the classes of --truth PATH, which is missing")
    if source is not None:
        opened = label_run(opened, source, classes_of(config))
    if all(frame.truth_stamp_ns is None for frame in opened.frames):
        strays = next(row["count"] for row in opened.json("faults.json")["rows"] if row["code"] == "GT006")
        why = f"none of its {strays} truths belongs to a frame" if strays else "the log has no truth"
        raise RunError(f"{run}: {why}, so there is nothing to score")
    scored = score_folder(opened.folder, ScoreOptions(range_m, in_view, distance_m, iou))
    show_run(scored, json)
    raise typer.Exit(EXIT_OK if scored.manifest.complete else EXIT_LOSSY)
