"""Reading JSON that others wrote, and that may be meant ill."""

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fbench.replay.errors import LimitError, LogError

_MAX_BYTES = 256 * 2**20
_HEAD = 2**20


def read_json(path: Path) -> Any:
    """Return the content of a JSON file.

    Raises:
        LogError: where it can't be read.
        LimitError: where it is too large, or nested too deeply.
    """
    try:
        if (size := path.stat().st_size) > _MAX_BYTES:
            raise LimitError(
                f"{path}: {size >> 20} MiB of JSON, more than {_MAX_BYTES >> 20}; split it, or use Parquet"
            )
        return json.loads(path.read_text(encoding="utf-8-sig"), object_pairs_hook=_object)
    except RecursionError:
        raise LimitError(f"{path}: nested too deeply") from None
    except ValueError as error:
        raise LogError(f"{path}: isn't JSON ({str(error).splitlines()[0][:200]})") from error
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Of two values under one key JSON keeps one, so that boxes would be lost."""
    found = dict(pairs)
    if len(found) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        raise ValueError(f"an object has the key '{counts.most_common(1)[0][0][:60]}' twice")
    return found


def head_of(path: Path) -> str:
    """Return the beginning of a text, to see what it is.

    Raises:
        LogError: where it can't be read.
    """
    try:
        with path.open("rb") as file:
            return file.read(_HEAD).decode("utf-8", "replace")
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def member(value: object, name: str, where: str) -> Mapping[str, Any]:
    """Return an object inside another one; empty where there is none.

    Raises:
        LogError: where it is something else.
    """
    found = mapping(value, where).get(name)
    return {} if found is None else mapping(found, f"{where}: {name}")


def mapping(value: object, where: str) -> Mapping[str, Any]:
    """Return what must be a JSON object.

    Raises:
        LogError: where it is something else.
    """
    if not isinstance(value, dict):
        raise LogError(f"{where}: expected an object, got {_kind(value)}")
    return value


def items(value: object, where: str) -> Sequence[Any]:
    """Return what must be a list; one object stands for a list of it.

    Raises:
        LogError: where it is something else.
    """
    if isinstance(value, dict):
        return [value]
    if not isinstance(value, list):
        raise LogError(f"{where}: expected a list, got {_kind(value)}")
    return value


def vector(value: object, lengths: tuple[int, ...], where: str) -> list[float]:
    """Return a list of numbers of one of these lengths; what isn't finite stays so.

    Raises:
        LogError: where it is something else.
    """
    wanted = " or ".join(map(str, lengths))
    if not isinstance(value, list) or len(value) not in lengths:
        raise LogError(f"{where}: expected {wanted} numbers, got {_kind(value)}")
    return [scalar(item, where) for item in value]


def scalar(value: object, where: str) -> float:
    """Return a number.

    Raises:
        LogError: where it is something else.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise LogError(f"{where}: expected a number, got {_kind(value)}")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def text(value: object, where: str) -> str:
    """Return a text, empty for null.

    Raises:
        LogError: where it is something else.
    """
    if value is None:
        return ""
    if not isinstance(value, str):
        raise LogError(f"{where}: expected a text, got {_kind(value)}")
    return value.encode("utf-8", "replace").decode()  # JSON can write half a surrogate pair, files can't


def _kind(value: object) -> str:
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return {dict: "an object", str: "a text", bool: "true or false", type(None): "null"}.get(type(value), "a number")
