"""`fbench score`."""

import typer

from fbench.replay.cli.options import DistanceM, InView, Iou, Json, RangeM, RunFolder


def score(
    run: RunFolder,
    range_m: RangeM = 50.0,
    in_view: InView = True,
    distance_m: DistanceM = 2.0,
    iou: Iou = 0.5,
    json: Json = False,
) -> None:
    """Score a run again from its folder, without replaying the log."""
    from fbench.replay.cli.run_summary import open_run, show_run
    from fbench.replay.cli.scoring import score_folder
    from fbench.replay.errors import EXIT_LOSSY, EXIT_OK, RunError
    from fbench.replay.scores import ScoreOptions

    opened = open_run(run)
    if all(frame.truth_stamp_ns is None for frame in opened.frames):
        strays = next(row["count"] for row in opened.json("faults.json")["rows"] if row["code"] == "GT006")
        why = f"none of its {strays} truths belongs to a frame" if strays else "the log has no truth"
        raise RunError(f"{run}: {why}, so there is nothing to score")
    scored = score_folder(opened.folder, ScoreOptions(range_m, in_view, distance_m, iou))
    show_run(scored, json)
    raise typer.Exit(EXIT_OK if scored.manifest.complete else EXIT_LOSSY)
