"""Targets of a conversion, checked, and logs as folders of MCAP files."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.files import Draft
from fbench.replay.logs.container import Channel
from fbench.replay.logs.containers.mcap.write import RawMcapWriter

MAX_CHUNK = 128 * 1024 * 1024  # Readers refuse chunks of over 256 MiB, and a chunk may exceed its size by a message


@dataclass(frozen=True)
class Split:
    """Where a new file begins; at least one is given."""

    period_ns: int | None = None  # A file holds the messages of so much log time, counted from the first one on
    num_bytes: int | None = None  # A file is closed when it holds about so much


def make_split(seconds: float | None, megabytes: float | None) -> Split | None:
    """Read `--split-s` and `--split-mb`. Raises ConfigError where one isn't a positive number."""
    sizes: list[int | None] = []
    for option, value, unit in (("--split-s", seconds, 1e9), ("--split-mb", megabytes, 1e6)):
        if value is not None and (not unit * value >= 1 or math.isinf(value)):
            raise ConfigError(f"{option} {value}: expected a positive number")
        sizes.append(None if value is None else round(min(value * unit, 1e18)))
    return None if seconds is None and megabytes is None else Split(*sizes)


class PartsWriter:
    """Writes `FOLDER/NAME_0.mcap`, `NAME_1.mcap` ...; the folder appears when all are whole, in place of an old one.
    Raises ConfigError where the folder can't be written.
    """

    def __init__(self, folder: Path, split: Split, open_part: Callable[[Path], RawMcapWriter]) -> None:
        self.path = folder
        self.names: list[str] = []
        """Of the files so far."""
        self._split, self._open = split, open_part
        self._name = folder.stem if folder.suffix == ".mcap" else folder.name
        self._start_ns: int | None = None
        self._period = 0
        self._draft = Draft(folder, is_folder=True)
        try:
            self._part = self._next()
        except BaseException:
            self.discard()
            raise

    def add(self, channel: Channel, log_ns: int, publish_ns: int, sequence: int, data: bytes | memoryview) -> None:
        """Append one message, in the order of `log_ns`. Raises ConfigError where the disk is full."""
        if self._start_ns is None:
            self._start_ns = log_ns
        split = self._split
        period = 0 if split.period_ns is None else (log_ns - self._start_ns) // split.period_ns
        if period > self._period or (split.num_bytes is not None and self._part.num_bytes >= split.num_bytes):
            self._part.close()
            self._part = self._next()
        self._period = max(period, self._period)
        self._part.add(channel, log_ns, publish_ns, sequence, data)

    def close(self) -> None:
        """Finish the last file and give the folder its name."""
        try:
            self._part.close()
            self._draft.publish()
        finally:
            self.discard()

    def discard(self) -> None:
        """Leave nothing behind."""
        if self.names:
            self._part.discard()
        self._draft.discard()

    def _next(self) -> RawMcapWriter:
        name = f"{self._name}_{len(self.names)}.mcap"
        part = self._open(self._draft.path / name)
        self.names.append(name)
        return part


@dataclass(frozen=True)
class Target:
    """A log to write. Raises ConfigError where its name isn't that of a form that fbench writes, or an option doesn't
    belong to its form.
    """

    path: Path
    overwrite: bool = False
    compression: str | None = None  # `None`: zstd
    chunk_size: int | None = None  # Of MCAP [byte]; `None`: 1 MiB
    rows_per_group: int | None = None  # Of Parquet; `None`: as many as make 8 MiB
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
        """See that the log may be written. Raises ConfigError where it would replace the source, or something that
        isn't to be replaced.
        """
        old, new = source.resolve(), self.path.resolve()
        if new == old or new in old.parents or old in new.parents:
            raise ConfigError(f"{self.path}: is the log that is converted, or lies in it; choose another name")
        self.require_free()

    def require_free(self) -> None:
        """See that nothing is there, or a log that is to be replaced: a file by a file, a folder of parts by such a
        folder; Parquet sees to itself. Raises ConfigError where something else is there.
        """
        path = self.path
        if not (path.exists() or path.is_symlink()):
            return
        if not self.overwrite:
            raise ConfigError(f"{path}: exists already; choose another with --out, or --overwrite it")
        if self.split is None:
            is_alike = self.form == "parquet" or path.is_file()
        else:
            is_alike = path.is_dir() and not path.is_symlink()
            is_alike = is_alike and all(file.suffix == ".mcap" and file.is_file() for file in path.iterdir())
        if not is_alike:
            raise ConfigError(f"{path}: exists and isn't a log of this form, so it isn't replaced")
