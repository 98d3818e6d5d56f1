"""Truth of logs, for results in files."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fbench.metrics.files.nuscenes import Submission
from fbench.metrics.files.side import Side, nothing
from fbench.metrics.files.sources import Source
from fbench.metrics.reference_runs.rows import join_sides, objects_of
from fbench.metrics.reference_runs.world import in_world
from fbench.replay.contracts.errors import LogError, MetricError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Int64, Text
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.metadata import CAMERA0
from fbench.replay.formats.export_request import ExportRequest, LeftOut
from fbench.replay.formats.export_sources import log_sequence
from fbench.replay.formats.nuscenes import TOKENS, Sample
from fbench.replay.formats.sequence import BoxSequence
from fbench.replay.setup.source import LogRequest, log_source

B = TypeVar("B", Boxes2D, Boxes3D)
_UNKNOWN = {"f": np.nan, "i": -1, "u": 0, "b": False, "U": ""}
"""What stands for 'unknown' where a frame lacks what others have."""


def open_logs(path: Path, logs: list[Path]) -> Source:
    """Open logs; nothing is read but what tells names, and whether there is truth. Those without any are left out.

    Steps are frames by the numbers of their source, or stamps where it has none. Raises LogError where one can't be
    read, or two have one name. Raises MetricError where none has truth (GT001).
    """
    found: dict[str, Path] = {}
    tokens: dict[str, list[str]] = {}
    faults = FaultLog()
    for log in logs:
        reader = log_source(LogRequest(log)).open(FaultLog())
        name = reader.info.name
        if name in found:
            raise LogError(f"{path}: {found[name].name} and {log.name} are both called '{name}'")
        if next(reader.truths(), None) is not None:
            found[name] = log
            if TOKENS in reader.info.metadata:
                tokens[name] = reader.info.metadata[TOKENS].split()
    if not found:
        raise MetricError(f"{path}: no truth, so there is nothing to score", "GT001")

    def read(name: str) -> Side:
        request = ExportRequest("nuscenes" if name in tokens else "kitti-tracking", "truth")
        sequence = log_sequence(log_source(LogRequest(found[name])), request, LeftOut(), faults)
        return _in_world(sequence) if name in tokens else _at_body(sequence)

    def submission() -> Submission | None:
        """What tells when and in which log the samples of a submission are."""
        samples = {
            own[truth.frame_number]: Sample(truth.stamp_ns, name)
            for name, own in tokens.items()
            for truth in log_source(LogRequest(found[name])).open(FaultLog()).truths()
            if truth.frame_number is not None and truth.frame_number < len(own)
        }
        return Submission(path, {}, samples, are_ordered=True, has_stamps=True) if samples else None

    # The samples of nuScenes have names, so that the name of a log matters.
    is_single = len(found) == 1 and not tokens
    return Source(path, "log", tuple(found), is_single, read, submission, faults)


def _at_body(sequence: BoxSequence) -> Side:
    """Rectangles and solids; in body coordinates, which in KITTI's logs are those of its files. Where rectangles are of
    several cameras, solids alone, or rectangles where there are no solids.
    """
    is_kitti = CAMERA0 in sequence.metadata
    numbers = np.array([frame.number for frame in sequence.frames if frame.number is not None], np.int64)
    has_numbers = is_kitti and len(np.unique(numbers)) == len(sequence.frames)
    keys = numbers if has_numbers else np.array([frame.stamp_ns for frame in sequence.frames], np.int64)
    order = np.argsort(keys, kind="stable")
    frames = [sequence.frames[at] for at in order.tolist()]
    flat, flat_frame = stack([frame.boxes2d for frame in frames], Boxes2D.empty())
    solid, solid_frame = stack([frame.boxes3d for frame in frames], Boxes3D.empty())
    if len(sequence.cameras_of_boxes) > 1 and len(solid):
        flat, flat_frame = flat[:0], flat_frame[:0]
    rows = join_sides(flat_frame, flat, np.arange(len(flat)), solid_frame, solid)
    objects = objects_of(rows, "kitti-tracking" if is_kitti else None, keys[order][rows.frame])
    names: Text = np.append(rows.flat.camera, "")[rows.flat_rows]
    camera = names if len(np.unique(names[names != ""])) > 1 else np.array([], np.str_)
    space = "camera" if is_kitti else "body"
    return Side(objects if len(objects) else nothing(), keys[order], not has_numbers, camera=camera, space=space)


def stack(parts: list[B | None], nothing: B) -> tuple[B, Int64]:
    """Boxes of all frames, and which frame (N,) each is of; what only some frames tell is unknown in the others."""
    sizes = [0 if part is None else len(part) for part in parts]
    full, joined = [part for part in parts if part is not None and len(part)], dict[str, Any]()
    for own in fields(nothing) if full else ():
        columns = [getattr(part, own.name) for part in full]
        if known := [column for column in columns if column is not None]:
            unknown = np.full_like(known[0][:1], _UNKNOWN[known[0].dtype.kind])
            filled = (unknown.repeat(len(part), axis=0) for part in full)
            joined[own.name] = np.concatenate([f if c is None else c for f, c in zip(filled, columns, strict=True)])
    return type(nothing)(**joined) if full else nothing, np.repeat(np.arange(len(parts)), sizes)


def _in_world(sequence: BoxSequence) -> Side:
    frames = sorted((frame for frame in sequence.frames if frame.number is not None), key=lambda f: f.stamp_ns)
    known = [frame.world_T_body for frame in frames if frame.world_T_body is not None]
    if len(known) < len(frames):
        raise LogError(f"{sequence.where}: doesn't tell where the body was at each keyframe")
    boxes, frame_of_box = stack([frame.boxes3d for frame in frames], Boxes3D.empty())
    keys = np.array([frame.stamp_ns for frame in frames], np.int64)
    poses = np.array(known).reshape(-1, 4, 4)
    found = in_world(frame_of_box, boxes, poses, "nuscenes", is_truth=True)
    return Side(replace(found, step=keys[found.step]), keys, has_stamps=True, space="world", ego_m=poses[:, :3, 3])
