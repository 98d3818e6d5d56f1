"""Times of a run as a table: of each stage and the whole frame, of the processor, and of what is outside of the frame.

`timings.parquet` has a row a frame and stage: `frame`, `stage`, `ns`, `clock`, `compiled`, `cpu_ns`, `outside`.
"""

from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import get_args

import numpy as np
import pyarrow as pa

from fbench.replay.contracts.errors import RunError
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.data.frames import ClockName
from fbench.replay.runs.columns import column_array, number_column, text_column
from fbench.replay.runs.tables import read_table, write_table

WHOLE = "total"
"""Stage that is the whole frame: the pipeline's step."""
WAIT, OUTPUT = "wait", "output"
"""Outside of the whole frame: log time from a frame's first message until it was there, and recording its results."""
_CLOCKS: tuple[ClockName, ...] = get_args(ClockName)
_UNKNOWN = -1
_NEEDED = {"frame": pa.int64(), "stage": pa.string(), "ns": pa.int64(), "clock": pa.string()}
"""Columns that all tables have; those of before lack others."""


class TimingsWriter:
    """Gathers times frame by frame, in little memory."""

    def __init__(self) -> None:
        names = ("frame", "stage", "ns", "clock", "compiled", "cpu_ns", "outside")
        self._columns = {name: array("q") for name in names}
        self._stages: dict[str, int] = {}

    def add(
        self,
        frame: int,
        stage_ns: Mapping[str, int],
        clock: ClockName = "host",
        compiled: bool = False,
        cpu_ns: Mapping[str, int] | None = None,
        outside: bool = False,
    ) -> None:
        """Append the times [ns] of stages of a frame by that clock, whether code was compiled or loaded meanwhile,
        CPU times where they are known, and whether the stages are outside of the whole frame.
        """
        for stage, ns in stage_ns.items():
            number, cpu = self._stages.setdefault(stage, len(self._stages)), (cpu_ns or {}).get(stage, _UNKNOWN)
            row = (frame, number, ns, _CLOCKS.index(clock), int(compiled), cpu, int(outside))
            for column, value in zip(self._columns.values(), row, strict=True):
                column.append(value)

    def write(self, path: Path) -> None:
        """Write the table."""
        values = {name: np.frombuffer(column, np.int64) for name, column in self._columns.items()}
        columns = {name: number_column(column, pa.int64()) for name, column in values.items()}
        for name, texts in (("stage", [*self._stages]), ("clock", _CLOCKS)):
            coded = pa.DictionaryArray.from_arrays(columns[name], text_column(texts))
            columns[name] = coded.dictionary_decode()
        for name in ("compiled", "outside"):
            columns[name] = number_column(values[name], pa.bool_())
        columns["cpu_ns"] = number_column(values["cpu_ns"], pa.int64(), values["cpu_ns"] == _UNKNOWN)
        write_table(path, columns)


@dataclass(frozen=True)
class Timings:
    """Times of a finished run, read from its table when first used: RunError where it can't be read."""

    path: Path

    @cached_property
    def _table(self) -> pa.Table:
        table = read_table(self.path)
        kinds = dict(zip(table.column_names, table.schema.types, strict=True))
        if len(kinds) < table.num_columns or any(kind != kinds.get(name) for name, kind in _NEEDED.items()):
            raise RunError(f"{self.path}: can't be read (not a table of times)")
        return table

    @cached_property
    def _outside(self) -> Bool:
        if "outside" not in self._table.column_names:  # of before there were such times
            return np.zeros(self._table.num_rows, bool)
        return column_array(self._table.column("outside"))

    @cached_property
    def _is_log(self) -> Bool:
        codes, names = _encode(self._table.column("clock"))
        return np.array([name == "log" for name in names], bool)[codes]

    @cached_property
    def clock(self) -> ClockName:
        """Whose times `stages` are: those of the log as soon as the pipeline passed on one of them."""
        return "log" if (self._is_log & ~self._outside).any() else "host"

    @cached_property
    def stages(self) -> dict[str, dict[int, int]]:
        """Time [ns] of each stage by the frame in which it ran, in their order, and `total` of those that have one."""
        return self._by_stage(~self._outside & (self._is_log == (self.clock == "log")), "ns")

    @cached_property
    def cpu(self) -> dict[str, dict[int, int]]:
        """CPU time [ns] of stages by frame, where it is known: of a stage that of the thread that ran it, of the whole
        frame that of all threads of the process.
        """
        if "cpu_ns" not in self._table.column_names:
            return {}
        return self._by_stage(~self._outside & (column_array(self._table.column("cpu_ns")) != _UNKNOWN), "cpu_ns")

    @cached_property
    def outside(self) -> dict[str, dict[int, int]]:
        """Times [ns] by frame that are no part of `total`: `wait`, in log time, and `output`."""
        return self._by_stage(self._outside, "ns")

    def _by_stage(self, rows: Bool, column: str) -> dict[str, dict[int, int]]:
        values, frames = column_array(self._table.column(column)), column_array(self._table.column("frame"))
        codes, names = _encode(self._table.column("stage"))
        owns = [(rows & (codes == code), name) for code, name in enumerate(names)]
        found = sorted((int(own.argmax()), name, own) for own, name in owns if own.any())  # as they first come
        return {name: dict(zip(frames[own].tolist(), values[own].tolist(), strict=True)) for _, name, own in found}

    @cached_property
    def compiled_frames(self) -> frozenset[int]:
        """Frames during which code was compiled, or loaded as compiled before; none where the run doesn't say."""
        if "compiled" not in self._table.column_names:
            return frozenset()
        return frozenset(column_array(self._table["frame"])[column_array(self._table["compiled"])].tolist())


def _encode(column: pa.ChunkedArray) -> tuple[Int64, list[str]]:
    """Return which of the different texts each row has, and those, in the order in which they first come."""
    coded = column.combine_chunks().dictionary_encode()
    if isinstance(coded, pa.ChunkedArray):
        coded = coded.chunk(0) if coded.num_chunks else pa.nulls(0, pa.string()).dictionary_encode()
    return column_array(pa.chunked_array([coded.indices])).astype(np.int64), coded.dictionary.to_pylist()
