"""What happened over all frames of a run, as plain series."""

from typing import Any

import numpy as np

from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.store import FrameRecord, Run
from fbench.replay.tables import BoxTable


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
