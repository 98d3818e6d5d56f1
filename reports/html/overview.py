"""The head of the report: which runs, what they are called here, and what must be known before their numbers are."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fbench.replay.predictions import Predictions, predictions_of
from fbench.replay.store import Run
from fbench.reports.html.records import FaultRow, FaultTable, read_record
from fbench.reports.html.text import DASH, brief, visible


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
    lost: int | None
    """How many faults lost data; `None` where the run has no `faults.json`."""
    losses: Sequence[FaultRow]
    predictions: Predictions | None
    """What stands for detections though nothing was detected."""


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
