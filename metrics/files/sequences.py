"""Sequences of files: truth beside results, read one after the other."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from fbench.metrics.files.doubts import Doubt, Doubts
from fbench.metrics.files.forms import open_source
from fbench.metrics.files.joining import Where, joined, without_entry
from fbench.metrics.files.logs import LogTruth
from fbench.metrics.files.pairing import Choice, Pair, Pairing, paired
from fbench.metrics.files.side import Side, nothing
from fbench.metrics.files.sources import Source, SubmissionSource
from fbench.metrics.objects import Space
from fbench.metrics.sequence import Sequence
from fbench.replay.faults import FaultLog


@dataclass(frozen=True)
class FilePair:
    """Truth and results in files, of which nothing is read yet but names."""

    truth: Source
    estimates: Source
    pairing: Pairing
    faults: FaultLog = field(default_factory=FaultLog)
    """Counts boxes that aren't finite, as sequences are read."""
    doubts: Doubts = field(default_factory=Doubts)
    """Counts what is odd about the results, as sequences are read."""

    def sequences(self, space: Space = "both") -> Iterator[Sequence]:
        """Read sequences in the order of the truth; one is held at a time.

        Args:
            space: Where boxes are compared: those without size elsewhere are no fault.

        Raises:
            LogError: naming file, row and column of what can't be read.
            MetricError: where truth and results don't fit together.
        """
        for pair in self.pairing.pairs:
            yield self._read(pair, space)

    def _read(self, pair: Pair, space: Space) -> Sequence:
        truth = self.truth.read(pair.truth)
        if pair.estimates is None:
            estimates = Side(nothing(), has_stamps=truth.has_stamps, first_pixel=truth.first_pixel)
        else:
            estimates = self.estimates.read(pair.estimates)
        self.doubts.add((*estimates.doubts, without_entry(truth, estimates, pair.name)))
        where = Where(pair.name, str(self.truth.path), str(self.estimates.path))
        return joined(truth, estimates, pair.num_frames, where, self.faults, space)


def open_files(
    truth: Path,
    estimates: Path,
    choice: Choice | None = None,
    truth_form: str | None = None,
    estimates_form: str | None = None,
) -> FilePair:
    """Open truth and results.

    Args:
        truth: File or folder.
        estimates: File or folder.
        choice: What of them is scored.
        truth_form: One of `forms.FORMS`; `None`: names and content tell.
        estimates_form: As `truth_form`.

    Raises:
        ConfigError: where there is no such file, form or sequence.
        LogError: where a form can't be told.
        MetricError: where no sequence has truth, or one has no results.
    """
    true = open_source(truth, truth_form, is_truth=True)
    own = open_source(estimates, estimates_form, is_truth=False, like=true)
    faults = true.faults if isinstance(true, LogTruth) else FaultLog()
    pair = FilePair(true, own, paired(true, own, choice or Choice()), faults)
    pair.doubts.add(_about(own))
    return pair


def _about(estimates: Source) -> tuple[Doubt, ...]:
    if isinstance(estimates, SubmissionSource) and not estimates.submission.has_meta:
        return (Doubt("submission without 'meta', which nuscenes-devkit refuses", 1, ""),)
    return ()
