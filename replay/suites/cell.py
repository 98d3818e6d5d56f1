"""One cell of a suite, and what became of it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

from pydantic import TypeAdapter

from fbench.replay.config.source import LogWish
from fbench.replay.scores import ScoreOptions

State: TypeAlias = Literal["replayed", "there", "unfit", "failed"]


@dataclass(frozen=True)
class Cell:
    """One log through one pipeline, scored; travels as JSON."""

    log: LogWish
    pipeline: str
    folder: Path
    """Where the run goes."""
    settings: list[str] = field(default_factory=list)
    scoring: ScoreOptions = field(default_factory=ScoreOptions)
    media: bool = True
    """Whether the run keeps pictures and points for reports."""

    def to_json(self) -> str:
        """On one line, for another process."""
        return _CELL.dump_json(self).decode()

    @staticmethod
    def from_json(text: str) -> "Cell":
        """Read what `to_json` gave."""
        return _CELL.validate_json(text)


@dataclass(frozen=True)
class Answer:
    """What a process says of a cell; travels as JSON."""

    error: str | None = None
    """Why there is no run, in one line."""
    unfit: bool = False
    """Because the log lacks a sensor that the pipeline needs."""

    def to_json(self) -> str:
        """On one line, for another process."""
        return _ANSWER.dump_json(self).decode()

    @staticmethod
    def from_json(text: str) -> "Answer":
        """Read what `to_json` gave."""
        return _ANSWER.validate_json(text)


@dataclass(frozen=True)
class CellResult:
    """What became of a cell."""

    cell: Cell
    state: State
    """`replayed` now, or `there` from an earlier time; `unfit`: the log lacks what the pipeline needs."""
    reason: str | None = None
    """Why there is no run; one line."""

    @property
    def has_run(self) -> bool:
        """Whether the run folder is there and whole."""
        return self.state in ("replayed", "there")


_CELL, _ANSWER = TypeAdapter(Cell), TypeAdapter(Answer)
