"""The file `metadata.yaml` of a rosbag2 recording, read as untrusted input."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fbench.replay.errors import LogError
from fbench.replay.yaml_file import YamlFileError, read_yaml

NAME = "metadata.yaml"
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
    content = _load(path)
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


def _load(path: Path) -> object:
    try:
        return read_yaml(path)
    except YamlFileError as error:
        raise LogError(f"{path}: {error}{f'; {_ADVICE}' if error.mendable else ''}") from error
