"""The head of the report: runs, faults, notices, what ran, and the course of all frames, as the templates show them."""

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from fbench.replay.conditions.effects import describe
from fbench.replay.contracts.faults import FAULTS, UNVERIFIED
from fbench.replay.data.criticality import load_critical_errors
from fbench.replay.data.scores import format_count
from fbench.replay.engine.service_queue import pair_outputs
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import Manifest
from fbench.replay.runs.shares import Predictions, predictions_of
from fbench.replay.runs.tables import BoxTable
from fbench.reports.html import records
from fbench.reports.html.records import DASH, FaultRow, FaultTable, number, read_record, visible
from fbench.reports.html.scoreboard import settings_of

_SPACES: tuple[Literal["3d", "2d"], ...] = ("3d", "2d")
_MOST_TEXT = 300  # Characters of a value, such as the regions of a log


def timeline(run: Run) -> dict[str, Any]:
    """Return counts, segments, missing sensors and failures of all frames; `truth` counts the boxes that count, 3D ones
    where there are, `None` where the frame isn't labelled. Of frames that were `dropped` there are no counts, but the
    row of the latest output that was ready then, `None` where there was none.
    """
    frames, rows, current = run.frames, row_numbers(run), current_rows(run)
    start_ns = frames[0].stamp_ns if frames else 0

    def count(table: BoxTable) -> list[int | None]:
        counts = np.bincount(table.frames, minlength=max(rows, default=-1) + 1)
        return [None if frame.is_dropped else int(counts[frame.index]) for frame in frames]

    def count_truth(space: Literal["3d", "2d"]) -> list[int]:
        table = run.truth_table(space)
        kept = table.frames if table.boxes.ignore is None else table.frames[~table.boxes.ignore]
        return [int(num) for num in np.bincount(kept, minlength=max(rows, default=-1) + 1)]

    own = {space: count_truth(space) for space in _SPACES if any(space in f.truth_spaces.split() for f in frames)}
    spaces = [next((space for space in own if space in f.truth_spaces.split()), None) for f in frames]
    return {
        "first": frames[0].index if frames else 0,
        "t": [(f.stamp_ns - start_ns) / 1e9 for f in frames],
        "segment": [f.segment for f in frames],
        "truth": [None if space is None else own[space][f.index] for f, space in zip(frames, spaces, strict=True)],
        "detections": count(run.detections) if frames else [],
        "tracks": count(run.tracks) if frames else [],
        "missing": [[rows[f.index], sensor, why] for f in frames for sensor, why in sorted(f.missing.items())],
        "failed": [[rows[f.index], f.failed] for f in frames if f.failed is not None],
        "dropped": [[row, current[row]] for row, frame in enumerate(frames) if frame.is_dropped],
    }


def current_rows(run: Run) -> list[int | None]:
    """Return for each frame the row of the frame whose output is shown with it: its own; of one that was dropped, the
    latest that was ready at its instant, `None` where there was none.
    """
    latest = pair_outputs(run.frames).tolist() if run.manifest.latency is not None else []
    return [
        row if not frame.is_dropped else latest[row] if latest[row] >= 0 else None
        for row, frame in enumerate(run.frames)
    ]


def row_numbers(run: Run) -> dict[int, int]:
    """Position of each frame in a run, by its index; a part of a log doesn't begin with frame 0."""
    return {frame.index: row for row, frame in enumerate(run.frames)}


@dataclass(frozen=True)
class Overview:
    """One run in the head of the report."""

    label: str
    manifest: Manifest
    labelled: int
    failed: int
    dropped: int | None  # `None` in lockstep
    faults: FaultTable | None  # `None` where the run has no `faults.json`
    predictions: Predictions | None  # What stands for detections though nothing was detected


def run_labels(runs: Sequence[Run]) -> list[str]:
    """Name the runs by pipeline; where that is ambiguous with what they saw, then by folder, and then numbered."""
    pipelines = [visible(run.manifest.pipeline) for run in runs]
    of = {row: setting.name for setting in settings_of(runs) for row in setting.rows}
    seen = [f"{name} · {of[row]}" for row, name in enumerate(pipelines)]
    folders = [visible(run.folder.resolve().name) for run in runs]
    for names in (pipelines, seen, folders):
        if len(set(names)) == len(runs):
            return names
    return [f"{i}: {name}" for i, name in enumerate(folders, 1)]


