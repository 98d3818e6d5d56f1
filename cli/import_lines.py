"""Output of `fbench log import`: a line a log, and what many logs have in common."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal

from fbench.datasets.importing.files import format_counts, format_list
from fbench.datasets.importing.run import ImportedLog
from fbench.replay.data.scores import format_count

_NUMBER = re.compile(r"(?<![\w.-])-?\d+(?:\.\d+)?(?![\w.]*\d)")
_PAIR = r"\w[^:,()]* \d+"
_PAIRS = re.compile(rf"(?:: | \()({_PAIR}(?:, {_PAIR})*)(?:\)|$)")
"""Counts by name, all that a line says or in brackets: `: Car 3, Van 1`."""
_NAMED = 3
_ALIKE = 3  # So many forms of a line are shown of one subject


@dataclass
class _Form:
    texts: list[str]  # Between the numbers
    low: list[str]
    high: list[str]
    names: list[str] = field(default_factory=list)

    def add(self, name: str, numbers: list[str]) -> None:
        self.low = [min(pair, key=Decimal) for pair in zip(self.low, numbers, strict=True)]
        self.high = [max(pair, key=Decimal) for pair in zip(self.high, numbers, strict=True)]
        if name not in self.names:
            self.names.append(name)

    def __str__(self) -> str:
        spans = [a if a == b else f"{a}..{b}" for a, b in zip(self.low, self.high, strict=True)]
        return "".join(text for pair in zip(self.texts, [*spans, ""], strict=True) for text in pair)


@dataclass
class _Subject:
    """Lines of one subject, the text before the first colon."""

    forms: dict[tuple[str, ...], _Form] = field(default_factory=dict)
    totals: Counter[str] = field(default_factory=Counter)

    def add(self, name: str, line: str) -> None:
        if counts := _PAIRS.search(line):
            for pair in counts[1].split(", "):
                thing, _, num = pair.rpartition(" ")
                self.totals[thing] += int(num)
            line = line[: counts.start()] + line[counts.end() :]
            if counts[0].startswith(":"):
                return
        texts, numbers = _NUMBER.split(line), _NUMBER.findall(line)
        form = self.forms.setdefault(tuple(texts), _Form(texts, numbers, numbers))
        form.add(name, numbers)


def log_line(log: ImportedLog) -> str:
    """Return what became of a sequence."""
    if log.state == "there":
        return f"{log.path} is there already, made the same way"
    skipped = f", {log.num_skipped} skipped" if log.num_skipped else ""
    if log.written is None:
        return f"{log.path} isn't written{skipped}"
    messages = format_count(log.written.num_messages, "message")
    return f"{log.path}: {messages}, {log.written.num_bytes / 1e6:.3g} MB{skipped}"


def join_lines(logs: Sequence[ImportedLog]) -> Iterator[str]:
    """Yield what was found in many sequences. Lines alike become one, with the range of each number; counts by name
    alone are summed up. A line that not all sequences have ends with how many do, and with the first ones. Subjects
    keep the order in which they came; those with many forms show the most frequent ones.
    """
    written = [log for log in logs if log.state == "written"]
    subjects: dict[str, _Subject] = {}
    for log in written:
        for line in log.lines:
            subjects.setdefault(line.partition(":")[0], _Subject()).add(log.name, line)
    for title, subject in subjects.items():
        ordered = sorted(subject.forms.values(), key=lambda form: -len(form.names))
        for form in ordered[:_ALIKE]:
            where = f"{len(form.names)} of {len(written)}: {format_list(form.names, _NAMED)}"
            yield str(form) if len(form.names) == len(written) else f"{form} [{where}]"
        if others := ordered[_ALIKE:]:
            num = len({name for form in others for name in form.names})
            yield f"{title}: otherwise in {num} of {len(written)}, see --json"
        if subject.totals:
            yield f"{title}, in all: {format_counts(subject.totals)}"
