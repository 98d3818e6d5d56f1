"""Relabeling of a run with other ground truth, without replaying the log."""

import json
import os
from array import array
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.faults import FAULTS, FaultBudget, FaultLog
from fbench.replay.data.classes import ClassMap
from fbench.replay.data.files import replace_text
from fbench.replay.data.messages import Truth
from fbench.replay.data.metadata import CAMERA0
from fbench.replay.engine.poses import pose_of
from fbench.replay.formats.open import open_boxes, truth_entry
from fbench.replay.logs.coordinate_frames import BODY, CoordinateFrames, find_moved, tree_of
from fbench.replay.logs.setup import BoxSource
from fbench.replay.runs.folder import FRAMES, Run, with_truth, write_frames
from fbench.replay.runs.manifest import InterpolationEntry, TruthEntry, save_manifest
from fbench.replay.runs.redaction import redact_rows
from fbench.replay.runs.tables import BoxWriter
from fbench.replay.truth.labelling import Instant, drop_invalid, stray
from fbench.replay.truth.times import TruthTimes

_ABOUT_TRUTH = ("GT004", "GT005", "GT006", "GT007", "GT008")
_TABLES = ("truth.parquet", "truth_2d.parquet")


@dataclass(frozen=True)
class Relabelled:
    """How much of a file of truth a run could use."""

    num_truths: int  # Instants in the file
    num_matched: int  # Frames of the run that it labels
    num_between: int = 0  # Those among them that have no truth of their own, but lie between truths


def relabel(
    run: Run, source: BoxSource, classes: Mapping[str, str] | None = None, max_between_ns: int = 0
) -> Relabelled:
    """Replace the truth of a finished run by that of a file. Scores stay as they were until the run is scored again.
    `classes` are labels by the names that the file gives to classes. Frames between truths that aren't farther apart
    than `max_between_ns` get truth by interpolation; 0: none does.

    Raises ConfigError where the file isn't there, or names a camera or coordinate frame that the run doesn't know,
    LogError where it can't be read, or is in the world and the run has no poses, MetricError where none of its instants
    belongs to a frame of the run.
    """
    rig, faults = run.manifest.rig, FaultLog()
    is_camera0 = run.manifest.log.metadata.get(CAMERA0) == BODY
    first = tree_of(rig)
    moved = find_moved(first, BODY, ((tree_of(entry.rig), BODY) for entry in run.manifest.rig_changes))
    coordinates = CoordinateFrames(rig, first, BODY, camera0_is_body=is_camera0, moved=lambda: moved)
    file = open_boxes(source, coordinates, faults)
    map_, where = ClassMap(classes or {}), source.path.name
    places, counts_frames = array("q"), False  # Of the truths in the file: stamps, or indices

    def prepare(truth: Truth) -> Truth:
        nonlocal counts_frames
        counts_frames = truth.frame_index is not None
        places.append(truth.stamp_ns if truth.frame_index is None else truth.frame_index)
        return map_.label_truth(truth, lambda name: faults.once("GT007", (where, name), f"{where}: '{name}'"))

    # Truth refers to stamps as recorded, before an offset was added.
    offset_ns = run.manifest.frames.offsets_ns.get(run.manifest.frames.reference, 0)
    instants = [Instant(f.index, f.stamp_ns - offset_ns, f.frame_number, True, f.segment) for f in run.frames]
    poses = dict(zip((frame.index for frame in run.frames), map(pose_of, run.poses), strict=True))
    has_poses, is_whole = any(pose is not None for pose in poses.values()), run.manifest.frames.excerpt == "all"
    stamps = [frame.stamp_ns for frame in run.frames]
    with closing(_Tables(run)) as tables:
        times = TruthTimes(instants, run.poses, max_between_ns)
        for index, truth in times.match(map(prepare, file.truths())):
            if index is None:
                if is_whole or (truth.frame_index is None and min(stamps) <= truth.stamp_ns <= max(stamps)):
                    faults.add("GT006", stray(truth))
            elif (kept := drop_invalid(truth, index, poses[index], has_poses, faults)) is not None:
                tables.add(index, kept)
        if not tables.labeled:
            raise MetricError(_explain_unmatched(run, source.path, places, counts_frames))
        between = InterpolationEntry(max_gap_ns=max_between_ns, num_frames=sum(map(times.is_between, tables.labeled)))
        tables.finish(faults, truth_entry(file.source, classes), between)
    return Relabelled(len(places), len(tables.labeled), between.num_frames)


