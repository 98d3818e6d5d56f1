"""Tables of results, ready to be shown: who shows them computes nothing."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

Kind: TypeAlias = Literal["share", "change", "count", "ms"]
"""A ratio, shown in percent; a relative change, shown in percent with its sign; a number of things; milliseconds."""
DASH = "–"


@dataclass(frozen=True)
class Figure:
    """One number, or why there is none."""

    value: float | None
    reason: str | None = None
    counts: Mapping[str, int | float] = field(default_factory=dict)
    """Raw counts that it comes from."""
    published: float | None = None
    """The same number as the source system's authors give it."""


@dataclass(frozen=True)
class Line:
    """One configuration in one space."""

    name: str
    space: str
    """Such as `image` or `3D`; empty where it plays no part."""
    figures: tuple[Figure, ...]
    """One a column."""


@dataclass(frozen=True)
class Column:
    """What the figures below each other are."""

    name: str
    kind: Kind = "share"


@dataclass(frozen=True)
class ResultTable:
    """A table with a title, and what must be known to read it."""

    name: str
    """Short, for machines."""
    title: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()

    @property
    def has_spaces(self) -> bool:
        """Whether lines say in which space they are."""
        return any(line.space for line in self.lines)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why numbers are missing, each reason once with what it is about."""
        about: dict[str, list[str]] = {}
        for line in self.lines:
            for column, figure in zip(self.columns, line.figures, strict=True):
                if figure.reason is not None:
                    where = " ".join(part for part in (line.name, line.space) if part)
                    about.setdefault(figure.reason, []).append(f"{column.name} of {where}")
        return tuple(f"{', '.join(names)}: {reason}" for reason, names in about.items())


@dataclass(frozen=True)
class Results:
    """All that an experiment gave."""

    title: str
    facts: tuple[tuple[str, str], ...]
    """What ran: name and text."""
    tables: tuple[ResultTable, ...]
    measured: tuple[ResultTable, ...] = ()
    """Tables of times, which differ from run to run."""
    problems: tuple[str, ...] = ()
    """What failed or was left out, and why."""


def shown(value: float | None, kind: Kind) -> str:
    """A number as people read it; an en dash for none."""
    if value is None:
        return DASH
    if kind == "count":
        return f"{value:.0f}"
    if kind == "ms":
        return f"{value:.2f}"
    text = f"{100 * value:+.1f}" if kind == "change" else f"{100 * value:.1f}"
    return text.lstrip("+-") if float(text) == 0 else text


def table_rows(table: ResultTable) -> list[dict[str, object]]:
    """Return a table's figures as rows for JSON."""
    return [
        {"name": line.name, "space": line.space, "column": column.name, "value": figure.value,
         "reason": figure.reason, "published": figure.published, "counts": dict(figure.counts)}
        for line in table.lines
        for column, figure in zip(table.columns, line.figures, strict=True)
    ]  # fmt: skip