def overview(run: Run, label: str) -> Overview:
    """Gather the head of one run."""
    labelled = sum(record.truth_stamp_ns is not None for record in run.frames)
    failed = sum(record.failed is not None for record in run.frames)
    faults = read_record(run, "faults.json", FaultTable)
    dropped = None if run.manifest.latency is None else run.manifest.latency.num_dropped
    return Overview(label, run.manifest, labelled, failed, dropped, faults, predictions_of(run))


def conditions(runs: Sequence[Run], labels: Sequence[str]) -> list[dict[str, Any]]:
    """Gather what disturbed the messages of each run, `entries` of the manifest and `seed`, and its `effects` by
    sensor; of runs without conditions nothing.
    """
    disturbed = [(label, run.manifest) for run, label in zip(runs, labels, strict=True) if run.manifest.conditions]
    return [
        {"label": label, "entries": m.conditions, "seed": m.seed,
         "effects": [(sensor, describe(row)) for sensor, row in m.effects.items()]} for label, m in disturbed
    ]  # fmt: skip


def critical_errors(runs: Sequence[Run], labels: Sequence[str]) -> list[dict[str, Any]]:
    """Return the critical errors of each run by side, the most urgent first; of runs that weren't scored nothing."""
    found = []
    for run, label in zip(runs, labels, strict=True):
        errors = load_critical_errors(run.folder)
        for side in ("tracks", "detections") if errors is not None else ():
            own = sorted((e for e in errors or () if e.side == side), key=lambda e: (e.ttc_s, -e.deceleration_mps2))
            found.append({"label": label, "side": side, "errors": own})
    return found


def title(runs: Sequence[Run]) -> str:
    """Return the log's name, or the number of logs where they differ."""
    names = list(dict.fromkeys(run.manifest.log.name for run in runs))
    return names[0] if len(names) == 1 else f"{len(names)} logs"


def what_ran(runs: Sequence[Run]) -> dict[str, list[dict[str, Any]]]:
    """Return everything that the manifests say, group by group, with one of the `cells` a run."""
    manifests = [run.manifest for run in runs]
    groups: dict[str, list[Mapping[str, Any]]] = {
        "Parameters": [m.parameters for m in manifests],
        "Frames": [m.frames.model_dump() for m in manifests],
        "Versions": [m.versions for m in manifests],
        "Log": [m.log.model_dump() for m in manifests],
        "Result": [
            {"complete": m.complete, "num_frames": m.num_frames, "num_segments": m.num_segments, "digest": m.digest,
             "format": m.format} for m in manifests
        ],
    }  # fmt: skip
    if any(m.execution.device != "cpu" for m in manifests):
        groups["Networks"] = [m.execution.model_dump() for m in manifests]
    tables = {}
    for group, mappings in groups.items():
        columns = [_flat(mapping) for mapping in mappings]
        names = dict.fromkeys(name for column in columns for name in column)
        rows = {name: [column.get(name, DASH) for column in columns] for name in names}
        tables[group] = [{"name": name, "cells": row, "differs": len(set(row)) > 1} for name, row in rows.items()]
    return tables


def _flat(value: Any, prefix: str = "") -> dict[str, str]:
    """Flatten nested mappings to dotted names."""
    if isinstance(value, Mapping) and value:
        parts = (_flat(v, f"{prefix}.{k}" if prefix else str(k)) for k, v in value.items())
        return {name: text for part in parts for name, text in part.items()}
    if not prefix:
        return {}
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return {prefix: text if len(text) <= _MOST_TEXT else f"{text[:_MOST_TEXT]}… ({len(text)} characters)"}


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
        for notice in _notices_of(overview):
            key = (notice.level, notice.head, notice.text, tuple(row.model_dump_json() for row in notice.losses))
            before = merged.get(key, notice)
            merged[key] = replace(notice, who=(*before.who, overview.label))
    found = list(merged.values())
    if len({o.manifest.data_key for o in overviews}) > 1:
        text = "Their log digests differ, so their numbers don’t compare pipelines alone."
        found.append(Notice("warn", "These runs replayed different data.", text))
    return sorted(found, key=lambda notice: ("bad", "warn", "info").index(notice.level))


