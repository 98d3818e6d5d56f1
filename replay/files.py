"""Writing files so that nobody ever sees half of one."""

import os
import shutil
from pathlib import Path


def replace_text(path: Path, text: str) -> None:
    """Write a text file under a temporary name beside it, then rename it."""
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    try:
        partial.write_text(text)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def swap(new: Path, path: Path) -> None:
    """Rename `new` to `path`, in place of a folder that is there; at no moment is there half of either."""
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
