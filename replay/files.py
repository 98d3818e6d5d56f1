"""Writing files so that nobody ever sees half of one."""

import os
from pathlib import Path


def replace_text(path: Path, text: str) -> None:
    """Write a text file under a temporary name beside it, then rename it."""
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    try:
        partial.write_text(text)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
