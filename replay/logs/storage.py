"""In what form a log is stored, and what its index tells of its times."""

from array import array
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.logs.container import Container
from fbench.replay.logs.mcap.file import McapFile

_MAX_NS = 2**63 - 1


@dataclass(frozen=True)
class Storage:
    """The form of a log."""

    form: str
    """`MCAP`, `Parquet`, `ROS 1 bag`, `rosbag2 (SQLite)`, `folder`."""
    num_bytes: int
    compression: tuple[str, ...] | None = None
    """Of its blocks; `None`: not known."""
    num_blocks: int | None = None
    is_indexed: bool = True
    """Whether it could be surveyed without reading its messages."""


def storage(container: Container, times: Mapping[int, Int64] | None) -> Storage:
    """Tell in what form a log is stored, whose index knows these log times."""
    files = [container.path] if container.path.is_file() else sorted(container.path.rglob("*"))
    num_bytes = sum(file.stat().st_size for file in files if file.is_file())
    if isinstance(container, McapFile):
        blocks, is_stored = container.index.blocks, container.index.is_stored
        names = sorted({block.compression or "none" for block in blocks}) if is_stored else None
        return Storage("MCAP", num_bytes, None if names is None else tuple(names), len(blocks), is_stored)
    return Storage(_form(container), num_bytes, is_indexed=times is not None)


def _form(container: Container) -> str:
    path = container.path
    if path.is_dir():
        return "Parquet" if (path / "log.json").is_file() else "folder"
    with path.open("rb") as file:
        start = file.read(16)
    if start.startswith(b"#ROSBAG"):
        return "ROS 1 bag"
    return "rosbag2 (SQLite)" if start.startswith(b"SQLite") else path.suffix.removeprefix(".") or "file"


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
