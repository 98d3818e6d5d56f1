"""Every table of a report as CSV, Parquet and Markdown, with the numbers as they are stored, not as they are shown.

What was measured on the host's clock is kept apart, in the folder `timing`: all else is equal for equal runs.
"""

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TypeAlias

import pyarrow as pa
from pydantic import BaseModel, ConfigDict, ValidationError

from fbench.replay.contracts.errors import ConfigError, output_error, wrong_field
from fbench.replay.data.criticality import load_critical_errors
from fbench.replay.data.files import Draft, file_name
from fbench.replay.data.scores import DASH, score_rows
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import write_table
from fbench.reports.html import overview
from fbench.reports.html.records import Host, LatencyTable, read_record, visible
from fbench.reports.markdown import plain_text

Value: TypeAlias = str | int | float | bool | None
TIMING = "timing"
_FORMULA = tuple("=+-@|%\uff1d\uff0b\uff0d\uff20")  # What a spreadsheet may take for one, the wide forms included
_COLUMNS = {
    "runs": (
        "run pipeline log frames:int segments:int labeled:int failed:int complete:bool log_digest run_digest fbench"
    ),
    "scores": "run metric class slice matching value:float low:float high:float interval unit reason counts",
    "criticality": (
        "run side kind label track_id:int stamp_ns:int from_s:float to_s:float first_frame:int last_frame:int "
        "num_frames:int range_m:float ttc_s:float deceleration_mps2:float lateral_mps2:float"
    ),
    "conditions": "run condition version:int seed:int level",
    "effects": "run sensor effect value:float",
    "frames": "run frame:int stamp_ns:int segment:int truth:int detections:int tracks:int missing failed",
    "faults": "run code effect text count:int places",
    "what_ran": "run group name value",
    "latency": (
        "run stage count:int mean_ms:float p50_ms:float p90_ms:float p95_ms:float p99_ms:float p999_ms:float "
        "max_ms:float cpu_mean_ms:float first_ms:float budget_ms:float reason"
    ),
    "host": "run name value",
}
"""Tables with their columns, of text or of `NAME:TYPE`; mappings and lists are JSON."""
_SUITE: Mapping[str, type] = {
    "name": str, "space": str, "column": str, "value": float, "low": float, "high": float, "reason": str,
    "published": float, "counts": str,
}  # fmt: skip
_MEASURED = ("latency", "host")
_TIMES = ("mean", "p50", "p90", "p95", "p99", "p999", "max", "cpu_mean", "first")
_KINDS: Mapping[str, type] = {"": str, "int": int, "float": float, "bool": bool}
_TYPES = {str: pa.string(), float: pa.float64(), int: pa.int64(), bool: pa.bool_()}


@dataclass(frozen=True)
class PlainTable:
    """A table with typed columns."""

    name: str
    columns: Mapping[str, type]
    rows: Sequence[tuple[Value, ...]]
    is_measured: bool = False


def write_tables(runs: Sequence[Run], folder: Path) -> list[Path]:
    """Write the tables of runs side by side, each as CSV and Parquet and all together as Markdown; return the paths.

    Text is written with control characters visible. In CSV, text that a spreadsheet would take for a formula begins
    with an apostrophe. Raises ConfigError where a file can't be written; RunError where a run folder is damaged.
    """
    return _write([table for table in tables_of(runs) if table.rows], folder)


def write_suite_tables(results: Path, folder: Path) -> list[Path]:
    """Write the tables in the `results.json` of a suite, as `write_tables` does. Raises ConfigError where it isn't such
    a file, or nothing can be written.
    """
    rows = read_results(results)
    names = ("name", "space", "column", "value", "low", "high", "reason", "published")
    return _write([
        PlainTable(file_name(name), _SUITE, [
            (*(_show(getattr(figure, part)) for part in names), _json(figure.counts)) for figure in figures
        ])
        for name, figures in rows.items() if figures
    ], folder)  # fmt: skip


