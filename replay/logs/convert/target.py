"""Where a converted log goes, and the checks that nothing else is lost by it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fbench.replay.errors import ConfigError
from fbench.replay.logs.convert.parts import Split

MAX_CHUNK = 128 * 1024 * 1024
"""Readers refuse chunks of over 256 MiB, and a chunk may exceed its size by a message."""


@dataclass(frozen=True)
class Target:
    """A log to write.

    Raises:
        ConfigError: where its name isn't that of a form that fbench writes, or an option doesn't belong to its form.
    """

    path: Path
    overwrite: bool = False
    compression: str | None = None
    """`None`: zstd."""
    chunk_size: int | None = None
    """Of MCAP [byte]; `None`: 1 MiB."""
    rows_per_group: int | None = None
    """Of Parquet; `None`: as many as make 8 MiB."""
    split: Split | None = None

    def __post_init__(self) -> None:
        if self.chunk_size is not None and not 1 <= self.chunk_size <= MAX_CHUNK:
            raise ConfigError(f"--chunk-size {self.chunk_size}: expected 1 to {MAX_CHUNK} bytes")
        if self.form == "parquet":
            for option, value in (("--chunk-size", self.chunk_size), ("--split-s and --split-mb", self.split)):
                if value is not None:
                    raise ConfigError(f"{self.path}: {option} is for MCAP, not for Parquet")
        elif self.rows_per_group is not None:
            raise ConfigError(f"{self.path}: --rows-per-group is for Parquet, not for MCAP")

    @property
    def form(self) -> Literal["mcap", "parquet"]:
        """What is written."""
        suffix = self.path.suffix
        if suffix == ".parquet":
            return "parquet"
        if suffix == ".mcap" or (self.split is not None and suffix == ""):
            return "mcap"
        raise ConfigError(f"{self.path}: which form? A name with .mcap is an MCAP file, with .parquet a Parquet folder")

    def check(self, source: Path) -> None:
        """See that the log may be written.

        Raises:
            ConfigError: where it would replace the source, or something that isn't to be replaced.
        """
        old, new = source.resolve(), self.path.resolve()
        if new == old or new in old.parents or old in new.parents:
            raise ConfigError(f"{self.path}: is the log that is converted, or lies in it; choose another name")
        self.require_free()

    def require_free(self) -> None:
        """See that nothing is there, or a log that is to be replaced.

        Raises:
            ConfigError: where something else is there.
        """
        if not (self.path.exists() or self.path.is_symlink()):
            return
        if not self.overwrite:
            raise ConfigError(f"{self.path}: exists already; choose another with --out, or --overwrite it")
        if self.form == "mcap":
            self._check_replaceable()

    def _check_replaceable(self) -> None:
        """Replace a file by a file and a folder of parts by such a folder, nothing else; Parquet sees to itself."""
        if self.split is None:
            is_alike = self.path.is_file()
        else:
            is_alike = self.path.is_dir() and not self.path.is_symlink() and _holds_parts(self.path)
        if not is_alike:
            raise ConfigError(f"{self.path}: exists and isn't a log of this form, so it isn't replaced")


def _holds_parts(folder: Path) -> bool:
    return all(file.suffix == ".mcap" and file.is_file() for file in folder.iterdir())
