"""Scoring of run folders and of results of other systems."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.cli.options import box_source
from fbench.cli.run_summary import open_run, show_run
from fbench.cli.score_request import ProfileWish
from fbench.cli.score_show import Told, show_scores
from fbench.cli.scoring import score_folder
from fbench.cli.show import console, interval_reasons, null_reasons, print_json, score_table
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_NO, EXIT_OK, ConfigError, RunError
from fbench.replay.contracts.faults import FAULTS, FaultLog
from fbench.replay.data.scores import Score, ScoreOptions, save_scores, score_rows
from fbench.replay.logs.setup import BoxSource
from fbench.replay.runs.folder import Run
from fbench.replay.runs.shares import coverage_of
from fbench.replay.setup.source import classes_of
from fbench.replay.truth.relabel import relabel
from fbench.replay.truth.times import make_max_between_ns

if TYPE_CHECKING:
    from fbench.metrics.files.sequences import Choice


@dataclass(frozen=True)
class FileWish:
    """Which files, and what of them."""

    truth: Path | None
    detections: Path | None
    truth_format: str | None
    detections_format: str | None
    sequences: str | None
    seqmap: Path | None
    missing: str

    def choice(self) -> "Choice":
        """Return what of the files is scored.

        Raises:
            ConfigError: where `missing` is nothing that sequences can be.
        """
        from fbench.metrics.files.sequences import MISSING, Choice
        from fbench.replay.contracts.errors import did_you_mean

        missing = next((known for known in MISSING if known == self.missing), None)
        if missing is None:
            raise ConfigError(f"--missing {self.missing}: expected error or empty{did_you_mean(self.missing, MISSING)}")
        names = tuple(name.strip() for name in (self.sequences or "").split(",") if name.strip())
        if self.sequences is not None and not names:
            raise ConfigError("--sequences: names no sequence")
        return Choice(names, self.seqmap, missing)


def score_files(files: FileWish, wish: ProfileWish) -> int:
    """Score files, print the result, and return the exit code.

    Raises:
        FbenchError: where they can't be scored.
    """
    from fbench.metrics.files.sequences import open_files
    from fbench.metrics.profiles.choose import chosen, compared, fitted, only
    from fbench.metrics.profiles.evaluate import evaluate
    from fbench.metrics.profiles.remarks import Remarks

    if files.truth is None or files.detections is None:
        raise ConfigError("results in files need both --truth PATH and --detections PATH")
    profile = chosen(wish.profile, wish.match)
    pair = open_files(
        files.truth, files.detections, files.choice(), files.truth_format, files.detections_format
    )  # fmt: skip
    for note in pair.pairing.notes:
        sys.stderr.write(f"{note}\n")
    profile = fitted(profile, pair, wish.match is not None)
    remarks = Remarks(profile, str(files.detections), str(files.truth))
    found = evaluate(profile, remarks.watched(pair.sequences(compared(profile))))
    remarks.require_tracks()
    rows = only(found.scores(wish.resampling.how()), wish.classes)
    odd = [f"{files.detections}: {line}" for line in pair.warnings.lines()]
    for line in (*odd, *remarks.lines(), *_told(pair.faults)):
        sys.stderr.write(f"{line}\n")
    what = f"{files.detections} against {files.truth}"
    show_scores(rows, Told(what, profile.name, tuple(found.statistics)), wish)
    return EXIT_LOSSY if pair.faults.lost else EXIT_OK


def _told(faults: FaultLog) -> list[str]:
    return [_line(faults, code, num) for code, num in sorted(faults.counts.items())]


def _line(faults: FaultLog, code: str, num: int) -> str:
    """Files of results have no pipeline, which the table of faults speaks of."""
    text = "result is no box, or its score isn't finite" if code == "PRD001" else FAULTS[code].text
    places = faults.places[code]
    others = len(places) - 1
    more = (
        f"; {'many' if len(places) == faults.keep else others} more place{'' if others == 1 else 's'}" if others else ""
    )
    return f"{num} x {text} [{code}]: {places[0]}{more}"


if TYPE_CHECKING:
    from fbench.metrics.core.bootstrap import Bootstrap


def score_together(
    runs: Sequence[Path], options: ScoreOptions, how: "Bootstrap | None", out: Path | None, as_json: bool
) -> int:
    """Score runs together, one in memory at a time; print the result, write it to `out`, and return the exit code.

    Raises:
        FbenchError: where a folder is no run, pipelines differ, or runs count different boxes.
    """
    from fbench.metrics.runs.combine import combined, measure_run, told_of

    opened = [open_run(folder) for folder in runs]
    complete = all(run.manifest.complete for run in opened)
    measured = [measure_run(run, options) for run in opened]
    rows = combined(measured, how)
    for line in told_of(measured):
        sys.stderr.write(f"{line}\n")
    if out is not None:
        save_scores(out, rows)
    if as_json:
        print_json({"runs": [str(folder) for folder in runs], "scores": score_rows(rows)})
    else:
        shown = console()
        shown.print(f"{len(opened)} runs together", markup=False)
        shown.print(score_table(rows))
        for line in (*null_reasons(rows), *interval_reasons(rows)):
            shown.print(f"– {line}", markup=False)
    return EXIT_OK if complete else EXIT_LOSSY


def gated(run: Run, min_coverage: float, code: int) -> int:
    """Return the exit code of a command that ends with `code`: 1 where all else is good, but less than that share of
    outputs had truth, which a line on stderr says.
    """
    coverage = coverage_of(run)
    if coverage.share >= min_coverage:
        return code
    sys.stderr.write(f"too little truth: {coverage}, fewer than --min-coverage {min_coverage:g} asks for\n")
    return EXIT_NO if code == EXIT_OK else code


def label_run(run: Run, source: BoxSource, classes: Mapping[str, str], max_between_ns: int = 0) -> Run:
    """Replace the truth of a run, say on stderr how much of the file was used, and return the run as it is now."""
    found = relabel(run, source, classes, max_between_ns)
    labelled = f"{found.num_matched} of {run.manifest.num_frames} frames"
    labelled += f", {found.num_between} of them by interpolation" if found.num_between else ""
    sys.stderr.write(f"truth: {source.path.name} has {found.num_truths} instants and labels {labelled}\n")
    return Run(run.folder)


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


if TYPE_CHECKING:
    from fbench.metrics.profiles.catalog import AnyProfile
    from fbench.metrics.profiles.profile import Match


def score_runs_by(runs: Sequence[Path], wish: ProfileWish, min_coverage: float) -> int:
    """Score runs by a profile, print the result, and return the exit code; the runs' own scores stay as they are.

    Raises:
        FbenchError: where they can't be scored.
    """
    from fbench.metrics.profiles.choose import chosen, only
    from fbench.metrics.profiles.default import DefaultProfile
    from fbench.metrics.profiles.profile import Match

    match = None if wish.match is None else Match.parse(wish.match)
    opened, profile = [open_run(folder) for folder in runs], chosen(wish.profile, wish.match)
    is_own = isinstance(profile, DefaultProfile)
    rows, sequences = _own(opened, match, wish) if is_own else _by(profile, opened, match, wish)
    show_scores(only(rows, wish.classes), Told(_named(runs), profile.name, sequences), wish)
    complete = all(run.manifest.complete for run in opened)
    code = EXIT_OK if complete else EXIT_LOSSY
    return gated(opened[0], min_coverage, code) if len(opened) == 1 else code


def _own(runs: Sequence[Run], match: "Match | None", wish: ProfileWish) -> tuple[list[Score], tuple[str, ...]]:
    """What the runs' own scores say."""
    from fbench.metrics.runs.scoring import own_rows

    for run in runs:
        require_truth(run)
    rows, lines = own_rows(runs, match, wish.resampling.how())
    _say(lines)
    return rows, ()


def _by(
    profile: "AnyProfile", runs: Sequence[Run], match: "Match | None", wish: ProfileWish
) -> tuple[list[Score], tuple[str, ...]]:
    """What a benchmark says, and the names of its sequences."""
    from fbench.metrics.profiles.choose import run_sequence
    from fbench.metrics.profiles.evaluate import evaluate
    from fbench.metrics.profiles.remarks import Remarks

    remarks = Remarks(profile, _named([run.folder for run in runs]))
    found = evaluate(profile, remarks.watched(run_sequence(run, profile, match) for run in runs))
    remarks.require_tracks()
    _say(remarks.lines())
    return found.scores(wish.resampling.how()), tuple(found.statistics)


def _named(runs: Iterable[Path]) -> str:
    return ", ".join(map(str, runs))


def _say(lines: Iterable[str]) -> None:
    for line in lines:
        sys.stderr.write(f"{line}\n")
