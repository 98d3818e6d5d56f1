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
import pyarrow.compute as pc

from fbench.replay.data.frames import ClockName
from fbench.replay.runs.tables import read_table, write_table

WHOLE = "total"
"""Stage that is the whole frame: the pipeline's step."""
WAIT, OUTPUT = "wait", "output"
"""Outside of the whole frame: log time from a frame's first message until it was there, and recording its results."""
_AT_ONCE = 256
_CLOCKS: tuple[ClockName, ...] = get_args(ClockName)
_UNKNOWN = -1


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
        columns = {name: pa.array(np.frombuffer(column, np.int64)) for name, column in self._columns.items()}
        for name, texts in (("stage", [*self._stages]), ("clock", _CLOCKS)):
            coded = pa.DictionaryArray.from_arrays(columns[name], pa.array(texts, pa.string()))
            columns[name] = coded.dictionary_decode()
        for name in ("compiled", "outside"):
            columns[name] = columns[name].cast(pa.bool_())
        is_unknown = pc.equal(columns["cpu_ns"], _UNKNOWN)
        columns["cpu_ns"] = pc.if_else(is_unknown, pa.scalar(None, pa.int64()), columns["cpu_ns"])
        write_table(path, columns)


@dataclass(frozen=True)
class Timings:
    """Times of a finished run, read from its table when first used."""

    path: Path

    @cached_property
    def _table(self) -> pa.Table:
        table = read_table(self.path)
        if "outside" not in table.column_names:  # of before there were such times
            table = table.append_column("outside", pa.array(np.zeros(table.num_rows, bool)))
            table = table.append_column("cpu_ns", pa.nulls(table.num_rows, pa.int64()))
        return table

    @cached_property
    def clock(self) -> ClockName:
        """Whose times `stages` are: those of the log as soon as the pipeline passed on one of them."""
        within = self._table.filter(pc.invert(self._table["outside"]))
        return "log" if pc.any(pc.equal(within["clock"], "log")).as_py() else "host"

    @cached_property
    def stages(self) -> dict[str, dict[int, int]]:
        """Time [ns] of each stage by the frame in which it ran, in their order, and `total` of those that have one."""
        is_own = pc.and_(pc.invert(self._table["outside"]), pc.equal(self._table["clock"], self.clock))
        return _by_stage(self._table.filter(is_own), "ns")

    @cached_property
    def cpu(self) -> dict[str, dict[int, int]]:
        """CPU time [ns] of stages by frame, where it is known: of a stage that of the thread that ran it, of the whole
        frame that of all threads of the process.
        """
        is_own = pc.and_(pc.invert(self._table["outside"]), pc.is_valid(self._table["cpu_ns"]))
        return _by_stage(self._table.filter(is_own), "cpu_ns")

    @cached_property
    def outside(self) -> dict[str, dict[int, int]]:
        """Times [ns] by frame that are no part of `total`: `wait`, in log time, and `output`."""
        return _by_stage(self._table.filter(self._table["outside"]), "ns")

    @cached_property
    def compiled_frames(self) -> frozenset[int]:
        """Frames during which code was compiled, or loaded as compiled before; none where the run doesn't say."""
        if "compiled" not in self._table.column_names:
            return frozenset()
        return frozenset(self._table.filter(self._table["compiled"])["frame"].to_pylist())


def _by_stage(table: pa.Table, column: str) -> dict[str, dict[int, int]]:
    stages: dict[str, dict[int, int]] = {}
    for batch in table.select(["stage", "frame", column]).to_batches(max_chunksize=_AT_ONCE):
        for stage, frame, ns in zip(*(values.to_pylist() for values in batch.columns), strict=True):
            stages.setdefault(str(stage), {})[int(frame)] = int(ns)
    return stages
