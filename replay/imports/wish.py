"""What of a dataset is wanted, and what happens to files that can't be used."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from fbench.replay.errors import ConfigError, LogError
from fbench.replay.names import did_you_mean


@dataclass(frozen=True)
class FrameRange:
    """A half-open range of frames, as the dataset numbers them."""

    first: int = 0
    stop: int | None = None

    def __contains__(self, number: int) -> bool:
        return self.first <= number and (self.stop is None or number < self.stop)

    def __str__(self) -> str:
        return f"{self.first}:{'' if self.stop is None else self.stop}"

    @property
    def is_whole(self) -> bool:
        """Whether all frames are in it."""
        return self.first == 0 and self.stop is None


@dataclass
class BadInput:
    """Counts files, rows and frames that can't be used; without leave to skip them, the first one ends the import."""

    skip: bool = False
    keep: int = 10
    num: int = 0
    texts: list[str] = field(default_factory=list)
    """The first ones."""

    def met(self, error: LogError) -> None:
        """Skip what an error tells of.

        Raises:
            LogError: that error, where nothing is to be skipped.
        """
        if not self.skip:
            raise error
        self.num += 1
        if len(self.texts) < self.keep:
            self.texts.append(str(error))


@dataclass(frozen=True)
class ImportWish:
    """What an import is asked for."""

    names: tuple[str, ...]
    """The sequences, in the order in which the importer named them."""
    frames: FrameRange = field(default_factory=FrameRange)
    """Of each sequence."""
    bad: BadInput = field(default_factory=BadInput)


def chosen_names(names: Sequence[str], patterns: Sequence[str]) -> tuple[str, ...]:
    """Return the names that fit any of the patterns (`*` and `?` as in file names), all without patterns.

    Raises:
        ConfigError: for a pattern that fits none.
    """
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise ConfigError(f"--scenes {pattern}: no such sequence{_known(pattern, names)}")
    return tuple(name for name in names if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns))


def _known(pattern: str, names: Sequence[str]) -> str:
    hint = did_you_mean(pattern, names)
    return hint if len(hint) < 300 else f"; there are {len(names)}, {names[0]} to {names[-1]}"