class _Tables:
    """Tables of truth under temporary names, renamed when all are whole."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._writers: dict[str, BoxWriter] = {}
        self._records = {record.index: with_truth(record, None) for record in run.frames}
        self.labeled: set[int] = set()

    def close(self) -> None:
        for writer in self._writers.values():
            writer.close()
        for name in (*_TABLES, FRAMES):
            self._partial(name).unlink(missing_ok=True)

    def add(self, index: int, truth: Truth) -> None:
        """Label a frame."""
        for name, boxes in zip(_TABLES, (truth.boxes3d, truth.boxes2d), strict=True):
            if boxes is not None:
                if name not in self._writers:
                    self._writers[name] = BoxWriter(self._partial(name), type(boxes))
                self._writers[name].add(index, boxes)
        self._records[index] = with_truth(self._records[index], truth)
        self.labeled.add(index)

    def finish(self, faults: FaultLog, entry: TruthEntry, between: InterpolationEntry) -> None:
        """Put the tables in place; the manifest comes last."""
        write_frames(self._partial(FRAMES), list(self._records.values()), self._run.poses)
        content, manifest = _with_faults(self._run, faults), self._run.manifest
        for writer in self._writers.values():
            writer.close()
        for name in _TABLES:
            if name in self._writers:
                self._partial(name).replace(self._run.folder / name)
            else:
                (self._run.folder / name).unlink(missing_ok=True)
        self._writers = {}
        self._partial(FRAMES).replace(self._run.folder / FRAMES)
        replace_text(self._run.folder / "faults.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
        counts = FaultLog()
        counts.counts.update({row["code"]: row["count"] for row in content["rows"]})
        # A run that was complete lacks something if boxes of truth were lost.
        is_complete = not counts.counts["GT004"] and (manifest.complete or not FaultBudget().find_exceeded(counts))
        changes = {"truth": entry, "interpolation": between, "complete": is_complete}
        partial = self._partial("manifest.json")
        save_manifest(partial, manifest.model_copy(update=changes))
        partial.replace(self._run.folder / "manifest.json")

    def _partial(self, name: str) -> Path:
        return self._run.folder / f".{name}.partial-{os.getpid()}"


def _explain_unmatched(run: Run, path: Path, places: "array[int]", counts_frames: bool) -> str:
    frames, num = run.frames, len(places)
    if not num:
        return f"{path}: no boxes in it"
    first, last = min(places), max(places)
    if counts_frames:
        there = f"{frames[0].index} to {frames[-1].index}"
        return f"{path}: none of its {num} frames, {first} to {last}, is in the run, which has {there}"
    stamps = [frame.stamp_ns for frame in frames]
    apart_s = (stamps[0] - first) / 1e9
    return (
        f"{path}: none of its {num} instants, {first} to {last} ns, belongs to a frame of the run, "
        f"{min(stamps)} to {max(stamps)} ns, {apart_s:+.3f} s from there; shift the stamps, or count frames"
    )


def _with_faults(run: Run, faults: FaultLog) -> dict[str, Any]:
    """What `faults.json` says, with other faults of truth."""
    content: dict[str, Any] = run.json("faults.json")
    reported = redact_rows(faults.rows()) if run.manifest.redacted else faults.rows()
    new: dict[str, dict[str, Any]] = {str(row["code"]): row for row in reported if row["code"] in _ABOUT_TRUTH}
    old = {row["code"]: row for row in content["rows"]}
    rows = [new.get(code, old.get(code, row)) for row in FaultLog().rows() for code in [str(row["code"])]]
    lost = sum(row["count"] for row in rows if FAULTS[row["code"]].behaviour == "count")
    return {**content, "lost": lost, "rows": rows}
