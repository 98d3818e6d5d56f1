"""Outcomes of the boxes of a run (hit, missed, false alarm), as its scores count them, kept for its reports."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pyarrow as pa

from fbench.replay.contracts.errors import RunError
from fbench.replay.runs.columns import number_column, text_column
from fbench.replay.runs.tables import read_table, write_table

Outcomes: TypeAlias = Mapping[str, Mapping[tuple[int, str], str]]
"""By table (`truth`, `truth_2d`, `detections`, `tracks`), and in it by the row of the box and the camera in whose image
it was compared, empty in 3D: `hit`, `missed`, `false alarm`, `ignored` or `invalid`."""
FILE = "outcomes.parquet"
_COLUMNS = {"table": pa.string(), "row": pa.int64(), "camera": pa.string(), "outcome": pa.string()}


def save_outcomes(folder: Path, outcomes: Outcomes) -> None:
    """Write outcomes into a run folder; equal outcomes give equal bytes."""
    rows = [
        (table, row, camera, outcome) for table in sorted(outcomes)
        for (row, camera), outcome in sorted(outcomes[table].items())
    ]  # fmt: skip
    tables, numbers, cameras, found = zip(*rows, strict=True) if rows else ((), (), (), ())
    columns = {
        "table": text_column(tables),
        "row": number_column(np.array(numbers, np.int64), pa.int64()),
        "camera": text_column(cameras),
        "outcome": text_column(found),
    }
    partial = folder / f".{FILE}.partial-{os.getpid()}"
    try:
        write_table(partial, columns)
        partial.replace(folder / FILE)
    finally:
        partial.unlink(missing_ok=True)


def load_outcomes(folder: Path) -> dict[str, dict[tuple[int, str], str]]:
    """Read what `save_outcomes` wrote; empty where a run has none of it, as those that weren't scored. Raises RunError
    where the file isn't a table of outcomes.
    """
    path = folder / FILE
    if not path.is_file():
        return {}
    table = read_table(path)
    if table.schema.remove_metadata() != pa.schema(list(_COLUMNS.items())):
        raise RunError(f"{path}: can't be read (not a table of outcomes); score the run again")
    found: dict[str, dict[tuple[int, str], str]] = {}
    for name, row, camera, outcome in zip(*(table.column(name).to_pylist() for name in _COLUMNS), strict=True):
        found.setdefault(name, {})[row, camera] = outcome
    return found
