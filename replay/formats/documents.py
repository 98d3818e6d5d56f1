"""JSON, TOML, YAML and XML of others, read as untrusted input."""

import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.parsers import expat
from xml.parsers.expat import XMLParserType

from fbench.replay.contracts.errors import LimitError, LogError

_MAX_BYTES = 256 * 2**20
_HEAD = 2**20
MAX_SIZE = 4 * 1024 * 1024  # Bytes of a YAML file
_MAX_DEPTH = 32  # Of YAML
_MAX_DOTS = 500  # In a line of TOML


def read_json(path: Path) -> Any:
    """Return the content of a JSON file. LogError: can't be read. LimitError: too large, or nested too deeply."""
    try:
        if (size := path.stat().st_size) > _MAX_BYTES:
            limit = f"more than {_MAX_BYTES >> 20}; split it, or use Parquet"
            raise LimitError(f"{path}: {size >> 20} MiB of JSON, {limit}")
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
    """Return the beginning of a text, to see what it is. Raises LogError where it can't be read."""
    try:
        with path.open("rb") as file:
            return file.read(_HEAD).decode("utf-8", "replace")
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def member(value: object, name: str, where: str) -> Mapping[str, Any]:
    """Return an object inside another one; empty where there is none. Raises LogError where it is something else."""
    found = mapping(value, where).get(name)
    return {} if found is None else mapping(found, f"{where}: {name}")


def mapping(value: object, where: str) -> Mapping[str, Any]:
    """Return what must be a JSON object. Raises LogError where it is something else."""
    if not isinstance(value, dict):
        raise LogError(f"{where}: expected an object, got {_kind(value)}")
    return value


def items(value: object, where: str) -> Sequence[Any]:
    """Return what must be a list; one object stands for a list of it. Raises LogError where it is something else."""
    if isinstance(value, dict):
        return [value]
    if not isinstance(value, list):
        raise LogError(f"{where}: expected a list, got {_kind(value)}")
    return value


def vector(value: object, lengths: tuple[int, ...], where: str) -> list[float]:
    """Return a list of numbers of one of these lengths, finite or not. Raises LogError where it is something else."""
    if not isinstance(value, list) or len(value) not in lengths:
        raise LogError(f"{where}: expected {' or '.join(map(str, lengths))} numbers, got {_kind(value)}")
    return [scalar(item, where) for item in value]


def scalar(value: object, where: str) -> float:
    """Return a number. Raises LogError where it is something else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise LogError(f"{where}: expected a number, got {_kind(value)}")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def text(value: object, where: str) -> str:
    """Return a text, empty for null. Raises LogError where it is something else."""
    if value is None:
        return ""
    if not isinstance(value, str):
        raise LogError(f"{where}: expected a text, got {_kind(value)}")
    return value.encode("utf-8", "replace").decode()  # JSON can write half a surrogate pair, files can't


def _kind(value: object) -> str:
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return {dict: "an object", str: "a text", bool: "true or false", type(None): "null"}.get(type(value), "a number")


def parse_xml(parser: XMLParserType, content: bytes, error_of: Callable[[str], Exception]) -> None:
    """Give a document to a parser of expat, whose handlers refuse what they don't want. `error_of` makes the error that
    is raised where it isn't XML.
    """
    try:
        parser.Parse(content.removeprefix(b"\xef\xbb\xbf").lstrip(), True)
    except expat.ExpatError as error:
        raise error_of(f"isn't XML ({expat.ErrorString(error.code)} in line {error.lineno})") from error


class TomlError(Exception):
    """What is wrong with a text, in one line without the name of its file."""


def parse_toml(content: bytes) -> dict[str, Any]:
    """Return the tables of a UTF-8 file. Raises TomlError where it isn't TOML, or exhausts whoever parses it."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise TomlError(f"not UTF-8 ({error.reason} at byte {error.start})") from error
    for number, line in enumerate(text.splitlines(), 1):
        if line.count(".") > _MAX_DOTS and not line.lstrip().startswith("#"):
            raise TomlError(f"line {number} has over {_MAX_DOTS} dots; break it into several lines")
    try:
        return _require_int64(tomllib.loads(text))
    except RecursionError:
        raise TomlError("nested too deeply") from None
    except ValueError as error:  # also whole numbers of thousands of digits
        raise TomlError(str(error).splitlines()[0]) from error


