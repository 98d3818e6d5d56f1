"""Pipelines as they are written on the command line: `NAME`, `NAME:ARGUMENT`, `FILE.py:CLASS`, or a variant's
`GROUP/NAME` or `FILE.toml`.
"""

import re
import shlex
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

_MAX_CHARS = 60


@dataclass(frozen=True)
class PipelineName:
    """Which plug-in, and what follows its name."""

    plugin: str
    """`NAME`, `FILE.py:CLASS`, `GROUP/NAME` or `FILE.toml`."""
    argument: str | None = None
    """Short for the parameter that the plug-in names: `exec:./stack` is `exec` with `command=./stack`."""

    def __str__(self) -> str:
        return self.plugin if self.argument is None else f"{self.plugin}:{self.argument}"

    @property
    def file(self) -> Path | None:
        """The file that holds the class, where it comes from one."""
        path, _, _ = self.plugin.rpartition(".py:")
        return Path(f"{path}.py") if path else None

    @property
    def short(self) -> str:
        """As part of a file name: `mine-Mine` for `dir/mine.py:Mine`, `my_stack` for `exec:./my_stack --fast`."""
        if self.file is not None:
            return _clean(f"{self.file.stem}-{self.plugin.rpartition(':')[2]}")
        if self.argument is None:
            return _clean(self.plugin.replace("/", "-"))
        words = takewhile(lambda word: not word.startswith("-"), self.words)
        if self.plugin == "exec":  # the program's name says more than that it is one
            return _clean("-".join(Path(word).stem for word in words)) or "exec"
        return _clean("-".join([self.plugin, *(_clean(word) for word in words)]))

    @property
    def words(self) -> list[str]:
        """The argument's words, split as a shell does."""
        return _words(self.argument or "")


def parse_name(text: str) -> PipelineName:
    """Take a pipeline's name apart; what isn't known is found out later."""
    head, colon, argument = text.partition(":")
    return PipelineName(head, argument) if colon and re.fullmatch(r"[A-Za-z]\w*", head) else PipelineName(text)


def with_absolute_files(text: str) -> str:
    """A command line, or a single path, as seen from any folder: words that are files here become absolute."""
    words = _words(text)
    # Links stay: a virtual environment's Python is one.
    absolute = [str(Path(word).absolute()) if names_file(word) else word for word in words]
    return text if words == absolute else shlex.join(absolute)


def names_file(word: str) -> bool:
    """Tell whether a word of a command line is the path of a file that is there."""
    # A word such as `fast` may be the name of a file by chance.
    return ("/" in word or "." in word) and not word.startswith("-") and Path(word).is_file()


def _words(text: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError:
        return [text]


def _clean(text: str) -> str:
    return re.sub(r"[^\w.-]+", "_", text).strip("_.-")[:_MAX_CHARS]
