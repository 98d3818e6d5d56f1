"""Remarks on results under a profile, and the rows that are printed."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.metrics.profiles.catalog import AnyProfile
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Headlines
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.classes import is_known
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence

_OWN = "default"
_NAMED = 5


@dataclass(frozen=True)
class Side:
    """Boxes of one side, of classes that count."""

    num: int = 0
    num_ids: int = 0  # That have one

    def __add__(self, other: "Side") -> "Side":
        return Side(self.num + other.num, self.num_ids + other.num_ids)


@dataclass(frozen=True)
class Tally:
    """What was met in sequences."""

    truth: Side = Side()  # Without what is to be ignored
    results: Side = Side()
    truth_labels: frozenset[str] = frozenset()
    labels: Counter[str] = field(default_factory=Counter)  # Of all results
    scores: Mapping[str, tuple[Float64, ...]] = field(default_factory=dict)
    """Of results that count, by label: where ties can decide."""

    def __add__(self, other: "Tally") -> "Tally":
        names = dict.fromkeys((*self.scores, *other.scores))
        scores = {name: (*self.scores.get(name, ()), *other.scores.get(name, ())) for name in names}
        return Tally(
            self.truth + other.truth, self.results + other.results, self.truth_labels | other.truth_labels,
            self.labels + other.labels, scores,
        )  # fmt: skip


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
        for where, what, side in ((self.truth, "truth boxes", self.tally.truth), (self.what, "results",
                                                                                  self.tally.results)):  # fmt: skip
            if side.num and not side.num_ids:
                raise MetricError(
                    f"{where}: none of the {side.num} {what} has a track id; {self.profile.name} needs them"
                )

    def lines(self) -> list[str]:
        """Return what there is to say, a line a matter."""
        found = [*_about_classes(self.tally, self.profile), *_about_ids(self.tally, self.profile)]
        return [f"{self.what}: {line}" for line in [*found, *_about_ties(self.tally)]]


def tally_of(sequence: Sequence, profile: AnyProfile) -> Tally:
    """Count what remarks are about."""
    truth, results = sequence.truth, sequence.estimates
    asked = np.ones(len(truth), bool) if truth.ignore is None else ~truth.ignore
    counts = _of_classes(results, profile)
    names, numbers = np.unique(results.label, return_counts=True)
    ranked = names.tolist() if profile.facts.ranks_by_file else []
    scores = {name: (results.score[counts & (results.label == name)],) for name in ranked}
    return Tally(
        _side(truth, asked),
        _side(results, counts),
        frozenset(np.unique(truth.label[asked]).tolist()),
        Counter(dict(zip(names.tolist(), numbers.tolist(), strict=True))),
        scores,
    )


def _of_classes(results: Objects, profile: AnyProfile) -> Bool:
    labels = sorted(profile.result_labels)
    return np.isin(results.label, labels) if labels else np.ones(len(results), bool)


def _side(objects: Objects, rows: Bool) -> Side:
    return Side(int(rows.sum()), int((objects.track_id[rows] >= 0).sum()))


def _about_classes(tally: Tally, profile: AnyProfile) -> Iterator[str]:
    known, labels = profile.result_labels, tally.labels
    if profile.name == _OWN:
        strange = {name: num for name, num in labels.items() if name and not is_known(name)}
        if strange:
            names = _format_labels(strange)
            yield f"{_boxes(strange)} of classes that fbench doesn't know, which count as other: {names}"
    elif profile.name == "coco" and not known:
        strange = {name: num for name, num in labels.items() if name not in tally.truth_labels}
        if strange:
            yield f"{_boxes(strange)} of classes that the truth lacks, which have no AP: {_format_labels(strange)}"
    elif known:
        strange = {name: num for name, num in labels.items() if name not in known}
        if set(labels) == {""} and strange:
            yield f"the results have no classes, so none of them is of a class of {profile.name}"
        elif strange:
            yield f"{_boxes(strange)} of classes that {profile.name} doesn't score: {_format_labels(strange)}"


def _about_ids(tally: Tally, profile: AnyProfile) -> Iterator[str]:
    if not profile.facts.judges_tracks:
        return
    what = "count as tracks of their own" if profile.name == _OWN else "are left out"
    for name, side in (("results", tally.results), ("truth boxes", tally.truth)):
        if 0 < side.num_ids < side.num:
            yield f"{side.num - side.num_ids} of {side.num} {name} have no id and {what}"


def _about_ties(tally: Tally) -> Iterator[str]:
    num = sum(_tied(np.concatenate(parts)) for parts in tally.scores.values())
    if num:
        ranks = "tools rank them as the file does, here content decides"
        yield f"{num} results share their score with another of their class: {ranks}"


def _tied(scores: Float64) -> int:
    times = np.unique(scores[np.isfinite(scores)], return_counts=True)[1]
    return int(times[times > 1].sum())


def _boxes(labels: Mapping[str, int]) -> str:
    num = sum(labels.values())
    return f"{num} {'result is' if num == 1 else 'results are'}"


def _format_labels(labels: Mapping[str, int]) -> str:
    """The most frequent ones first."""
    names = sorted(labels, key=lambda name: (-labels[name], name))
    shown = ", ".join(f"{name or 'without a class'} ({labels[name]})" for name in names[:_NAMED])
    return shown + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")


@dataclass(frozen=True)
class Line:
    """One line of the table: a metric and how it was matched."""

    metric: str
    matching: str
    scores: Mapping[str, Score]  # By column: the class, and what of it


def lines(rows: Iterable[Score], headlines: Headlines, part: str = "all") -> list[Line]:
    """Return the lines about a part, a column for each class and level, `car, easy`."""
    own = [row for row in rows if row.slice == part or (headlines.has_levels and row.slice.startswith(f"{part}, "))]
    found: dict[tuple[str, str], dict[str, Score]] = {}
    for metric in headlines.metrics or tuple(dict.fromkeys(row.metric for row in own)):
        for row in own:
            if row.metric == metric:
                _add(found, row, part, headlines.all_matchings)
    return [Line(metric, _common(cells.values()), cells) for (metric, _), cells in found.items()]


def by_slice(rows: Iterable[Score]) -> dict[tuple[str, str, str, str], Score]:
    """Return rows by slice, class, metric and matching, so that those of many sequences are found at once."""
    found: dict[tuple[str, str, str, str], Score] = {}
    for row in rows:
        found.setdefault((row.slice, row.class_, row.metric, row.matching), row)
    return found


def _add(found: dict[tuple[str, str], dict[str, Score]], row: Score, part: str, all_matchings: bool) -> None:
    column = row.class_ + row.slice.removeprefix(part)
    kind = row.matching if all_matchings else ""
    found.setdefault((row.metric, kind), {}).setdefault(column, row)


def _common(scores: Iterable[Score]) -> str:
    """How boxes matched, where that is the same for all columns."""
    different = list(dict.fromkeys(score.matching for score in scores))
    return different[0] if len(different) == 1 else ""
