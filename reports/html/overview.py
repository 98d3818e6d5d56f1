"""The head of the report: runs, faults, notices, latency, and the course of all frames."""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fbench.replay.contracts.faults import FAULTS
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.runs.folder import FrameRecord, Run
from fbench.replay.runs.shares import Predictions, predictions_of
from fbench.replay.runs.tables import BoxTable
from fbench.reports.html.records import (
    DASH,
    FaultRow,
    FaultTable,
    Host,
    LatencyTable,
    Stage,
    brief,
    number,
    read_record,
    visible,
)

_BUDGET_SHARE, _P95_SHARE = 0.85, 0.7
"""Where budget and largest 95th percentile lie at most on the scale; what is slower than its end is cut off."""


@dataclass(frozen=True)
class Bar:
    """One stage on the common scale, positions in percent of its width."""

    stage: Stage
    p50: float
    p95: float
    p99: float
    max: float
    cut: bool  # The slowest frame lies beyond the scale


@dataclass(frozen=True)
class LatencyPanel:
    """The latency of one run."""

    label: str
    table: LatencyTable | None
    host: Sequence[tuple[str, str]]
    bars: Sequence[Bar]
    budget: float  # Position of the budget in percent
    scale_ms: float


def latency_panels(runs: Sequence[Run], labels: Sequence[str]) -> list[LatencyPanel]:
    """Gather latency and host of every run; all bars share one scale."""
    tables = [read_record(run, "latency.json", LatencyTable) for run in runs]
    ends = [end for table in tables if table for end in _ends(table)]
    scale = max(ends, default=1.0) or 1.0
    return [
        _panel(label, table, read_record(run, "host.json", Host), scale)
        for run, label, table in zip(runs, labels, tables, strict=True)
    ]


def _ends(table: LatencyTable) -> list[float]:
    return [table.budget_ms / _BUDGET_SHARE, *((s.p95_ms or 0.0) / _P95_SHARE for s in table.stages)]


def _panel(label: str, table: LatencyTable | None, host: Host | None, scale: float) -> LatencyPanel:
    bars = [_bar(stage, scale) for stage in table.stages] if table else []
    facts = [(name.removesuffix("_s"), _fact(name, value)) for name, value in host.root.items()] if host else []
    budget = min(100.0, 100.0 * table.budget_ms / scale) if table else 0.0
    return LatencyPanel(label, table, facts, bars, round(budget, 2), scale)


def _bar(stage: Stage, scale: float) -> Bar:
    def at(value: float | None) -> float:
        return round(min(100.0, 100.0 * (value or 0.0) / scale), 2)

    cut = (stage.max_ms or 0.0) > scale
    return Bar(stage, at(stage.p50_ms), at(stage.p95_ms), at(stage.p99_ms), at(stage.max_ms), cut)


def _fact(name: str, value: str | float | bool | None) -> str:
    if isinstance(value, float):
        return number(value, 2) + (" s" if name.endswith("_s") else "")
    return str(value)


def timeline(run: Run) -> dict[str, Any]:
    """Return counts, segments, missing sensors and failures of all frames."""
    frames = run.frames
    start_ns = frames[0].stamp_ns if frames else 0
    rows = row_numbers(run)
    return {
        "first": frames[0].index if frames else 0,
        "t": [(f.stamp_ns - start_ns) / 1e9 for f in frames],
        "segment": [f.segment for f in frames],
        "truth": [_num_truth(run, f) for f in frames],
        "detections": _counts(run.detections, rows) if frames else [],
        "tracks": _counts(run.tracks, rows) if frames else [],
        "missing": [[rows[f.index], sensor, why] for f in frames for sensor, why in sorted(f.missing.items())],
        "failed": [[rows[f.index], f.failed] for f in frames if f.failed is not None],
    }


def row_numbers(run: Run) -> dict[int, int]:
    """Position of each frame in a run, by its index; a part of a log doesn't begin with frame 0."""
    return {frame.index: row for row, frame in enumerate(run.frames)}


def frame_times(run: Run) -> list[float]:
    """Wall time of each frame [ms]; empty where it wasn't measured for every frame."""
    total = run.timings.get("total", [])
    return [ns / 1e6 for ns in total] if len(total) == len(run.frames) else []


