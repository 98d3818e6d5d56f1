"""The boxes of a run."""

from pathlib import Path

import numpy as np

from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.data import KINDS, Boxes, Kind, Rig, Source
from fbench.replay.export.sequence import BoxFrame, BoxSequence
from fbench.replay.export.wish import ExportWish, Which
from fbench.replay.frame_poses import pose_of
from fbench.replay.sensor_choice import chosen_sensors
from fbench.replay.store import FrameRecord, Run
from fbench.replay.tables import BoxTable

MANIFEST = "manifest.json"
_KIND: dict[Source, Kind] = {Source.C: "camera", Source.S: "camera", Source.L: "lidar", Source.R: "radar"}


def run_sequence(folder: Path, wish: ExportWish) -> BoxSequence:
    """Read the boxes of a run that are asked for: its tracks for formats that need ids, else its detections.

    Raises:
        RunError: where it can't be read.
    """
    run = Run(folder)
    which: Which = wish.boxes or ("tracks" if wish.is_tracking else "detections")
    rigs = _rigs(run)
    frames = [
        BoxFrame(
            record.index, record.frame_number, record.stamp_ns, rigs[record.segment],
            *_boxes(run, which, record), pose_of(pose),
        )
        for record, pose in zip(run.frames, run.poses, strict=True)
        if which != "truth" or record.truth_spaces
    ]  # fmt: skip
    num = max((record.index + 1 for record in run.frames), default=0)
    log = run.manifest.log
    kinds = () if which == "truth" else _kinds(run, which)
    return BoxSequence(str(folder), log.name, log.metadata, which == "truth", frames, num, kinds)


def _rigs(run: Run) -> dict[int, Rig]:
    """Rig of each segment."""
    return {segment: run.manifest.rig_of(segment) for segment in sorted({record.segment for record in run.frames})}


def _boxes(run: Run, which: Which, record: FrameRecord) -> tuple[Boxes3D | None, Boxes2D | None]:
    if which == "truth":
        return run.truth3d(record.index), run.truth2d(record.index)
    boxes: Boxes = _table(run, which).at(record.index)
    return (boxes, None) if isinstance(boxes, Boxes3D) else (None, boxes)


def _table(run: Run, which: Which) -> BoxTable:
    return run.tracks if which == "tracks" else run.detections


def _kinds(run: Run, which: Which) -> list[Kind]:
    """Kinds of the sensors that boxes come from, as they say themselves, else of those that the pipeline got."""
    boxes = _table(run, which).boxes
    bits = 0 if boxes.sources is None else int(np.bitwise_or.reduce(boxes.sources, initial=0))
    if bits:
        return sorted({kind for source, kind in _KIND.items() if bits & source})
    rig = run.manifest.rig
    names = chosen_sensors(rig.sensors(*KINDS.values()), run.manifest.frames.sensors)
    return sorted({rig.mounts[name].kind for name in names})
