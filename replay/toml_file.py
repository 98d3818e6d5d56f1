"""TOML of others, read as untrusted input."""

import tomllib
from typing import Any

_MAX_DOTS = 500


class TomlError(Exception):
    """What is wrong with a text, in one line without the name of its file."""


def parse_toml(content: bytes) -> dict[str, Any]:
    """Return the tables of a file of UTF-8, with or without a byte order mark.

    Raises:
        TomlError: where it isn't TOML, or written to exhaust whoever parses it.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise TomlError(f"not UTF-8 ({error.reason} at byte {error.start})") from error
    _require_short_keys(text)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise TomlError("nested too deeply") from None
    except ValueError as error:  # also whole numbers of thousands of digits
        raise TomlError(str(error).splitlines()[0]) from error


def _require_short_keys(text: str) -> None:
    """A dotted key of N parts, which takes one line, costs time and memory with N squared."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.count(".") > _MAX_DOTS and not line.lstrip().startswith("#"):
            raise TomlError(f"line {number} has over {_MAX_DOTS} dots; break it into several lines")
