"""One import at a time writes a log, and clears away what a killed one has left beside it."""

import fcntl
import glob
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from fbench.replay.errors import ConfigError


@contextmanager
def claimed(path: Path, waits: Callable[[], None]) -> Iterator[None]:
    """Have the log `path` alone while the `with` block runs; `waits` is called where another import has it.

    The system gives a claim back when its process ends, however it does.

    Raises:
        ConfigError: where nothing can be written beside the log.
    """
    lock = path.with_name(f".{path.name}.importing")
    try:
        number = _locked(lock, waits)
    except OSError as error:
        raise ConfigError(f"{path}: can't be written ({error.strerror})") from error
    try:
        _clear_partial(path)
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(number)


def _locked(lock: Path, waits: Callable[[], None]) -> int:
    while True:
        number = os.open(lock, os.O_RDWR | os.O_CREAT)
        try:
            _lock(number, waits)
            if _is_file(number, lock):
                return number
        except BaseException:
            os.close(number)
            raise
        os.close(number)


def _lock(number: int, waits: Callable[[], None]) -> None:
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        waits()
        fcntl.flock(number, fcntl.LOCK_EX)


def _is_file(number: int, lock: Path) -> bool:
    """Whether the open file still has its name: who had the claim before took that away."""
    try:
        return os.path.samestat(os.fstat(number), lock.stat())
    except FileNotFoundError:
        return False


def _clear_partial(path: Path) -> None:
    """Remove what is half written; a log that was to be replaced, and wasn't yet, gets its name back."""
    for left in sorted(path.parent.glob(f".{glob.escape(path.name)}.partial-*")):
        if re.fullmatch(r"[0-9]+\.old", left.name.rpartition("-")[2]) and not path.exists():
            left.rename(path)
        elif left.is_dir():
            shutil.rmtree(left)
        else:
            left.unlink(missing_ok=True)
