"""The draft of a configuration: values and their reasons, before it is written."""

from dataclasses import dataclass

Value = str | bool | int | float | tuple[str, ...]


@dataclass(frozen=True)
class Line:
    """One key of a table."""

    key: str
    value: Value
    why: str = ""
    is_guess: bool = False
    """Whether somebody should look at it."""
    is_active: bool = True
    """Else it is only suggested, as a comment."""


@dataclass(frozen=True)
class Table:
    """One table."""

    path: tuple[str, ...]
    """`("sensors", "front")` is `[sensors.front]`."""
    lines: tuple[Line, ...]
    why: str = ""
    notes: tuple[str, ...] = ()
    """Comments above it."""
    is_active: bool = True
    is_guess: bool = False


@dataclass(frozen=True)
class LeftOut:
    """A topic that isn't used."""

    topic: str
    why: str


@dataclass(frozen=True)
class Draft:
    """A whole configuration."""

    log: str
    """Name of the log."""
    tables: tuple[Table, ...]
    left_out: tuple[LeftOut, ...] = ()
