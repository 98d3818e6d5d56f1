"""Opening a log, whatever container it is in."""

from collections.abc import Sequence
from pathlib import Path

from fbench.replay.errors import LogError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.container import Container
from fbench.replay.logs.parts import Parts
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.setup import Setup

LOG_JSON = "log.json"
_METADATA = "metadata.yaml"
"""Of rosbag2."""


def open_log(path: Path, faults: FaultLog, topics: Sequence[str] = (), setup: Setup | None = None) -> LogReader:
    """Open a log; what is wrong with its data is counted in `faults`, `topics` are patterns of those that are read,
    `setup` is what the user says about it.

    Raises:
        LogError: where the file can't be read or isn't a log.
        ConfigError: where a pattern fits nothing, or the setup doesn't fit the log.
    """
    return LogReader(open_container(path, faults), topics, setup, faults)


def open_container(path: Path, faults: FaultLog) -> Container:
    """Open an MCAP file, a Parquet folder, a ROS 1 bag, a rosbag2 file or folder, or a folder of such files.

    Raises:
        LogError: where it can't be read or is none of these.
    """
    if path.name == LOG_JSON or (path / LOG_JSON).is_file():
        from fbench.replay.logs.parquet.folder import ParquetFolder

        return ParquetFolder(path.parent if path.name == LOG_JSON else path, faults)
    if path.is_dir() or path.name == _METADATA:
        return _folder(path if path.is_dir() else path.parent, faults)
    return _file(path, faults)


def _file(path: Path, faults: FaultLog, compression: str = "") -> Container:
    """Open one file, whose single messages may be compressed too."""
    start = _start(path)
    if start.startswith(b"SQLite format 3\x00"):
        from fbench.replay.logs.rosbag.sqlite import Db3File

        return Db3File(path, faults, compression)
    if start.startswith(b"#ROSBAG V"):
        from fbench.replay.logs.rosbag.bag1 import Ros1Bag

        return Ros1Bag(path, faults)
    from fbench.replay.logs.mcap.file import McapFile

    file = McapFile(path, faults)
    if not compression:
        return file
    from fbench.replay.logs.rosbag.zstd import UnpackedMessages

    return UnpackedMessages(file)


def _start(path: Path) -> bytes:
    if path.exists() and not path.is_file():  # a FIFO would block, a device could go on for ever
        raise LogError(f"{path}: not a regular file", "LOG001")
    try:
        with path.open("rb") as file:
            return file.read(16)
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def _folder(path: Path, faults: FaultLog) -> Container:
    """Open all files of a split recording as one log."""
    from fbench.replay.logs.rosbag.folder import by_number, is_recording, missing_numbers, rosbag2_files

    if is_recording(path):
        parts = rosbag2_files(path, faults)
        return Parts(path, [_file(part.path, faults, part.compression) for part in parts], faults)
    bags = by_number(p for p in path.iterdir() if p.suffix == ".bag" and p.is_file())
    if not bags:
        raise LogError(f"{path}: no log (a folder without {LOG_JSON} and without .mcap, .db3 or .bag files)", "LOG001")
    for name in missing_numbers(bags):
        faults.add("LOG011", f"{path.name}: '{name}'")
    return Parts(path, [_file(bag, faults) for bag in bags], faults)
