"""Scoring results of other systems, from files."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.replay.cli.score_show import Told, show_scores
from fbench.replay.cli.score_wish import ProfileWish
from fbench.replay.errors import EXIT_LOSSY, EXIT_OK, ConfigError
from fbench.replay.faults import FAULTS, FaultLog

if TYPE_CHECKING:
    from fbench.metrics.files.pairing import Choice


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
        from fbench.metrics.files.pairing import MISSING, Choice
        from fbench.replay.names import did_you_mean

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
    from fbench.metrics.evaluate import evaluate
    from fbench.metrics.files.sequences import open_files
    from fbench.metrics.profiles.choose import chosen, compared, fitted, only
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
    odd = [f"{files.detections}: {line}" for line in pair.doubts.lines()]
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
