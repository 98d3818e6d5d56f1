"""Small runs, written through the run writer and read back."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pytest

from fbench.replay.data.arrays import Text
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.runs.folder import FrameRecord, Run, RunWriter
from fbench.replay.runs.manifest import FrameEntry, LogEntry, Manifest, rig_entry

Names = str | list[str] | None
Numbers = Sequence[float] | None
NO_CAMERA = Rig({}, {})
CAMERA_XYZW = np.array([-0.5, 0.5, -0.5, 0.5])
"""Camera axes (right, down, forward) in body axes (forward, left, up)."""


def front_camera(*names: str) -> Rig:
    """Cameras at the body's origin that look forward: 800x600, 90 deg."""
    K = np.array([[400.0, 0, 399.5], [0, 400.0, 299.5], [0, 0, 1]])
    names = names or ("front",)
    mounts = {n: Mount("camera", np.zeros(3), CAMERA_XYZW) for n in names}
    return Rig(mounts, {n: CameraModel(K, (800, 600)) for n in names})


def boxes3d(
    *centers: tuple[float, float],
    label: Names = None,
    score: Numbers = None,
    ids: Numbers = None,
    ignore: Numbers = None,
) -> Boxes3D:
    """Boxes of 4 x 2 x 1.5 m at (x, y), z = 0."""
    n = len(centers)
    center = np.array([[x, y, 0.0] for x, y in centers], float).reshape(n, 3)
    return Boxes3D(
        center,
        np.tile([4.0, 2.0, 1.5], (n, 1)),
        np.zeros(n),
        label=_text(label, n),
        score=None if score is None else np.array(score, float),
        track_id=None if ids is None else np.array(ids, np.int64),
        ignore=None if ignore is None else np.array(ignore, bool),
    )


def boxes2d(
    *xyxy: tuple[float, float, float, float],
    camera: str | list[str] = "front",
    label: Names = None,
    score: Numbers = None,
    ids: Numbers = None,
    ignore: Numbers = None,
    distance: Numbers = None,
) -> Boxes2D:
    """Rectangles of one camera, or of one each."""
    n = len(xyxy)
    return Boxes2D(
        np.full(n, camera) if isinstance(camera, str) else np.array(camera),
        np.array(xyxy, float).reshape(n, 4),
        label=_text(label, n),
        score=None if score is None else np.array(score, float),
        track_id=None if ids is None else np.array(ids, np.int64),
        ignore=None if ignore is None else np.array(ignore, bool),
        distance_m=None if distance is None else np.array(distance, float),
    )


def _text(label: Names, n: int) -> Text | None:
    return None if label is None else np.full(n, label) if isinstance(label, str) else np.array(label, dtype=np.str_)


@dataclass(frozen=True)
class Case:
    """One frame of a run."""

    estimates: Boxes
    """Detections, and tracks where `tracks` isn't given."""
    truth: Boxes3D | None = None
    truth2d: Boxes2D | None = None
    tracks: Boxes | None = None
    segment: int = 0


def make_manifest(rig: Rig = NO_CAMERA, **changes: Any) -> Manifest:
    """A manifest; `changes` are fields of it."""
    entry = rig_entry(0, rig)
    fields: dict[str, Any] = {
        "complete": True,
        "log": LogEntry(name="log", log_id="id", digest="d" * 32, metadata={}),
        "pipeline": "lidar3d",
        "parameters": {},
        "frames": FrameEntry(reference="lidar", timeout_ns=1, tolerance_ns=1, max_gap_ns=1),
        "mounts": entry.mounts,
        "cameras": entry.cameras,
        "num_frames": 1,
        "num_segments": 1,
        "digest": "",
        "versions": {},
    }
    return Manifest(**{**fields, **changes})


def write_run(folder: Path, cases: Sequence[Case], rig: Rig = NO_CAMERA, **changes: Any) -> Run:
    """Write cases as a run and read it back."""
    with RunWriter(folder) as writer:
        for i, case in enumerate(cases):
            writer.add_frame(FrameRecord(i, i * 100, case.segment, None, {}, "", ""), {"total": 1})
            writer.add_boxes("detections", i, case.estimates)
            writer.add_boxes("tracks", i, case.estimates if case.tracks is None else case.tracks)
            if case.truth is not None or case.truth2d is not None:
                writer.label_frame(i, Truth(i * 100, i * 100, case.truth, case.truth2d))
        return Run(writer.finish(make_manifest(rig, **changes)))


class MakeRun(Protocol):
    """Writes cases as a run in a new folder."""

    def __call__(self, *cases: Case, rig: Rig = NO_CAMERA, **changes: Any) -> Run: ...


@pytest.fixture
def make_run(tmp_path: Path) -> MakeRun:
    """Write a run of some frames; each call makes a new folder."""
    count = iter(range(1000))

    def make(*cases: Case, rig: Rig = NO_CAMERA, **changes: Any) -> Run:
        return write_run(tmp_path / f"run{next(count)}", cases, rig, **changes)

    return make