def _counts(table: BoxTable, rows: dict[int, int]) -> list[int]:
    last = max(rows) + 1
    counts = np.bincount(table.frames, minlength=last)
    return [int(counts[index]) for index in rows]


def _num_truth(run: Run, frame: FrameRecord) -> int | None:
    """Truth boxes that count, 3D ones where there are; `None` where the frame isn't labelled."""
    boxes: Boxes3D | Boxes2D | None = run.truth3d(frame.index)
    boxes = run.truth2d(frame.index) if boxes is None else boxes
    if boxes is None:
        return None
    return len(boxes) if boxes.ignore is None else int(np.count_nonzero(~boxes.ignore))


@dataclass(frozen=True)
class Overview:
    """One run in the head of the report."""

    label: str
    log: str
    pipeline: str
    version: str
    frames: int
    segments: int
    labelled: int
    failed: int
    log_digest: str
    digest: str
    complete: bool
    lost: int | None  # How many faults lost data; `None` where the run has no `faults.json`
    losses: Sequence[FaultRow]
    predictions: Predictions | None  # What stands for detections though nothing was detected


@dataclass(frozen=True)
class Row:
    """One line of a table that compares runs."""

    name: str
    values: Sequence[str]

    @property
    def differs(self) -> bool:
        """Whether the runs disagree."""
        return len(dict.fromkeys(self.values)) > 1


def run_labels(runs: Sequence[Run]) -> list[str]:
    """Name the runs by pipeline; by folder where that is ambiguous; numbered where that is, too."""
    pipelines = [visible(run.manifest.pipeline) for run in runs]
    if len(set(pipelines)) == len(runs):
        return pipelines
    folders = [visible(run.folder.resolve().name) for run in runs]
    if len(set(folders)) == len(runs):
        return folders
    return [f"{i}: {name}" for i, name in enumerate(folders, 1)]


def overview(run: Run, label: str) -> Overview:
    """Gather the head of one run."""
    manifest = run.manifest
    faults = read_record(run, "faults.json", FaultTable)
    frames = Counter({"labelled": 0, "failed": 0})
    for record in run.frames:
        frames["labelled"] += record.truth_stamp_ns is not None
        frames["failed"] += record.failed is not None
    return Overview(
        label=label,
        log=manifest.log.name,
        pipeline=manifest.pipeline,
        version=manifest.versions.get("fbench", DASH),
        frames=manifest.num_frames,
        segments=manifest.num_segments,
        labelled=frames["labelled"],
        failed=frames["failed"],
        log_digest=brief(manifest.log.digest),
        digest=brief(manifest.digest),
        complete=manifest.complete,
        lost=faults.lost if faults else None,
        losses=[row for row in faults.rows if row.count and row.behaviour == "count"] if faults else [],
        predictions=predictions_of(run),
    )


def title(runs: Sequence[Run]) -> str:
    """Return the log's name, or the number of logs where they differ."""
    names = list(dict.fromkeys(run.manifest.log.name for run in runs))
    return names[0] if len(names) == 1 else f"{len(names)} logs"


def what_ran(runs: Sequence[Run]) -> dict[str, list[Row]]:
    """Return everything that the manifests say, group by group, one column a run."""
    manifests = [run.manifest for run in runs]
    groups = {
        "Parameters": [m.parameters for m in manifests],
        "Frames": [m.frames.model_dump() for m in manifests],
        "Versions": [m.versions for m in manifests],
        "Log": [m.log.model_dump() for m in manifests],
        "Result": [
            {"complete": m.complete, "num_frames": m.num_frames, "num_segments": m.num_segments, "digest": m.digest,
             "format": m.format} for m in manifests
        ],
    }  # fmt: skip
    return {name: _rows([_flat(mapping) for mapping in columns]) for name, columns in groups.items()}


def _rows(columns: Sequence[Mapping[str, str]]) -> list[Row]:
    names = dict.fromkeys(name for column in columns for name in column)
    return [Row(name, [column.get(name, DASH) for column in columns]) for name in names]


def _flat(value: Any, prefix: str = "") -> dict[str, str]:
    """Flatten nested mappings to dotted names."""
    if isinstance(value, Mapping) and value:
        parts = (_flat(v, f"{prefix}.{k}" if prefix else str(k)) for k, v in value.items())
        return {name: text for part in parts for name, text in part.items()}
    if not prefix:
        return {}
    return {prefix: value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)}