def _notices_of(o: Overview) -> Iterator[Notice]:
    lost, num_frames = o.faults.lost if o.faults else 0, o.manifest.num_frames
    losses = [row for row in o.faults.rows if row.count and row.behaviour == "count"] if o.faults else []
    faults = format_count(lost, "fault")
    if not o.manifest.complete:
        text = "The run is not complete; its numbers describe only what was left."
        yield Notice("bad", f"Data was lost: {faults}." if o.faults else "Data was lost.", text, losses)
    elif lost:
        yield Notice("warn", f"Data was lost, and tolerated: {faults}.", "The run was allowed to go on.", losses)
    if o.faults and any(row.code == UNVERIFIED and row.count for row in o.faults.rows):
        text = "Flipped bits would go unnoticed. fbench log convert writes a log with checksums."
        yield Notice("info", "The log has no checksums.", text)
    if o.failed:
        head = f"The pipeline failed on {o.failed} of {format_count(num_frames, 'frame')}."
        yield Notice("warn", head, "Truth in these frames counts as missed.")
    if o.dropped is not None:
        head = f"The pipeline took time: {o.dropped} of {format_count(num_frames, 'frame')} were dropped."
        text = f"Latency {o.manifest.latency}. Nothing is found in a dropped frame, by the slice “all” of the scores."
        yield Notice("info", head, text)
    if not o.labelled:
        text = "The log has no ground truth, so accuracy can’t be scored; latency, faults and outputs are all there is."
        yield Notice("info", "No truth.", text)
    elif o.labelled < num_frames:
        head = f"{o.labelled} of {format_count(num_frames, 'frame')} have truth."
        yield Notice("info", head, "The others were replayed and not scored.")
    if o.predictions is not None:
        yield Notice("info", "Tracks predicted in between stand for detections.", f"They are {o.predictions}.")


def fault_lines(runs: Sequence[Run], labels: Sequence[str]) -> list[dict[str, Any]]:
    """Return all codes of the fault table, and those of the runs that this version doesn't know, with `counts`, one a
    run, `who` has them, and the first `places` by label of the run.
    """
    tables = [read_record(run, "faults.json", FaultTable) for run in runs]
    columns = [{row.code: row for row in table.rows} if table else {} for table in tables]
    known = {code: FaultRow(code=code, behaviour=f.behaviour, text=f.text, count=0) for code, f in FAULTS.items()}
    other = {code: row for column in columns for code, row in column.items() if code not in known}
    lines = []
    for code, row in (known | other).items():
        cells = [column.get(code) for column in columns]
        counts = [DASH if cell is None else str(cell.count) for cell in cells]
        places = [(label, cell.places) for label, cell in zip(labels, cells, strict=True) if cell and cell.places]
        total = sum(cell.count for cell in cells if cell)
        who = [(label, cell.count) for label, cell in zip(labels, cells, strict=True) if cell and cell.count]
        line = {"code": code, "text": row.text, "loses_data": row.behaviour == "count", "who": who}
        lines.append({**line, "counts": counts, "places": places, "total": total})
    return lines


def commands(runs: Sequence[Run]) -> list[str]:
    """Return the commands that replay the runs, each once; parameters are their defaults, or among what ran."""
    found = []
    for m in (run.manifest for run in runs):
        words = ["fbench", "replay", m.log.name, "-p", m.pipeline]
        words += [word for condition in m.conditions for word in ("--condition", str(condition))]
        words += ["--seed", str(m.seed)] if m.seed else []
        words += [word for pattern in m.frames.sensors for word in ("--sensors", pattern)]
        found.append(shlex.join(words))
    return list(dict.fromkeys(found))


def velocity_periods(runs: Sequence[Run]) -> list[str]:
    """Return the periods [m/s] with which radial velocities alias, as the metadata of the runs' logs say."""
    texts = dict.fromkeys(run.manifest.log.metadata.get("radar.velocity_period_mps", "") for run in runs)
    return list(dict.fromkeys(number(period, 2) for text in texts if (period := records.positive(text))))