def _require_int64(tables: dict[str, Any]) -> dict[str, Any]:
    """Refuse whole numbers beyond 64 bits, as TOML does; Python reads them, and can't write them in decimals."""
    waiting: list[tuple[str, Any]] = [("", tables)]
    while waiting:
        place, value = waiting.pop()
        if isinstance(value, dict | list):
            items_ = value.items() if isinstance(value, dict) else enumerate(value)
            waiting += [(f"{place}{key}.", item) for key, item in items_]
        elif isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise ValueError(f"{place[:200].removesuffix('.')}: a whole number beyond 64 bits")
    return tables


_TABLE = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"\s*([\w.\-\"' ]+?)\s*=")


def find_line(content: str, place: Sequence[str | int]) -> int:
    """Return the line of a TOML file in which a key stands, else that of the innermost table or list around it, else
    the first. Numbers in `place` are indices of lists. TOML's reader in Python doesn't know lines.
    """
    best, best_len, table = 1, 0, list[str | int]()
    counts: dict[tuple[str | int, ...], int] = {}
    for number, line in enumerate(content.splitlines(), 1):
        if found := _TABLE.match(line):
            table = list(_split_key(found[2]))
            if found[1] == "[[":
                at = counts[tuple(table)] = counts.get(tuple(table), -1) + 1
                table.append(at)
            here = table[: len(place)]  # a list of tables stands where its first does
        elif found := _KEY.match(line):
            here = [*table, *_split_key(found[1])]
        else:
            continue
        if best_len < len(here) <= len(place) and list(place[: len(here)]) == here:
            best, best_len = number, len(here)
    return best


def _split_key(key: str) -> list[str]:
    return [a or b or c for a, b, c in re.findall(r"\"([^\"]*)\"|'([^']*)'|([\w-]+)", key)]


class YamlFileError(Exception):
    """What is wrong with a file, in one line without its name."""

    def __init__(self, text: str, mendable: bool = True) -> None:
        super().__init__(text)
        self.mendable = mendable  # Whether the content is damaged, so that writing the file anew would help


def read_yaml(path: Path, max_size: int = MAX_SIZE) -> object:
    """Return the content of a file as `parse_yaml` does. YamlFileError also if it can't be read or is too large."""
    try:
        with path.open("rb") as file:
            content = file.read(max_size + 1)
    except OSError as error:
        raise YamlFileError(f"can't be read ({error.strerror})", mendable=False) from error
    if len(content) > max_size:
        raise YamlFileError(f"has more than the limit of {max_size} bytes", mendable=False)
    return parse_yaml(content)


def parse_yaml(content: bytes) -> object:
    """Parse without interpreting: values are dicts, lists and texts, so that no tag, date or number can do harm. Raises
    YamlFileError where it is damaged, nested too deeply, or has aliases or one key twice.
    """
    from ruamel.yaml import YAML  # takes a while to import
    from ruamel.yaml.error import YAMLError
    from ruamel.yaml.events import CollectionEndEvent, CollectionStartEvent, MappingEndEvent, NodeEvent, ScalarEvent

    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise YamlFileError(f"isn't UTF-8 text ({error.reason} at byte {error.start})") from error
    documents: list[object] = []
    parts = [documents]  # Of each collection that is open: its entries, of a mapping keys and values in turn
    try:
        for event in YAML(typ="base", pure=True).parse(text):
            line = event.start_mark.line + 1
            if isinstance(event, NodeEvent) and event.anchor is not None:
                raise YamlFileError(f"line {line}: YAML anchors and aliases aren't allowed here", mendable=False)
            if isinstance(event, ScalarEvent):
                parts[-1].append(event.value)
            elif isinstance(event, CollectionStartEvent):
                parts.append([])
                if len(parts) > _MAX_DEPTH + 1:
                    raise YamlFileError(f"line {line}: nested more than {_MAX_DEPTH} deep", mendable=False)
            elif isinstance(event, CollectionEndEvent):
                ended = parts.pop()
                parts[-1].append(_mapping(ended, line) if isinstance(event, MappingEndEvent) else ended)
    except YAMLError as error:
        reason = " ".join(str(error).split())
        raise YamlFileError(f"can't be parsed ({reason[:200]})") from error
    if len(documents) > 1:
        raise YamlFileError("can't be parsed (more than one document)")
    return documents[0] if documents else None


def _mapping(parts: Sequence[object], line: int) -> dict[str, object]:
    found: dict[str, object] = {}
    for key, value in zip(parts[::2], parts[1::2], strict=True):
        if not isinstance(key, str):
            raise YamlFileError(f"can't be parsed (a list or mapping as a key before line {line})")
        if key in found:
            raise YamlFileError(f"can't be parsed (duplicate key {key[:80]!r} before line {line})")
        found[key] = value
    return found
