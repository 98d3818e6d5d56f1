"""Scoring a run folder again, by fbench's own metrics."""

from dataclasses import dataclass
from pathlib import Path

from fbench.replay.cli.coverage_gate import gated
from fbench.replay.cli.log_options import box_source
from fbench.replay.cli.run_summary import open_run, show_run
from fbench.replay.cli.score_wish import ProfileWish
from fbench.replay.cli.scoring import score_folder
from fbench.replay.cli.truth_job import label_run
from fbench.replay.config.source import classes_of
from fbench.replay.errors import EXIT_LOSSY, EXIT_OK, ConfigError, RunError
from fbench.replay.scores import ScoreOptions
from fbench.replay.store import Run
from fbench.replay.truth.times import make_max_between_ns


@dataclass(frozen=True)
class OtherTruth:
    """Truth from a file, instead of the run's own."""

    path: Path | None
    format: str | None
    frame: str
    interpolate_ms: float
    config: str | None
    """Where its classes are explained."""

    def labelled(self, run: Run) -> Run:
        """Return the run with this truth, or as it is where no file is named.

        Raises:
            ConfigError: where an option has no use.
        """
        source = box_source(self.path, self.format, self.frame)
        if source is not None:
            return label_run(run, source, classes_of(self.config), make_max_between_ns(self.interpolate_ms))
        if self.config is not None:
            raise ConfigError("--config gives the classes of --truth PATH, which is missing")
        if self.interpolate_ms:
            raise ConfigError("--interpolate-truth is about --truth PATH, which is missing; for the log's own truth, "
                              "replay with it")  # fmt: skip
        return run


def require_truth(run: Run) -> None:
    """Refuse a run in which nothing can be scored.

    Raises:
        RunError: where none of its frames has truth.
    """
    if all(frame.truth_stamp_ns is None for frame in run.frames):
        strays = next(row["count"] for row in run.json("faults.json")["rows"] if row["code"] == "GT006")
        why = f"none of its {strays} truths belongs to a frame" if strays else "the log has no truth"
        raise RunError(f"{run.folder}: {why}, so there is nothing to score")


def score_again(run: Path, options: ScoreOptions, truth: OtherTruth, min_coverage: float, wish: ProfileWish) -> int:
    """Score a run, with other truth where some is given, print the result, and return the exit code.

    Raises:
        ConfigError: where there is no such run, or --config has no use.
        RunError: where nothing in it has truth.
    """
    opened = truth.labelled(open_run(run))
    require_truth(opened)
    scored = score_folder(opened.folder, options, wish.resampling.how())
    show_run(scored, wish.as_json)
    return gated(scored, min_coverage, EXIT_OK if scored.manifest.complete else EXIT_LOSSY)
