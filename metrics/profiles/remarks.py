"""Remarks on results under a profile, and the rows that are printed."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.metrics.profiles.catalog import AnyProfile
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Headlines
from fbench.replay.data.arrays import Float64
from fbench.replay.data.classes import is_known
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

_OWN = "default"
_TRUTH, _RESULTS = "truth boxes", "results"
_NAMED = 5


@dataclass
class Remarks:
    """Looks at sequences while they are scored."""

    profile: AnyProfile
    what: str  # The results' name
    truth: str = "truth"
    num: Counter[str] = field(default_factory=Counter)
    """Results, and truth boxes that aren't to be ignored, of classes that count."""
    num_ids: Counter[str] = field(default_factory=Counter)  # Of these, those that have an id
    truth_labels: Counter[str] = field(default_factory=Counter)  # Without what is to be ignored
    labels: Counter[str] = field(default_factory=Counter)  # Of all results
    num_beyond: int = 0  # Results that count with scores below 0 or above 1
    scores: dict[str, list[Float64]] = field(default_factory=dict)
    """Of results that count, by label: where ties can decide."""

    def watch(self, sequences: Iterable[Sequence]) -> Iterator[Sequence]:
        """Yield the sequences as they are."""
        for sequence in sequences:
            truth, results, labels = sequence.truth, sequence.estimates, sorted(self.profile.result_labels)
            asked = np.ones(len(truth), bool) if truth.ignore is None else ~truth.ignore
            counts = np.isin(results.label, labels) if labels else np.ones(len(results), bool)
            for what, objects, rows in ((_TRUTH, truth, asked), (_RESULTS, results, counts)):
                self.num[what] += int(rows.sum())
                self.num_ids[what] += int((objects.track_id[rows] >= 0).sum())
            self.num_beyond += int((np.abs(results.score[counts] - 0.5) > 0.5).sum())
            self.truth_labels.update(truth.label[asked].tolist())
            self.labels.update(results.label.tolist())
            for name in np.unique(results.label).tolist() if self.profile.facts.ranks_by_file else ():
                self.scores.setdefault(name, []).append(results.score[counts & (results.label == name)])
            yield sequence

    def require_tracks(self) -> None:
        """Refuse tracks without any id, which tools would count as nothing. MetricError: truth or results have none."""
        if not self.profile.facts.judges_tracks or self.profile.name == _OWN:
            return
        for where, what in ((self.truth, _TRUTH), (self.what, _RESULTS)):
            if self.num[what] and not self.num_ids[what]:
                none = f"none of the {self.num[what]} {what} has a track id"
                raise MetricError(f"{where}: {none}; {self.profile.name} needs them")

    def lines(self) -> list[str]:
        """Return what there is to say, a line a matter."""
        found = list(self._about_classes())
        what = "count as tracks of their own" if self.profile.name == _OWN else "are left out"
        asked = (_RESULTS, _TRUTH) if self.profile.facts.judges_tracks else ()
        alone = {name: self.num[name] - self.num_ids[name] for name in asked if self.num_ids[name]}
        found += [f"{num} of {self.num[name]} {name} have no id and {what}" for name, num in alone.items() if num]
        num = 0
        for parts in self.scores.values():
            scores = np.concatenate(parts)
            times = np.unique(scores[np.isfinite(scores)], return_counts=True)[1]
            num += int(times[times > 1].sum())
        if num:
            ranks = "tools rank them as the file does, here content decides"
            found.append(f"{num} results share their score with another of their class: {ranks}")
        if self.num_beyond and self.profile.facts.cuts_up_to_1:
            cut = f"{self.profile.name} leaves out those below 0, and doesn't rank those above 1"
            found.append(f"{self.num_beyond} of {self.num[_RESULTS]} results have scores outside 0 to 1: {cut}")
        return [f"{self.what}: {line}" for line in found]

    def _about_classes(self) -> Iterator[str]:
        profile, known, labels = self.profile, self.profile.result_labels, self.labels
        if profile.name == _OWN:
            strange = {name: num for name, num in labels.items() if name and not is_known(name)}
            which = "fbench doesn't know, which count as other"
        elif profile.name == "coco" and not known:
            strange = {name: num for name, num in labels.items() if name not in self.truth_labels}
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
    """Return the lines about a part, a column for each class and level, `car, easy`; without the classes that neither
    truth nor results have, where others are there.
    """
    own = [row for row in rows if row.slice == part or (headlines.has_levels and row.slice.startswith(f"{part}, "))]
    met = {row.class_ for row in own if row.value is not None or not row.counts or any(row.counts.values())}
    own = [row for row in own if row.class_ in met or row.class_ == "all"] or own
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
