"""Opening a log, whatever its container, also one that consists of several files."""

from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Int64
from fbench.replay.logs.container import LOG_JSON, Channel, Container, Entry, merge_blocks
from fbench.replay.logs.containers.limits import StoredLog
from fbench.replay.logs.containers.mcap.file import McapFile
from fbench.replay.logs.containers.rosbag.zstd import require_plain
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.setup import Setup

T = TypeVar("T")
_IDS = 2**32  # Channel `c` of part `p` gets the id `p * _IDS + c`
_METADATA = "metadata.yaml"  # Of rosbag2
_SUFFIXES = (".mcap", ".parquet", ".bag")  # Of logs in a folder
_MAX_NS = 2**63 - 1


class _Part(NamedTuple):
    offset: int  # Its number
    start_ns: int  # Log time before which it has no message
    container: Container


class _Parts(StoredLog):
    """Files of a split recording as one `Container`, opened when their time comes so that they don't fill memory."""

    def __init__(self, path: Path, containers: Sequence[Container], faults: FaultLog) -> None:
        super().__init__(path, faults)
        first = [next(c.entries(frozenset(c.channels)), None) for c in containers]
        starts_ns = [0 if entry is None else entry.log_ns for entry in first]
        self._parts = [_Part(i, start_ns, c) for i, (start_ns, c) in enumerate(zip(starts_ns, containers, strict=True))]
        self.channels: dict[int, Channel] = self._by_id([c.channels for c in containers])
        self.counts: dict[int, int] = self._by_id([c.counts for c in containers])
        self.header = next((c.header for c in containers if c.header is not None), None)
        self.keeps_checksums = any(c.keeps_checksums for c in containers)

    def entries(self, channels: frozenset[int], start_ns: int | None = None) -> Iterator[Entry]:
        """All messages of these channels, or those from a log time on, in canonical order."""
        own = [frozenset(id_ % _IDS for id_ in channels if id_ // _IDS == part.offset) for part in self._parts]

        def load(part: _Part) -> Iterator[Entry]:
            for entry in part.container.entries(own[part.offset], start_ns):
                yield entry._replace(part=part.offset, channel=part.offset * _IDS + entry.channel)

        return merge_blocks([part for part in self._parts if own[part.offset]], load)

    def log_times(self) -> Mapping[int, Int64] | None:
        """Log times of each channel, where all parts know them."""
        times = [part.container.log_times() for part in self._parts]
        return None if any(t is None for t in times) else self._by_id([t for t in times if t is not None])

    def verify(self) -> None:
        """Verify all parts."""
        for part in self._parts:
            part.container.verify()

    @staticmethod
    def _by_id(maps: Sequence[Mapping[int, T]]) -> dict[int, T]:
        return {i * _IDS + id_: value for i, values in enumerate(maps) for id_, value in values.items()}


def open_log(path: Path, faults: FaultLog, topics: Sequence[str] = (), setup: Setup | None = None) -> LogReader:
    """Open a log; what is wrong with its data is counted in `faults`, `topics` are patterns of those that are read,
    `setup` is what the user says about it. Raises LogError where the file can't be read or isn't a log. Raises
    ConfigError where a pattern fits nothing, or the setup doesn't fit the log.
    """
    return LogReader(open_container(path, faults), topics, setup, faults)


def open_container(path: Path, faults: FaultLog) -> Container:
    """Open an MCAP file, a Parquet folder, a ROS 1 bag, a rosbag2 file or folder, or a folder of such files. Raises
    LogError where it can't be read or is none of these.
    """
    if path.name == LOG_JSON or (path / LOG_JSON).is_file():
        from fbench.replay.logs.containers.parquet.folder import ParquetFolder

        return ParquetFolder(_name_folder(path.parent if path.name == LOG_JSON else path), faults)
    if path.is_dir() or path.name == _METADATA:
        return _folder(_name_folder(path if path.is_dir() else path.parent), faults)
    return _file(path, faults)


def find_logs(place: Path) -> list[Path]:
    """Return a log itself, or the logs in a folder, sorted by name."""
    if not place.is_dir() or _is_log_folder(place):
        return [place]
    return sorted(path for path in place.iterdir() if path.suffix in _SUFFIXES or _is_log_folder(path))


def _is_log_folder(path: Path) -> bool:
    return any((path / name).is_file() for name in (LOG_JSON, _METADATA))  # Parquet; rosbag2


def _name_folder(folder: Path) -> Path:
    """Return a path that ends with the name of the folder, which `.` and `..` don't."""
    return folder.resolve() if folder.name in ("", "..") else folder


def _file(path: Path, faults: FaultLog, compression: str = "") -> Container:
    """Open one file, whose single messages may be compressed too."""
    if path.exists() and not path.is_file():  # a FIFO would block, a device could go on for ever
        raise LogError(f"{path}: not a regular file", "LOG001")
    try:
        start = _start(path)
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error
    if start.startswith(b"SQLite format 3\x00"):
        from fbench.replay.logs.containers.rosbag.sqlite import Db3File

        return Db3File(path, faults, compression)
    if start.startswith(b"#ROSBAG V"):
        from fbench.replay.logs.containers.rosbag.bag1 import Ros1Bag

        return Ros1Bag(path, faults)
    require_plain(path, start)
    return McapFile(path, faults, has_packed=bool(compression))


def _start(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(16)


def _folder(path: Path, faults: FaultLog) -> Container:
    """Open all files of a split recording as one log."""
    from fbench.replay.logs.containers.rosbag.folder import by_number, is_recording, missing_numbers, rosbag2_files

    if is_recording(path):
        parts = rosbag2_files(path, faults)
        return _Parts(path, [_file(part.path, faults, part.compression) for part in parts], faults)
    bags = by_number(p for p in path.iterdir() if p.suffix == ".bag" and p.is_file())
    if not bags:
        raise LogError(f"{path}: no log (a folder without {LOG_JSON} and without .mcap, .db3 or .bag files)", "LOG001")
    for name in missing_numbers(bags):
        faults.add("LOG011", f"{path.name}: '{name}'")
    return _Parts(path, [_file(bag, faults) for bag in bags], faults)


@dataclass(frozen=True)
class Storage:
    """The form of a log."""

    form: str  # `MCAP`, `Parquet`, `ROS 1 bag`, `rosbag2 (SQLite)`, `folder`
    num_bytes: int
    compression: tuple[str, ...] | None = None  # Of its blocks; `None`: not known
    num_blocks: int | None = None
    is_indexed: bool = True  # Whether it could be surveyed without reading its messages


def storage(container: Container, times: Mapping[int, Int64] | None) -> Storage:
    """Tell in what form a log is stored, whose index knows these log times."""
    files = [container.path] if container.path.is_file() else sorted(container.path.rglob("*"))
    num_bytes = sum(file.stat().st_size for file in files if file.is_file())
    if isinstance(container, McapFile):
        blocks, is_stored = container.index.blocks, container.index.is_stored
        names = sorted({block.compression or "none" for block in blocks}) if is_stored else None
        return Storage("MCAP", num_bytes, None if names is None else tuple(names), len(blocks), is_stored)
    if container.path.is_dir():
        form = "Parquet" if (container.path / LOG_JSON).is_file() else "folder"
    elif (start := _start(container.path)).startswith(b"#ROSBAG"):
        form = "ROS 1 bag"
    else:
        is_sqlite = start.startswith(b"SQLite")
        form = "rosbag2 (SQLite)" if is_sqlite else container.path.suffix.removeprefix(".") or "file"
    return Storage(form, num_bytes, is_indexed=times is not None)


def read_log_times(container: Container) -> dict[int, Int64]:
    """Log times of each channel, ascending, from a pass over all messages."""
    found = {id_: array("Q") for id_ in container.channels}
    for entry in container.entries(frozenset(container.channels)):
        if entry.log_ns <= _MAX_NS:
            found[entry.channel].append(entry.log_ns)
    return {id_: np.array(times, np.int64) for id_, times in found.items()}


def span_ns(container: Container, times: Mapping[int, Int64] | None) -> tuple[int, int] | None:
    """Log times of the first and the last message; `None` without any."""
    if times is None:
        return container.index.span_ns if isinstance(container, McapFile) else None
    full = [t for _, t in sorted(times.items()) if len(t)]
    return (min(int(t[0]) for t in full), max(int(t[-1]) for t in full)) if full else None
