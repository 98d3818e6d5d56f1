"""A rosbag2 recording: its files in order and its `metadata.yaml`, read as untrusted input."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Literal

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.formats.documents import YamlFileError, read_yaml
from fbench.replay.logs.containers.rosbag.zstd import check_format

NAME = "metadata.yaml"
_ADVICE = "mend it with `ros2 bag reindex`, or remove it to read the files as they are"


@dataclass(frozen=True)
class Metadata:
    """What reading needs to know of a recording."""

    storage: str  # `sqlite3` or `mcap`, or what else wrote the files
    files: tuple[str, ...]  # Relative paths in the order of recording
    compression_mode: str  # `file`, `message` or, where nothing is compressed, empty
    compression_format: str


def read_metadata(path: Path) -> Metadata:
    """Read the file.

    Raises LogError where it can't be read, is too large or deep, has aliases or lacks what is needed.
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


Storage = Literal["sqlite3", "mcap"]
_SUFFIXES: dict[str, Storage] = {".db3": "sqlite3", ".mcap": "mcap"}
_PACKED = ".zstd"


@dataclass(frozen=True)
class Part:
    """One file of a recording."""

    path: Path
    storage: Storage
    compression: str = ""  # Of its single messages: `zstd` or empty


def is_recording(folder: Path) -> bool:
    """Tell whether a folder looks like one of rosbag2."""
    return (folder / NAME).is_file() or bool(_present(folder))


def rosbag2_files(folder: Path, faults: FaultLog) -> list[Part]:
    """Return the files of a recording: those that `metadata.yaml` lists, in its order, then others by their number.
    Raises LogError where there are none, `metadata.yaml` is damaged, or what it tells can't be read or leaves the
    folder.
    """
    told = _inside(folder, NAME)
    metadata = None if told is None else read_metadata(told)
    _check_packed(folder)
    listed = [] if metadata is None else _list(folder, metadata, faults)
    compression = "" if metadata is None else _compression(folder, metadata)
    paths: dict[Path, Path] = {}
    for path in [*listed, *(_inside(folder, path.name) for path in _present(folder))]:
        if path is not None:
            paths.setdefault(path.resolve(), path)  # links within the folder may name a file twice
    if not paths:
        raise LogError(f"{folder}: no recording of rosbag2 (no .db3 or .mcap file that can be read)")
    if metadata is None:
        for name in missing_numbers(paths.values()):
            faults.add("LOG011", f"{folder.name}: '{name}'")
    return [Part(path, _storage(path, metadata), compression) for path in paths.values()]


def _list(folder: Path, metadata: Metadata, faults: FaultLog) -> list[Path]:
    found: list[Path] = []
    for name in metadata.files:
        path = _find(folder, name.removesuffix(_PACKED))
        if path is None:
            faults.add("LOG011", f"{folder.name}: '{name}'")
        else:
            found.append(path)
    return found


def _find(folder: Path, name: str) -> Path | None:
    """Where a listed file is; early versions of rosbag2 wrote the folder's name before that of the file."""
    return _inside(folder, name) or _inside(folder, PurePath(name).name)


def _check_packed(folder: Path) -> None:
    """Refuse files that are compressed as a whole, unless what is in them lies beside them."""
    for path in by_number(_files(folder)):
        unpacked = path.with_suffix("")
        if path.suffix == _PACKED and unpacked.suffix in _SUFFIXES and not unpacked.exists():
            raise LogError(f"{path}: compressed as a whole; decompress it first (`unzstd {path.name}`)", "LOG007")


def _inside(folder: Path, name: str) -> Path | None:
    """Path of a file in the folder; `None` where there is no such file. Raises LogError where it leads out of it."""
    relative = PurePath(name)
    try:
        path = folder / relative
        leaves = relative.is_absolute() or ".." in relative.parts
        if leaves or not path.resolve().is_relative_to(folder.resolve()):
            raise LogError(f"{folder}: '{name}' leads out of the folder; a recording's files must lie in it", "SEC002")
        return path if path.is_file() else None
    except (ValueError, OSError, RuntimeError) as error:  # a NUL, a name that is too long, links that form a circle
        raise LogError(f"{folder}: '{name[:200]!a}' is no path of a file ({error})") from error


def _compression(folder: Path, metadata: Metadata) -> str:
    if metadata.compression_mode in ("", "file"):
        return ""
    if metadata.compression_mode != "message":
        raise LogError(f"{folder / NAME}: unknown compression mode '{metadata.compression_mode}'")
    check_format(folder / NAME, metadata.compression_format)
    return metadata.compression_format


def _storage(path: Path, metadata: Metadata | None) -> Storage:
    named = path.suffix if metadata is None else f".{metadata.storage}"
    storage = _SUFFIXES.get(path.suffix) or {".sqlite3": _SUFFIXES[".db3"], **_SUFFIXES}.get(named)
    if storage is None:
        raise LogError(f"{path}: unknown storage '{named[1:]}'; fbench reads sqlite3 and mcap")
    return storage


def _present(folder: Path) -> Sequence[Path]:
    return by_number(path for path in _files(folder) if path.suffix in _SUFFIXES)


def _files(folder: Path) -> Sequence[Path]:
    try:
        return [path for path in folder.iterdir() if path.is_file()]
    except OSError as error:
        raise LogError(f"{folder}: can't be read ({error.strerror})") from error


def missing_numbers(paths: Iterable[Path]) -> Sequence[str]:
    """Names that the numbering of a split recording lacks: `bag_1.mcap` between `bag_0.mcap` and `bag_2.mcap`.

    Only a numbering from 0 or 1 on is one; dates and times in names aren't.
    """
    numbers: dict[tuple[str, str], list[int]] = {}
    for path in paths:
        match = re.fullmatch(r"(.*_)(0|[1-9][0-9]{0,5})", path.stem)
        if match:
            numbers.setdefault((match[1], path.suffix), []).append(int(match[2]))
    return [
        f"{stem}{n}{suffix}"
        for (stem, suffix), found in sorted(numbers.items())
        if min(found) <= 1
        for n in range(min(found), max(found))
        if n not in found
    ]


def by_number(paths: Iterable[Path]) -> Sequence[Path]:
    """Sort so that `bag_2` comes before `bag_10`."""
    return sorted(paths, key=lambda path: (_natural(path.name), path.name))


def _natural(name: str) -> list[tuple[int, int, str]]:
    return [(0, int(text), "") if text.isdecimal() else (1, 0, text) for text in re.split(r"([0-9]+)", name)]
