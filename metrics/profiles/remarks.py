"""Remarks on results under a profile, and the rows that are printed."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.metrics.core.exact import Counts
from fbench.metrics.profiles.catalog import AnyProfile
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Headlines
from fbench.replay.data.arrays import Float64
from fbench.replay.data.classes import is_known
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

_OWN = "default"
_NAMED = 5


@dataclass(frozen=True)
class Side(Counts):
    """Boxes of one side, of classes that count."""

    num: int = 0
    num_ids: int = 0  # That have one


@dataclass(frozen=True)
class Tally(Counts):
    """What was met in sequences."""

    truth: Side = Side()  # Without what is to be ignored
    results: Side = Side()
    truth_labels: Mapping[str, int] = field(default_factory=dict)
    labels: Mapping[str, int] = field(default_factory=dict)  # Of all results
    scores: Mapping[str, tuple[Float64, ...]] = field(default_factory=dict)
    """Of results that count, by label: where ties can decide."""


@dataclass
class Remarks:
    """Looks at sequences while they are scored."""

    profile: AnyProfile
    what: str  # The results' name
    truth: str = "truth"
    tally: Tally = field(default_factory=Tally)

    def watch(self, sequences: Iterable[Sequence]) -> Iterator[Sequence]:
        """Yield the sequences as they are."""
        for sequence in sequences:
            self.tally += tally_of(sequence, self.profile)
            yield sequence

    def require_tracks(self) -> None:
        """Refuse boxes without ids where tracks are judged, which tools would count as nothing at all. Raises
        MetricError where no truth box, or no result, has an id.
        """
        if not self.profile.facts.judges_tracks or self.profile.name == _OWN:
            return
        truth, results = (self.truth, "truth boxes", self.tally.truth), (self.what, "results", self.tally.results)
        for where, what, side in (truth, results):
            if side.num and not side.num_ids:
                none = f"none of the {side.num} {what} has a track id"
                raise MetricError(f"{where}: {none}; {self.profile.name} needs them")

    def lines(self) -> list[str]:
        """Return what there is to say, a line a matter."""
        tally, found = self.tally, list(_about_classes(self.tally, self.profile))
        what = "count as tracks of their own" if self.profile.name == _OWN else "are left out"
        for name, side in (("results", tally.results), ("truth boxes", tally.truth)):
            if self.profile.facts.judges_tracks and 0 < side.num_ids < side.num:
                found.append(f"{side.num - side.num_ids} of {side.num} {name} have no id and {what}")
        num = 0
        for parts in tally.scores.values():
            scores = np.concatenate(parts)
            times = np.unique(scores[np.isfinite(scores)], return_counts=True)[1]
            num += int(times[times > 1].sum())
        if num:
            ranks = "tools rank them as the file does, here content decides"
            found.append(f"{num} results share their score with another of their class: {ranks}")
        return [f"{self.what}: {line}" for line in found]


def tally_of(sequence: Sequence, profile: AnyProfile) -> Tally:
    """Count what remarks are about."""
    truth, results, labels = sequence.truth, sequence.estimates, sorted(profile.result_labels)
    asked = np.ones(len(truth), bool) if truth.ignore is None else ~truth.ignore
    counts = np.isin(results.label, labels) if labels else np.ones(len(results), bool)
    true, own = (
        Side(int(rows.sum()), int((objects.track_id[rows] >= 0).sum()))
        for objects, rows in ((truth, asked), (results, counts))
    )
    met_truth, met = (
        dict(zip(*(column.tolist() for column in np.unique(label, return_counts=True)), strict=True))
        for label in (truth.label[asked], results.label)
    )
    ranked = met if profile.facts.ranks_by_file else ()
    scores = {name: (results.score[counts & (results.label == name)],) for name in ranked}
    return Tally(true, own, met_truth, met, scores)


def _about_classes(tally: Tally, profile: AnyProfile) -> Iterator[str]:
    known, labels = profile.result_labels, tally.labels
    if profile.name == _OWN:
        strange = {name: num for name, num in labels.items() if name and not is_known(name)}
        which = "fbench doesn't know, which count as other"
    elif profile.name == "coco" and not known:
        strange = {name: num for name, num in labels.items() if name not in tally.truth_labels}
        which = "the truth lacks, which have no AP"
    else:
        strange = {name: num for name, num in labels.items() if known and name not in known}
        which = f"{profile.name} doesn't score"
        if set(labels) == {""} and strange:
            yield f"the results have no classes, so none of them is of a class of {profile.name}"
            return
    if strange:
        num, names = sum(strange.values()), sorted(strange, key=lambda name: (-strange[name], name))
        shown = ", ".join(f"{name or 'without a class'} ({strange[name]})" for name in names[:_NAMED])
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        yield f"{num} {'result is' if num == 1 else 'results are'} of classes that {which}: {shown}{more}"


@dataclass(frozen=True)
class Line:
    """One line of the table: a metric and how it was matched."""

    metric: str
    matching: str  # How boxes matched, where that is the same for all columns; else empty
    scores: Mapping[str, Score]  # By column: the class, and what of it


def lines(rows: Iterable[Score], headlines: Headlines, part: str = "all") -> list[Line]:
    """Return the lines about a part, a column for each class and level, `car, easy`."""
    own = [row for row in rows if row.slice == part or (headlines.has_levels and row.slice.startswith(f"{part}, "))]
    found: dict[tuple[str, str], dict[str, Score]] = {}
    for metric in headlines.metrics or tuple(dict.fromkeys(row.metric for row in own)):
        for row in own:
            if row.metric == metric:
                cells = found.setdefault((metric, row.matching if headlines.all_matchings else ""), {})
                cells.setdefault(row.class_ + row.slice.removeprefix(part), row)
    result = []
    for (metric, _), cells in found.items():
        matchings = {score.matching for score in cells.values()}
        result.append(Line(metric, matchings.pop() if len(matchings) == 1 else "", cells))
    return result


def by_slice(rows: Iterable[Score]) -> dict[tuple[str, str, str, str], Score]:
    """Return rows by slice, class, metric and matching, so that those of many sequences are found at once."""
    found: dict[tuple[str, str, str, str], Score] = {}
    for row in rows:
        found.setdefault((row.slice, row.class_, row.metric, row.matching), row)
    return found
