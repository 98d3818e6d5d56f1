"""Tables of a suite: `cells.parquet`, a row a cell, and `scores.parquet`, a row a number."""

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from fbench.api.scores import ScoreRequest, score
from fbench.api.suites.cells import CELLS, SCORES, CellResult
from fbench.api.suites.suite import SuiteCell
from fbench.replay.contracts.errors import FbenchError, output_error
from fbench.replay.data.files import Draft
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.runs.folder import Run

_OF_CELL = [(name, pa.string()) for name in ("log", "pipeline", "condition", "rate")] + [("seed", pa.int64())]
CELL_SCHEMA = pa.schema([*_OF_CELL, *((name, pa.string()) for name in ("state", "reason", "key", "run"))])
SCORE_SCHEMA = pa.schema([
    *_OF_CELL, *((name, pa.string()) for name in ("metric", "class", "slice", "matching")), ("value", pa.float64()),
    *((name, pa.string()) for name in ("reason", "unit", "counts")),
])  # fmt: skip
_ROWS_AT_ONCE = 50_000  # So that memory doesn't grow with the suite

Done = Sequence[tuple[SuiteCell, CellResult]]


def write_tables(folder: Path, done: Done, options: ScoreOptions, profiles: Sequence[str] = ()) -> None:
    """Write both tables into the folder of a suite; equal runs give equal bytes. Of a cell, `state` is `replayed`
    whether it was now or earlier. Raises ConfigError where they can't be written.
    """
    _write(folder / CELLS, CELL_SCHEMA, (cell_row(folder, *pair) for pair in done))
    _write(folder / SCORES, SCORE_SCHEMA, _score_rows(done, options, profiles))


def cell_row(folder: Path, cell: SuiteCell, result: CellResult) -> dict[str, object]:
    """Return a cell's row of `cells.parquet`."""
    run = result.folder.relative_to(folder).as_posix() if result.has_run else ""
    state = "replayed" if result.has_run else result.state
    return {**_names(cell), "state": state, "reason": result.reason or "", "key": result.key or "", "run": run}


def _names(cell: SuiteCell) -> dict[str, object]:
    return {
        "log": cell.log, "pipeline": cell.pipeline, "condition": cell.condition, "rate": cell.rate, "seed": cell.seed
    }  # fmt: skip


def _score_rows(done: Done, options: ScoreOptions, profiles: Sequence[str]) -> Iterator[dict[str, object]]:
    for cell, result in done:
        if not result.has_run:
            continue
        names = _names(cell)
        rows = list(Run(result.folder).scores)
        for profile in profiles:
            rows += _score_by(result.folder, options, profile)
        for row in rows:
            yield {
                **names, "metric": row.metric, "class": row.class_, "slice": row.slice, "matching": row.matching,
                "value": row.value, "reason": row.reason, "unit": row.unit, "counts": json.dumps(dict(row.counts)),
            }  # fmt: skip


def _score_by(run: Path, options: ScoreOptions, profile: str) -> Iterable[Score]:
    """Scores by a profile, which its name tells apart; where it can't judge the run, a row says why."""
    try:
        rows = score(ScoreRequest([run], options, profile)).rows
    except FbenchError as error:
        return [Score("profile", "all", "all", profile, None, str(error), "1")]
    return [
        Score(row.metric, row.class_, row.slice, f"{profile}: {row.matching}", row.value, row.reason, row.unit,
              row.counts)
        for row in rows
    ]  # fmt: skip


def _write(path: Path, schema: pa.Schema, rows: Iterator[dict[str, object]]) -> None:
    with Draft(path) as draft:
        try:
            with pq.ParquetWriter(str(draft.path), schema, compression="zstd", write_page_checksum=True) as writer:
                waiting: list[dict[str, object]] = []
                for row in rows:
                    waiting.append(row)
                    if len(waiting) == _ROWS_AT_ONCE:
                        writer.write_table(pa.Table.from_pylist(waiting, schema))
                        waiting = []
                writer.write_table(pa.Table.from_pylist(waiting, schema))
        except OSError as error:
            raise output_error(path, error) from error
        draft.publish()
