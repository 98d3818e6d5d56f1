"""Latency as tables and bars, and what happened over all frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.runs.folder import FrameRecord, Run
from fbench.replay.runs.tables import BoxTable
from fbench.reports.html.records import Host, LatencyTable, Stage, number, read_record

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
    cut: bool
    """The slowest frame lies beyond the scale."""


@dataclass(frozen=True)
class LatencyPanel:
    """The latency of one run."""

    label: str
    table: LatencyTable | None
    host: Sequence[tuple[str, str]]
    bars: Sequence[Bar]
    budget: float
    """Position of the budget in percent."""
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