class FigureRow(BaseModel):
    """One figure of a suite's table, as `table_rows` writes it."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    name: str
    space: str = ""
    column: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    reason: str | None = None
    published: float | None = None
    counts: Mapping[str, int | float] = {}


class _ResultFile(BaseModel):
    tables: Mapping[str, Sequence[FigureRow]]


def read_results(path: Path) -> Mapping[str, Sequence[FigureRow]]:
    """Read the tables of a suite's `results.json` by name. Raises ConfigError where it can't be read."""
    try:
        return _ResultFile.model_validate_json(path.read_bytes()).tables
    except (OSError, ValidationError) as error:
        where, why = wrong_field(error) if isinstance(error, ValidationError) else ("", error.strerror or "")
        raise ConfigError(f"{path}: not the results of a suite ({where or 'content'}: {why})") from error


def _write(tables: Sequence[PlainTable], folder: Path) -> list[Path]:
    paths: list[Path] = []
    for part, place in ((False, folder), (True, folder / TIMING)):
        own = [table for table in tables if table.is_measured == part]
        for table in own:
            paths += [place / f"{table.name}.csv", place / f"{table.name}.parquet"]
            write_whole(paths[-2], partial(_write_text, _csv(table)))
            write_whole(paths[-1], partial(_write_parquet, table))
        if own:
            paths.append(place / "tables.md")
            text = "\n".join(line for table in own for line in _markdown(table)) + "\n"
            write_whole(paths[-1], partial(_write_text, text))
    return paths


def tables_of(runs: Sequence[Run]) -> list[PlainTable]:
    """Return all tables, the column `run` first, where runs are called as in the report."""
    named = list(zip(overview.run_labels(runs), runs, strict=True))
    found: dict[str, list[tuple[object, ...]]] = {name: [] for name in _COLUMNS}
    for label, run in named:
        for name, row in chain(_of_run(run, overview.overview(run, label)), _of_frames(run), _of_timing(run)):
            found[name].append((label, *row))
    labels = [label for label, _ in named]
    for group, rows in overview.what_ran(runs).items():
        for fact in rows:
            cells = zip(labels, fact["cells"], strict=True)
            found["what_ran"] += [(label, group, fact["name"], cell) for label, cell in cells if cell != DASH]
    return [_table(name, found[name]) for name in _COLUMNS]


def _of_run(run: Run, head: overview.Overview) -> Iterator[tuple[str, tuple[object, ...]]]:
    """Yield what ran and what came out, each row with the name of its table."""
    m = run.manifest
    digests = m.log.digest, m.digest, m.versions.get("fbench", "")
    yield (
        "runs",
        (m.pipeline, m.log.name, m.num_frames, m.num_segments, head.labelled, head.failed, m.complete, *digests),
    )
    names = ("metric", "class", "slice", "matching", "value", "low", "high", "interval", "unit", "reason")
    for row in score_rows(run.scores) if (run.folder / "scores.json").is_file() else ():
        yield "scores", (*(row.get(name) for name in names), _json(row["counts"]))
    errors = _COLUMNS["criticality"].replace(":int", "").replace(":float", "").split()[1:]
    for error in load_critical_errors(run.folder) or ():
        yield "criticality", tuple(getattr(error, name) for name in errors)
    for entry in m.conditions:
        yield "conditions", (str(entry), entry.version, m.seed, _json(entry.level))
    for sensor, effects in m.effects.items():
        yield from (("effects", (sensor, name, float(value))) for name, value in effects.items())
    for fault in head.faults.rows if head.faults else ():
        yield "faults", (fault.code, fault.behaviour, fault.text, fault.count, _json(fault.places))


def _of_frames(run: Run) -> Iterator[tuple[str, tuple[object, ...]]]:
    course = overview.timeline(run)
    counts = zip(course["truth"], course["detections"], course["tracks"], strict=True)
    for frame, nums in zip(run.frames, counts, strict=True):
        missing = _json(dict(sorted(frame.missing.items()))) if frame.missing else None
        yield "frames", (frame.index, frame.stamp_ns, frame.segment, *nums, missing, frame.failed)


def _of_timing(run: Run) -> Iterator[tuple[str, tuple[object, ...]]]:
    latency, host = read_record(run, "latency.json", LatencyTable), read_record(run, "host.json", Host)
    for stage in latency.stages if latency else ():
        times = (getattr(stage, f"{name}_ms") for name in _TIMES)
        yield "latency", (stage.stage, stage.count, *times, latency.budget_ms if latency else None, stage.reason)
    for name, value in host.root.items() if host else ():
        yield "host", (name, None if value is None else str(value))


def _table(name: str, rows: Sequence[tuple[object, ...]]) -> PlainTable:
    pairs = [column.partition(":") for column in _COLUMNS[name].split()]
    kinds = {column: _KINDS[kind] for column, _, kind in pairs}
    return PlainTable(name, kinds, [tuple(map(_show, row)) for row in rows], name in _MEASURED)


def _show(value: object) -> Value:
    """Return a value with what acts or hides written visibly, also line breaks and tabs."""
    if isinstance(value, str):
        return visible(value).replace("\n", "\\n").replace("\t", "\\t")
    return value if isinstance(value, int | float) else None


def _json(value: object) -> str:
    return json.dumps(value, allow_nan=False)  # in ASCII: what `visible` would change stays JSON


def _csv(table: PlainTable) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows([_defuse(value) for value in row] for row in table.rows)
    return out.getvalue()


def _defuse(value: Value) -> Value:
    """Return text that would be a formula with an apostrophe before it; numbers are no text."""
    return f"'{value}" if isinstance(value, str) and value.lstrip().startswith(_FORMULA) else value


def _write_text(text: str, path: Path) -> None:
    path.write_bytes(text.encode())


def _write_parquet(table: PlainTable, path: Path) -> None:
    cells = zip(*table.rows, strict=True)
    kinds = [_TYPES[kind] for kind in table.columns.values()]
    columns = {name: pa.array(column, k) for name, k, column in zip(table.columns, kinds, cells, strict=True)}
    write_table(path, columns)


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` write a file, which appears only when whole. Raises ConfigError where it can't be written."""
    try:
        with Draft(path) as draft:
            write(draft.path)
            draft.publish()
    except OSError as error:
        raise output_error(path, error) from error


def _markdown(table: PlainTable) -> Iterator[str]:
    marks = ["---" if kind is str else "---:" for kind in table.columns.values()]
    yield from (f"## {table.name}", "", f"| {' | '.join(table.columns)} |", f"| {' | '.join(marks)} |")
    for row in table.rows:
        yield f"| {' | '.join('' if value is None else plain_text(str(value)) for value in row)} |"
    yield ""
