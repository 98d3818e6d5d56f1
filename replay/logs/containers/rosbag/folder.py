"""A rosbag2 recording: its files in order and its `metadata.yaml`, read as untrusted input."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Literal

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.formats.documents import YamlFileError, read_yaml
from fbench.replay.logs.containers.rosbag.zstd import check_format

NAME = "metadata.yaml"
_ADVICE = "mend it with `ros2 bag reindex`, or remove it to read the files as they are"
Storage = Literal["sqlite3", "mcap"]
_SUFFIXES: dict[str, Storage] = {".db3": "sqlite3", ".mcap": "mcap"}
_PACKED = ".zstd"


@dataclass(frozen=True)
class Metadata:
    """What reading needs to know of a recording."""

    storage: str  # `sqlite3` or `mcap`, or what else wrote the files
    files: tuple[str, ...]  # Relative paths in the order of recording
    compression_mode: str  # `file`, `message` or, where nothing is compressed, empty
    compression_format: str


def read_metadata(path: Path) -> Metadata:
    """Read it. Raises LogError where it can't be read, is too large or deep, has aliases or lacks what is needed."""
    try:
        content = read_yaml(path)
    except YamlFileError as error:
        raise LogError(f"{path}: {error}{f'; {_ADVICE}' if error.mendable else ''}") from error
    bag = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    files = bag.get("relative_file_paths") if isinstance(bag, dict) else None
    if not isinstance(bag, dict) or not isinstance(files, list) or not all(isinstance(name, str) for name in files):
        raise LogError(f"{path}: no list 'relative_file_paths' in 'rosbag2_bagfile_information'; {_ADVICE}")
    texts = {key: bag.get(key) or "" for key in ("compression_mode", "storage_identifier", "compression_format")}
    for key, text in texts.items():
        if not isinstance(text, str):
            raise LogError(f"{path}: '{key}' is no text; {_ADVICE}")
    mode, storage, compression = texts.values()
    return Metadata(storage, tuple(files), "" if mode.lower() == "none" else mode.lower(), compression.lower())


@dataclass(frozen=True)
class Part:
    """One file of a recording."""

    path: Path
    storage: Storage
    compression: str = ""  # Of its single messages: `zstd` or empty


def is_recording(folder: Path) -> bool:
    """Tell whether a folder looks like one of rosbag2."""
    return (folder / NAME).is_file() or any(
        Path(path.name.removesuffix(_PACKED)).suffix in _SUFFIXES for path in _files(folder)
    )


def rosbag2_files(folder: Path, faults: FaultLog) -> list[Part]:
    """Return the files of a recording: those that `metadata.yaml` lists, in its order, then others by their number.
    Raises LogError where there are none, `metadata.yaml` is damaged, or what it tells can't be read or leaves the
    folder.
    """
    described = _inside(folder, NAME)
    metadata = None if described is None else read_metadata(described)
    present = by_number(_files(folder))
    for path in present:
        unpacked = path.with_suffix("")
        if path.suffix == _PACKED and unpacked.suffix in _SUFFIXES and not unpacked.exists():
            raise LogError(f"{path}: compressed as a whole; decompress it first (`unzstd {path.name}`)", "LOG007")
    files: list[Path | None] = []
    for name in () if metadata is None else metadata.files:
        plain = name.removesuffix(_PACKED)
        # Early versions of rosbag2 wrote the folder's name before that of the file.
        files.append(_inside(folder, plain) or _inside(folder, PurePath(plain).name))
        if files[-1] is None:
            faults.add("LOG011", f"{folder.name}: '{name}'")
    compression = "" if metadata is None else _compression(folder, metadata)
    files += [_inside(folder, path.name) for path in present if path.suffix in _SUFFIXES]
    paths: dict[Path, Path] = {}
    for path in (path for path in files if path is not None):
        paths.setdefault(path.resolve(), path)  # links within the folder may name a file twice
    if not paths:
        raise LogError(f"{folder}: no recording of rosbag2 (no .db3 or .mcap file that can be read)")
    if metadata is None:
        for name in missing_numbers(paths.values()):
            faults.add("LOG011", f"{folder.name}: '{name}'")
    return [Part(path, _storage(path, metadata), compression) for path in paths.values()]


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


def _files(folder: Path) -> Sequence[Path]:
    try:
        return [path for path in folder.iterdir() if path.is_file()]
    except OSError as error:
        raise LogError(f"{folder}: can't be read ({error.strerror})") from error


def missing_numbers(paths: Iterable[Path]) -> Sequence[str]:
    """Names that the numbering of a split recording lacks: `bag_1.mcap` between `bag_0.mcap` and `bag_2.mcap`.

    Only a numbering from 0 or 1 on is one; dates and times in names aren't.
    """
    numbers: dict[tuple[str, str], set[int]] = {}
    for path in paths:
        if match := re.fullmatch(r"(.*_)(0|[1-9][0-9]{0,5})", path.stem):
            numbers.setdefault((match[1], path.suffix), set()).add(int(match[2]))
    return [
        f"{stem}{n}{suffix}"
        for (stem, suffix), found in sorted(numbers.items())
        if min(found) <= 1
        for n in range(min(found), max(found))
        if n not in found
    ]


def by_number(paths: Iterable[Path]) -> Sequence[Path]:
    """Sort so that `bag_2` comes before `bag_10`."""

    def natural(path: Path) -> tuple[list[tuple[int, int, str]], str]:
        pieces = re.split(r"([0-9]+)", path.name)
        return [(0, int(text), "") if text.isdecimal() else (1, 0, text) for text in pieces], path.name

    return sorted(paths, key=natural)
