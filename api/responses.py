"""Responses of a child process to the process that started it, kept apart from what is printed."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import TextIO

_STDOUT, _STDERR = 1, 2


@contextmanager
def answers() -> Iterator[TextIO]:
    """Give what writes to this process's stdout, in UTF-8; what else goes there, from libraries and programs too, goes
    to stderr from here on.
    """
    sys.stdout.flush()
    with os.fdopen(os.dup(_STDOUT), "w", encoding="utf-8", errors="backslashreplace") as out:
        os.dup2(_STDERR, _STDOUT)
        with redirect_stdout(sys.stderr):
            yield out
