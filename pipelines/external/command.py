"""Finding the program that a command line names."""

import os
import shlex
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fbench.replay.errors import ConfigError
from fbench.replay.pipeline_name import names_file

_OWN_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""fbench sets these for itself: another program has threads of its own."""


@dataclass(frozen=True)
class Command:
    """A program and its arguments."""

    program: str
    """Absolute path."""
    words: Sequence[str]
    """As they were written, the program first."""

    @property
    def name(self) -> str:
        """The program's file name."""
        return Path(self.program).name

    @property
    def files(self) -> list[Path]:
        """The program, and the files that its arguments name: scripts, weights."""
        return [Path(self.program), *(Path(word) for word in self.words[1:] if names_file(word))]


def parse_command(text: str) -> Command:
    """Split a command line as a shell does, without running one, and find the program in PATH or as a path.

    Raises:
        ConfigError: where there is no such program, or it can't be executed.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ConfigError(f"exec: command {text!r} can't be split into words: {error}") from error
    if not words or not words[0] or "\0" in text:
        raise ConfigError("exec: needs a command, such as -p 'exec:./my_stack --option'")
    return Command(_found(words[0]), words)


def _found(word: str) -> str:
    in_path = None if "/" in word else shutil.which(word)
    path = Path(in_path or word).absolute()
    if path.is_dir() or not path.exists():
        where = "no such program" if "/" in word else "no such program in PATH or in this folder"
        raise ConfigError(f"exec: {word}: {where}")
    if not os.access(path, os.X_OK):
        raise ConfigError(f"exec: {word}: isn't executable; try chmod +x {word}")
    return str(path)


def environment() -> dict[str, str]:
    """Variables for a program: all but the number of threads that fbench sets for itself."""
    return {name: value for name, value in os.environ.items() if name not in _OWN_VARIABLES}
