"""Boxes of logs and runs, read for an export."""

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.sensor_settings import choose_sensors
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D, Source
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import KINDS, Kind, Rig
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frames import FrameStream
from fbench.replay.engine.poses import FramePoses, pose_of
from fbench.replay.formats.export_request import ExportRequest, LeftOut, Which
from fbench.replay.formats.sequence import BoxFrame, BoxSequence
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import inverse
from fbench.replay.logs.reader import LogReader
from fbench.replay.logs.setup import StampParams
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import BoxTable
from fbench.replay.setup.source import LogSource
from fbench.replay.truth.labelling import Instant, Labelling, stray

NO_POSE = "in the world, without a pose of the body"


_FrameTruth = tuple[int, int | None, Truth, Rig]  # Index and number of a frame, and its boxes
_Matched = tuple[Sequence[_FrameTruth], FramePoses, int]  # All of them, where the body was, and the number of frames
MANIFEST = "manifest.json"
_KIND: dict[Source, Kind] = {Source.C: "camera", Source.S: "camera", Source.L: "lidar", Source.R: "radar"}


def log_sequence(source: LogSource, request: ExportRequest, left: LeftOut, faults: FaultLog) -> BoxSequence:
    """Read the boxes of a log that are asked for.

    Where each has a number of its own (as logs of KITTI have), only they and the poses are read; else the whole log, to
    know its frames as a replay does. Raises ConfigError where tracks are asked for. Raises LogError where the log can't
    be read, or has no results.
    """
    if request.boxes == "tracks":
        raise ConfigError(f"{source.path}: is a log, which has no tracks; take --boxes truth, or detections, or a run")
    reader = source.open(faults)
    is_truth = request.boxes != "detections"
    truths = list(reader.truths() if is_truth else reader.detections(""))
    numbers = [truth.frame_number for truth in truths if truth.frame_number is not None and truth.frame_index is None]
    is_numbered = bool(numbers) and len(set(numbers)) == len(truths)
    if request.format == "mot":  # which counts frames, so numbers must be counts too
        is_numbered = is_numbered and sorted(numbers) == list(range(len(numbers)))
    rows, poses, num = _match_by_number(truths, reader) if is_numbered else _match_by_time(truths, source, faults)
    frames = []
    for index, number, truth, rig in rows:
        boxes, pose = truth.boxes3d, poses.world_T_body(index)
        if boxes is not None and truth.in_world:
            left[NO_POSE] += len(boxes) if pose is None else 0
            boxes = Boxes3D.empty() if pose is None else move_boxes(boxes, inverse(pose))
        frames.append(BoxFrame(index, number, truth.stamp_ns, rig, boxes, truth.boxes2d, pose))
    return BoxSequence(str(source.path), reader.info.name, reader.info.metadata, is_truth, frames, num)


def _match_by_number(truths: Iterable[Truth], reader: LogReader) -> _Matched:
    ordered = sorted(truths, key=lambda truth: truth.stamp_ns)
    poses = FramePoses(min(reader.poses, default=None))
    for index, truth in enumerate(ordered):
        poses.open(index, truth.stamp_ns)
    for pose in reader.body_poses() if reader.poses else ():
        poses.add(pose)
    poses.finish()
    rigs = [(0, reader.rig), *((change.log_ns, change.rig) for change in reader.rig_changes() or ())]
    begins = [log_ns for log_ns, _ in rigs]
    held = (rigs[max(0, bisect_right(begins, truth.log_ns) - 1)][1] for truth in ordered)
    rows = [(i, truth.frame_number, truth, rig) for i, (truth, rig) in enumerate(zip(ordered, held, strict=True))]
    return rows, poses, len(ordered)


def _match_by_time(truths: Iterable[Truth], source: LogSource, faults: FaultLog) -> _Matched:
    """Match boxes with frames as a replay would; what belongs to none is counted as GT006."""
    reader = source.open(faults)
    sync = source.sync_params(None, None, None, None)
    stream = FrameStream(reader, sync, StampParams(), Excerpt(), Clock(), faults)
    frames = [(Instant(f.index, f.stamp_ns, f.frame_number, is_chosen=True), f.segment) for f in stream.frames(reader)]
    stream.require_frames(reader.info.name)
    rows = []
    for index, truth in Labelling([instant for instant, _ in frames]).match(iter(truths)):
        if index is None:
            faults.add("GT006", stray(truth))
        else:
            instant, segment = frames[index]
            rig = stream.rigs[max(first for first in stream.rigs if first <= segment)]
            rows.append((index, instant.frame_number, truth, rig))
    return sorted(rows, key=lambda row: row[0]), stream.poses, len(frames)


def run_sequence(folder: Path, request: ExportRequest) -> BoxSequence:
    """Read the requested boxes of a run: by default tracks where ids are needed, else detections. Raises RunError."""
    run = Run(folder)
    manifest = run.manifest
    which: Which = request.boxes or ("tracks" if request.is_tracking else "detections")
    table = run.tracks if which == "tracks" else run.detections
    rigs = {segment: manifest.rig_of(segment) for segment in sorted({record.segment for record in run.frames})}
    frames = []
    for record, pose in zip(run.frames, run.poses, strict=True):
        boxes3d: Boxes3D | None
        boxes2d: Boxes2D | None
        if which != "truth":
            boxes: Boxes = table.at(record.index)
            boxes3d, boxes2d = (boxes, None) if isinstance(boxes, Boxes3D) else (None, boxes)
        elif record.truth_spaces:
            boxes3d, boxes2d = run.truth3d(record.index), run.truth2d(record.index)
        else:
            continue
        rig, number = rigs[record.segment], record.frame_number
        frames.append(BoxFrame(record.index, number, record.stamp_ns, rig, boxes3d, boxes2d, pose_of(pose)))
    num = max((record.index + 1 for record in run.frames), default=0)
    kinds = () if which == "truth" else _kinds(run, table)
    log = manifest.log
    return BoxSequence(str(folder), log.name, log.metadata, which == "truth", frames, num, kinds)


def _kinds(run: Run, table: BoxTable) -> list[Kind]:
    """Kinds of the sensors that boxes come from, as they say themselves, else of those that the pipeline got."""
    sources = table.boxes.sources
    bits = 0 if sources is None else int(np.bitwise_or.reduce(sources, initial=0))
    if bits:
        return sorted({kind for source, kind in _KIND.items() if bits & source})
    rig = run.manifest.rig
    names = choose_sensors(rig.sensors(*KINDS.values()), run.manifest.frames.sensors)
    return sorted({rig.mounts[name].kind for name in names})
