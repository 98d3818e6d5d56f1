"""Putting a finished log into its place."""

import os
import shutil
from pathlib import Path

from fbench.replay.errors import ConfigError
from fbench.replay.logs.parquet import log_json


def require_replaceable(path: Path) -> None:
    """Let only a Parquet log be replaced.

    Raises:
        ConfigError: where there is something else.
    """
    if path.is_symlink() or (path.exists() and not _is_log(path)):
        raise ConfigError(f"{path}: exists and isn't a Parquet log, so it isn't replaced; choose another name")


def _is_log(path: Path) -> bool:
    if not (path / log_json.NAME).is_file():
        return False
    return all(file.name == log_json.NAME or file.suffix == ".parquet" for file in path.iterdir())


def swap(new: Path, path: Path) -> None:
    """Rename `new` to `path`, in place of a log that is there; at no moment is there half of either."""
    old = new.with_name(f"{new.name}.old")
    if path.exists():
        path.rename(old)
    new.rename(path)
    synced(path.parent)
    shutil.rmtree(old, ignore_errors=True)


def synced(path: Path) -> None:
    """Have a file or folder written to the disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