@dataclass(frozen=True)
class Notice:
    """One banner."""

    level: str  # `bad`, `warn` or `info`
    head: str
    text: str
    losses: Sequence[FaultRow] = ()
    who: Sequence[str] = ()  # Labels of the runs it is about


def notices(overviews: Sequence[Overview]) -> list[Notice]:
    """Return all banners, the worst first; runs about which the same must be said share one."""
    merged: dict[tuple[str, str, str, tuple[str, ...]], Notice] = {}
    for overview in overviews:
        for notice in _of(overview):
            key = (notice.level, notice.head, notice.text, tuple(row.model_dump_json() for row in notice.losses))
            before = merged.get(key, notice)
            merged[key] = replace(notice, who=(*before.who, overview.label))
    found = [*merged.values(), *_different(overviews)]
    return sorted(found, key=lambda notice: ("bad", "warn", "info").index(notice.level))


def _of(o: Overview) -> Iterator[Notice]:
    faults = "" if o.lost is None else f"{o.lost} {'fault' if o.lost == 1 else 'faults'}"
    if not o.complete:
        text = "The run is not complete; its numbers describe only what was left."
        yield Notice("bad", f"Data was lost: {faults}." if faults else "Data was lost.", text, o.losses)
    elif o.lost:
        yield Notice("warn", f"Data was lost, and tolerated: {faults}.", "The run was allowed to go on.", o.losses)
    if o.failed:
        head = f"The pipeline failed on {o.failed} of {o.frames} frames."
        yield Notice("warn", head, "Truth in these frames counts as missed.")
    if not o.labelled:
        text = "The log has no ground truth, so accuracy can’t be scored; latency, faults and outputs are all there is."
        yield Notice("info", "No truth.", text)
    elif o.labelled < o.frames:
        head = f"{o.labelled} of {o.frames} frames have truth."
        yield Notice("info", head, "The others were replayed and not scored.")
    if o.predictions is not None:
        yield Notice("info", "Tracks predicted in between stand for detections.", f"They are {o.predictions}.")


def _different(overviews: Sequence[Overview]) -> list[Notice]:
    if len({o.log_digest for o in overviews}) < 2:
        return []
    text = "Their log digests differ, so their numbers don’t compare pipelines alone."
    return [Notice("warn", "These runs replayed different data.", text)]


@dataclass(frozen=True)
class FaultLine:
    """One code with its counts, one a run."""

    code: str
    text: str
    loses_data: bool
    counts: Sequence[str]
    places: Sequence[tuple[str, Sequence[str]]]  # First places by label of the run
    total: int


def fault_lines(runs: Sequence[Run], labels: Sequence[str]) -> list[FaultLine]:
    """Return all codes of the fault table, and those of the runs that this version doesn't know."""
    tables = [read_record(run, "faults.json", FaultTable) for run in runs]
    columns = [{row.code: row for row in table.rows} if table else {} for table in tables]
    known = {
        code: FaultRow(code=code, behaviour=kind.behaviour, text=kind.text, count=0) for code, kind in FAULTS.items()
    }
    rows = known | {code: row for column in columns for code, row in column.items() if code not in known}
    return [_line(row, [column.get(row.code) for column in columns], labels) for row in rows.values()]


def _line(row: FaultRow, cells: Sequence[FaultRow | None], labels: Sequence[str]) -> FaultLine:
    places = [(label, cell.places) for label, cell in zip(labels, cells, strict=True) if cell and cell.places]
    counts = [DASH if cell is None else str(cell.count) for cell in cells]
    return FaultLine(
        row.code, row.text, row.behaviour == "count", counts, places, sum(cell.count for cell in cells if cell)
    )


_PERIOD_KEY = "radar.velocity_period_mps"


def velocity_periods(runs: Sequence[Run]) -> list[str]:
    """Return the periods [m/s] with which radial velocities alias, as the metadata of the runs' logs say."""
    texts = dict.fromkeys(run.manifest.log.metadata.get(_PERIOD_KEY, "") for run in runs)
    return list(dict.fromkeys(number(period, 2) for period in map(_period, texts) if period))


def _period(text: str) -> float:
    """Return 0 where `text` is no positive number."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if math.isfinite(value) and value > 0 else 0.0
