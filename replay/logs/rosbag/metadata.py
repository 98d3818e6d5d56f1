"""The file `metadata.yaml` of a rosbag2 recording, read as untrusted input."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import CollectionEndEvent, CollectionStartEvent, NodeEvent

from fbench.replay.errors import LogError

NAME = "metadata.yaml"
_MAX_SIZE = 4 * 1024 * 1024
_MAX_DEPTH = 32
_ADVICE = "mend it with `ros2 bag reindex`, or remove it to read the files as they are"


@dataclass(frozen=True)
class Metadata:
    """What reading needs to know of a recording."""

    storage: str
    """`sqlite3` or `mcap`, or what else wrote the files."""
    files: tuple[str, ...]
    """Relative paths in the order of recording."""
    compression_mode: str
    """`file`, `message` or, where nothing is compressed, empty."""
    compression_format: str


def read_metadata(path: Path) -> Metadata:
    """Read the file.

    Raises:
        LogError: where it can't be read, is too large or deep, has aliases or lacks what is needed.
    """
    content = _load(path, _text(path))
    bag = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    files = bag.get("relative_file_paths") if isinstance(bag, dict) else None
    if not isinstance(bag, dict) or not isinstance(files, list) or not all(isinstance(name, str) for name in files):
        raise LogError(f"{path}: no list 'relative_file_paths' in 'rosbag2_bagfile_information'; {_ADVICE}")
    mode = _string(path, bag, "compression_mode").lower()
    return Metadata(
        _string(path, bag, "storage_identifier"),
        tuple(files),
        "" if mode == "none" else mode,
        _string(path, bag, "compression_format").lower(),
    )


def _string(path: Path, bag: Mapping[str, object], key: str) -> str:
    value = bag.get(key) or ""
    if not isinstance(value, str):
        raise LogError(f"{path}: '{key}' is no text; {_ADVICE}")
    return value


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_SIZE + 1)
        if len(content) > _MAX_SIZE:
            raise LogError(f"{path}: has more than the limit of {_MAX_SIZE} bytes")
        return content.decode()
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: isn't UTF-8 text ({error.reason} at byte {error.start}); {_ADVICE}") from error


def _load(path: Path, text: str) -> object:
    """Parse without interpreting: every value is text, so that no tag, date or number can do harm."""
    try:
        _check_shape(path, text)
        return YAML(typ="base", pure=True).load(text)
    except YAMLError as error:
        reason = " ".join(str(error).split())
        raise LogError(f"{path}: can't be parsed ({reason[:200]}); {_ADVICE}") from error


def _check_shape(path: Path, text: str) -> None:
    depth = 0
    for event in YAML(typ="base", pure=True).parse(text):
        if isinstance(event, NodeEvent) and event.anchor is not None:
            raise LogError(f"{path}: line {event.start_mark.line + 1}: YAML anchors and aliases aren't allowed here")
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise LogError(f"{path}: line {event.start_mark.line + 1}: nested more than {_MAX_DEPTH} deep")
