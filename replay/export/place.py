"""Where exported files go: all of them appear at once, or none."""

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from fbench.replay.errors import ConfigError
from fbench.replay.files import swap

_SUFFIXES = (".txt", ".ini")
"""Of all that is written into folders."""


@dataclass(frozen=True)
class Place:
    """A folder, or for formats of one file that file.

    Raises:
        ConfigError: where it mustn't be written.
    """

    path: Path
    is_file: bool
    overwrite: bool = False

    def check(self, sources: Sequence[Path]) -> None:
        """See that nothing else is lost.

        Raises:
            ConfigError: where something is in the way, or it lies in a source.
        """
        out = self.path.resolve()
        for source in sources:
            old = source.resolve()
            if old == out or old in out.parents or out in old.parents:
                raise ConfigError(f"{self.path}: is what is exported, or lies in it or around it; choose another name")
        if self.is_file and self.path.suffix != ".json":
            raise ConfigError(f"{self.path}: this format is one file; expected a name that ends in .json")
        if not out.parent.is_dir():
            raise ConfigError(f"{self.path}: can't be written (no folder {out.parent})")
        if not (self.path.exists() or self.path.is_symlink()) or self._is_empty():
            return
        if not self.overwrite:
            raise ConfigError(f"{self.path}: exists already; choose another with --out, or --overwrite it")
        if not self._is_alike():
            raise ConfigError(f"{self.path}: exists and holds more than an export, so --overwrite doesn't touch it")

    def _is_empty(self) -> bool:
        return not self.is_file and _is_folder(self.path) and not any(self.path.iterdir())

    def _is_alike(self) -> bool:
        if self.is_file:
            return self.path.is_file()
        if not _is_folder(self.path):
            return False
        return all(_is_folder(p) or (p.is_file() and p.suffix in _SUFFIXES) for p in self.path.rglob("*"))


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


@dataclass(frozen=True)
class Draft:
    """What is written until it gets its name; nothing is left of it where that doesn't happen."""

    place: Place

    @property
    def _partial(self) -> Path:
        out = self.place.path.absolute()
        return out.with_name(f".{out.name}.partial-{os.getpid()}")

    def __enter__(self) -> Self:
        try:
            if not self.place.is_file:
                self._partial.mkdir()
        except OSError as error:
            raise ConfigError(f"{self.place.path}: can't be written ({error.strerror})") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.place.is_file:
            self._partial.unlink(missing_ok=True)
        else:
            shutil.rmtree(self._partial, ignore_errors=True)

    def open(self, name: str = "") -> IO[str]:
        """Begin a file of the folder, or the only one."""
        path = self._partial / name if name else self._partial
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("w", encoding="utf-8", newline="\n")

    def finish(self) -> None:
        """Give everything its name."""
        if self.place.is_file:
            self._partial.replace(self.place.path.absolute())
        else:
            swap(self._partial, self.place.path.absolute())
