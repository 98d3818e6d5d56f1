"""Reading a JSON array of objects one by one: the tables of the whole set have gigabytes."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from fbench.replay.errors import LimitError, LogError
from fbench.replay.imports.files import require_file

_CHUNK = 2**20
MAX_ROW = 4 * 2**20
"""No row is longer, in characters."""
_SPACE = re.compile(r"[ \t\n\r]*")
_DECODER = json.JSONDecoder()


def json_rows(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the objects of an array; holds a few of them at a time.

    Raises:
        LogError: where the file can't be read, isn't such an array, or is truncated; naming the row, counted from 0.
        LimitError: where a row is longer than `MAX_ROW`.
    """
    require_file(path)
    try:
        with path.open(encoding="utf-8-sig") as file:
            yield from _Window(path, file).rows()
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: isn't UTF-8 text ({error.reason})") from error
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from error


class _Window:
    """The part of a file that is being decoded."""

    def __init__(self, path: Path, file: TextIO) -> None:
        self._path, self._file = path, file
        self._text, self._at, self._num = "", 0, 0

    def rows(self) -> Iterator[dict[str, Any]]:
        if self._next() != "[":
            raise LogError(f"{self._path}: isn't a table, expected a JSON array of objects")
        closing = self._next()
        while closing != "]":
            if self._num or closing == ",":
                if closing != "," or not self._num:
                    raise LogError(f"{self._path}: row {self._num}: expected ',' or ']', is the file truncated?")
            else:
                self._at -= len(closing)
            yield self._row()
            self._num += 1
            closing = self._next()
        if self._next():
            raise LogError(f"{self._path}: text follows the end of the array")

    def _next(self) -> str:
        """Return the next character that isn't a space, and go behind it; empty at the end of the file."""
        while True:
            self._at = self._behind_space()
            if self._at < len(self._text):
                self._at += 1
                return self._text[self._at - 1]
            if not self._read():
                return ""

    def _row(self) -> dict[str, Any]:
        while True:
            try:
                row, end = _DECODER.raw_decode(self._text, self._behind_space())
            except (ValueError, RecursionError) as error:  # malformed, or not read to its end
                if len(self._text) - self._at > MAX_ROW:
                    raise LimitError(
                        f"{self._path}: row {self._num}: malformed or over {MAX_ROW} characters"
                    ) from error
                if self._read():
                    continue
                raise LogError(f"{self._path}: row {self._num}: {_what(error)}, is the file truncated?") from error
            if not isinstance(row, dict):
                raise LogError(f"{self._path}: row {self._num}: expected an object")
            self._at = end
            return row

    def _behind_space(self) -> int:
        found = _SPACE.match(self._text, self._at)
        return found.end() if found else self._at

    def _read(self) -> bool:
        """Drop what was decoded and read on; false at the end of the file."""
        more = self._file.read(_CHUNK)
        self._text, self._at = self._text[self._at :] + more, 0
        return bool(more)


def _what(error: Exception) -> str:
    return "nested too deeply" if isinstance(error, RecursionError) else f"malformed JSON ({str(error).split(':')[0]})"
