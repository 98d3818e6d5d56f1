"""Writing a log as a folder of MCAP files, one after the other."""

import math
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fbench.replay.errors import ConfigError
from fbench.replay.files import swap, synced
from fbench.replay.logs.container import Channel
from fbench.replay.logs.mcap.raw_write import RawMcapWriter


@dataclass(frozen=True)
class Split:
    """Where a new file begins; at least one is given."""

    period_ns: int | None = None
    """A file holds the messages of so much log time, counted from the first one on."""
    num_bytes: int | None = None
    """A file is closed when it holds about so much."""


def make_split(seconds: float | None, megabytes: float | None) -> Split | None:
    """Read `--split-s` and `--split-mb`.

    Raises:
        ConfigError: where one isn't a positive number.
    """
    if seconds is None and megabytes is None:
        return None
    return Split(_positive("--split-s", seconds, 1e9), _positive("--split-mb", megabytes, 1e6))


def _positive(option: str, value: float | None, unit: float) -> int | None:
    if value is None:
        return None
    if not unit * value >= 1 or math.isinf(value):
        raise ConfigError(f"{option} {value}: expected a positive number")
    return round(min(value * unit, 1e18))


class PartsWriter:
    """Writes `FOLDER/NAME_0.mcap`, `NAME_1.mcap` ...; the folder appears when all are whole, in place of an old one.

    Raises:
        ConfigError: where the folder can't be written.
    """

    def __init__(self, folder: Path, split: Split, open_part: Callable[[Path], RawMcapWriter]) -> None:
        self.path = folder
        self.names: list[str] = []
        """Of the files so far."""
        self._split, self._open = split, open_part
        self._name = folder.stem if folder.suffix == ".mcap" else folder.name
        self._partial = folder.with_name(f".{folder.name}.partial-{os.getpid()}")
        self._start_ns: int | None = None
        self._period = 0
        try:
            self._partial.mkdir()
        except OSError as error:
            raise ConfigError(f"{folder}: can't be written ({error.strerror})") from error
        try:
            self._part = self._next()
        except BaseException:
            self.discard()
            raise

    def add(self, channel: Channel, log_ns: int, publish_ns: int, sequence: int, data: bytes | memoryview) -> None:
        """Append one message, in the order of `log_ns`.

        Raises:
            ConfigError: where the disk is full.
        """
        if self._is_due(log_ns):
            self._part.close()
            self._part = self._next()
        self._part.add(channel, log_ns, publish_ns, sequence, data)

    def close(self) -> None:
        """Finish the last file and give the folder its name."""
        try:
            self._part.close()
            synced(self._partial)
            swap(self._partial, self.path)
        except OSError as error:
            raise ConfigError(f"{self.path}: can't be written ({error.strerror})") from error
        finally:
            self.discard()

    def discard(self) -> None:
        """Leave nothing behind."""
        if self.names:
            self._part.discard()
        shutil.rmtree(self._partial, ignore_errors=True)

    def _is_due(self, log_ns: int) -> bool:
        if self._start_ns is None:
            self._start_ns = log_ns
        period = 0 if self._split.period_ns is None else (log_ns - self._start_ns) // self._split.period_ns
        is_due = period > self._period
        self._period = max(period, self._period)
        return is_due or (self._split.num_bytes is not None and self._part.num_bytes >= self._split.num_bytes)

    def _next(self) -> RawMcapWriter:
        name = f"{self._name}_{len(self.names)}.mcap"
        part = self._open(self._partial / name)
        self.names.append(name)
        return part
