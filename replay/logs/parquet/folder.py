"""One Parquet log as a stream of entries in canonical order."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from pathlib import Path

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.data import Rig
from fbench.replay.errors import LimitError, LogError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.container import Channel, Entry
from fbench.replay.logs.header import LogHeader
from fbench.replay.logs.order import merged
from fbench.replay.logs.parquet import log_json
from fbench.replay.logs.parquet.footer import MAX_CHUNKS
from fbench.replay.logs.parquet.source import opened
from fbench.replay.logs.parquet.stream import Stream, open_stream


@dataclass(frozen=True, eq=False)
class _Block:
    """A row group, as `merged` wants it."""

    start_ns: int
    offset: int
    stream: Stream
    group: int


class ParquetFolder:
    """Finds and reads the messages of a log; implements `fbench.replay.logs.container.Container`.

    Each fault is counted once, however often it is met.

    Raises:
        LogError: where `log.json` or a file's footer is missing or damaged, or a file lacks columns.
    """

    def __init__(self, path: Path, faults: FaultLog) -> None:
        self._path, self._faults = path, faults
        self._description, has_digest = _read_description(path)
        if not has_digest:
            self.once("LOG006", (log_json.NAME,), f"{log_json.NAME} has no digest")
        self._streams = self._open_streams()
        self._rigs = self._read_rigs()

    @property
    def path(self) -> Path:
        """The folder."""
        return self._path

    @cached_property
    def channels(self) -> Mapping[int, Channel]:
        """All streams, numbered as in `log.json`."""
        return {number: stream.channel for number, stream in enumerate(self._streams)}

    @cached_property
    def counts(self) -> Mapping[int, int]:
        """Rows of each stream."""
        return {number: stream.num_rows for number, stream in enumerate(self._streams)}

    @cached_property
    def header(self) -> LogHeader:
        """Id and metadata; a log that has no id gets one from `log.json` and the footers of its files."""
        first = {name: mount.kind for name, mount in self._rigs[0][1].mounts.items()} if self._rigs else {}
        kinds = first or self._description.sensors
        log_id = self._description.log_id
        return LogHeader(self._digest() if log_id is None else log_id, self._description.metadata, kinds)

    @property
    def rigs(self) -> Sequence[tuple[int, Rig]]:
        """All rigs of `log.json`, in the order of time."""
        return self._rigs

    @property
    def rig_stamps(self) -> Sequence[int | None]:
        """Stamps of the messages that told the rigs, where `log.json` has them."""
        return [entry.stamp_ns for entry in sorted(self._description.rigs, key=lambda entry: entry.log_ns)]

    def entries(self, channels: frozenset[int]) -> Iterator[Entry]:
        """All messages of these streams in canonical order; damaged row groups are skipped and counted."""
        yield from merged(self._blocks(channels), lambda block: block.stream.entries(block.group, self))

    def entries_from(self, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
        """All messages of these streams from a log time on; of row groups that end before only that column is read."""
        blocks = [block for block in self._blocks(channels) if block.stream.last_ns(block.group, self) >= start_ns]
        entries = merged(blocks, lambda block: block.stream.entries(block.group, self))
        return (entry for entry in entries if entry.log_ns >= start_ns)

    def _blocks(self, channels: frozenset[int]) -> list[_Block]:
        blocks = []
        for number in sorted(channels):
            stream = self._streams[number]
            starts = stream.starts(self)
            blocks += [_Block(start, stream.base + group, stream, group) for group, start in starts.items()]
        return blocks

    def log_times(self) -> Mapping[int, Int64]:
        """`log_ns` of each stream's messages, ascending, from that column alone."""
        times = {}
        for number, stream in enumerate(self._streams):
            parts = [stream.log_ns(group, self) for group in range(stream.num_groups)]
            times[number] = np.sort(np.concatenate([np.zeros(0, np.int64), *parts]), kind="stable")
        return times

    def verify(self) -> None:
        """Nothing is left: every byte was verified when it was read."""

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""
        self._faults.once(code, (str(self._path), *key), f"{self._path.name}: {where}")

    def _open_streams(self) -> list[Stream]:
        streams: list[Stream] = []
        names: set[str] = set()
        base = 0
        for number, entry in enumerate(self._description.streams):
            if entry.file in names:
                raise LogError(f"{self._path / log_json.NAME}: file '{entry.file}' belongs to two streams", "PQ001")
            names.add(entry.file)
            stream = open_stream(self._path, entry, number, base)
            if entry.checksums is None:
                self.once("LOG006", (entry.file,), f"{entry.file} has no checksums in {log_json.NAME}")
            streams.append(stream)
            if sum(s.groups.footer.num_chunks for s in streams) > MAX_CHUNKS:
                raise LimitError(f"{self._path}: too many row groups; write larger ones", "LIM004")
            base += stream.num_rows
        return streams

    def _read_rigs(self) -> list[tuple[int, Rig]]:
        where = self._path / log_json.NAME
        try:
            rigs = [(entry.log_ns, entry.rig()) for entry in self._description.rigs]
        except LogError as error:
            raise LogError(f"{where}: {error}", "PQ001") from error
        return sorted(rigs, key=lambda rig: rig[0])

    def _digest(self) -> str:
        digest = blake2b(log_json.dump(self._description), digest_size=16)
        for stream in self._streams:
            digest.update(stream.footer_digest())
        return digest.hexdigest()


def _read_description(path: Path) -> tuple[log_json.LogJson, bool]:
    where = path / log_json.NAME
    with opened(where) as file:
        size = os.fstat(file.fileno()).st_size
        if size > log_json.MAX_BYTES:
            raise LimitError(f"{where}: {size} bytes, the limit is {log_json.MAX_BYTES}", "LIM004")
        return log_json.parse(str(where), os.pread(file.fileno(), size, 0))
