"""Boxes of a run as the columns that metrics read."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fbench.metrics.core.ordering import content_order
from fbench.metrics.core.slices import ScoreKey
from fbench.replay.contracts.profiles import Match
from fbench.replay.contracts.sensor_settings import choose_sensors
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes, Boxes2D
from fbench.replay.data.rig import Rig
from fbench.replay.data.sequences import Objects, Sequence, Steps
from fbench.replay.runs.folder import FrameRecord, Run
from fbench.replay.runs.tables import BoxTable


def objects_of(
    boxes: Boxes, step: Int64, inside: Bool, xyxy_px: Float64 | None = None, seen: Bool | None = None
) -> Objects:
    """Return N boxes, in 3D in body coordinates or in images, as objects, sorted by step and content, so that the order
    in which a pipeline gives them never decides a match.

    `step` (N,) is where each belongs, `inside` (N,) tells what is in the region of interest, `xyxy_px` (N, 4) are
    outlines of 3D boxes in the step's camera, and `seen` (N,) of truth is what some sensor sees.
    """
    order = np.argsort(step, kind="stable")
    boxes, n = boxes[order], len(boxes)
    place: dict[str, Float64 | None] = {"xyxy_px": None if xyxy_px is None else xyxy_px[order]}
    if isinstance(boxes, Boxes2D):
        place = {name: getattr(boxes, name) for name in ("xyxy_px", "distance_m", "range_rate_mps")}
    else:
        place |= {name: getattr(boxes, name) for name in ("center_m", "size_lwh_m", "velocity_mps")}
        x, y, z = boxes.center_m.T
        # NaN where any angle isn't finite, so that such a box is found out.
        angles = [angle for angle in (boxes.roll_rad, boxes.pitch_rad) if angle is not None]
        sane = np.all([np.ones(n, bool), *map(np.isfinite, angles)], axis=0)
        place |= {"distance_m": np.hypot(np.hypot(x, y), z), "yaw_rad": np.where(sane, boxes.yaw_rad, np.nan)}
    objects = Objects(
        step=step[order],
        label=np.full(n, "") if boxes.label is None else boxes.label,
        track_id=np.full(n, -1) if boxes.track_id is None else boxes.track_id,
        score=np.zeros(n) if boxes.score is None else boxes.score,
        occlusion=boxes.occlusion,
        truncation=boxes.truncation,
        visibility=boxes.visibility,
        num_points=count_points(boxes),
        attribute=boxes.attribute,
        sources=boxes.sources,
        ignore=boxes.ignore,
        inside=inside[order],
        seen=None if seen is None else seen[order],
        predicted=boxes.predicted,
        **place,
    )
    return objects[content_order(objects)]


def count_points(boxes: Boxes) -> Int64 | None:
    """LiDAR and radar points (N,) in boxes together; -1 where neither sensor tells of a box, `None` where of none."""
    points = [column for column in (boxes.num_lidar_pts, boxes.num_radar_pts) if column is not None]
    if not points:
        return None
    total = sum((np.maximum(column, 0) for column in points), np.zeros(len(boxes), np.int64))
    return np.where(np.all([column < 0 for column in points], axis=0), -1, total)


def of_steps(sequence: Sequence, kept: Bool) -> Sequence:
    """Return the part of a sequence at the marked steps (S,)."""
    steps, number = sequence.steps, np.cumsum(kept) - 1
    camera = tuple(steps.camera[step] for step in np.flatnonzero(kept)) if steps.camera else ()
    truth, estimates = (side[kept[side.step]] for side in (sequence.truth, sequence.estimates))
    return replace(
        sequence,
        steps=Steps(steps.frame[kept], steps.stamp_ns[kept], steps.stream[kept], camera),
        truth=replace(truth, step=number[truth.step]),
        estimates=replace(estimates, step=number[estimates.step]),
        num_unlabeled=0,
        num_invalid_truth=0,
        ego_m=None if sequence.ego_m is None else sequence.ego_m[kept],
    )


@dataclass(frozen=True, eq=False)
class View:
    """One run in the ground plane or in its images."""

    match: Match
    sequence: Sequence
    key: ScoreKey  # Of rows about all vehicles


@dataclass(frozen=True, eq=False)
class Labelled:
    """The frames of a run that have truth in one space."""

    run: Run
    frames: tuple[FrameRecord, ...]

    @classmethod
    def of(cls, run: Run, space: str) -> "Labelled":
        """Frames labeled in `3d` or `2d`."""
        return cls(run, tuple(frame for frame in run.frames if space in frame.truth_spaces.split()))

    @property
    def num_unlabeled(self) -> int:
        """The others."""
        return len(self.run.frames) - len(self.frames)

    @property
    def indices(self) -> Int64:
        """(F,) of these frames."""
        return np.array([frame.index for frame in self.frames], np.int64)

    def rows(self, table: BoxTable) -> tuple[Int64, Boxes]:
        """Boxes of these frames, and which of them (N,) each belongs to."""
        indices = self.indices
        if not len(indices):
            return np.zeros(0, np.int64), table.boxes[:0]
        order = np.argsort(indices, kind="stable")
        at = np.minimum(np.searchsorted(indices[order], table.frames), len(indices) - 1)
        held = indices[order][at] == table.frames
        return order[at[held]].astype(np.int64), table.boxes[held]

    def cameras(self, boxes: Boxes, kept: str = "") -> tuple[str, ...]:
        """Cameras in whose images results are scored: those of the truth in images, else all; of results in images
        those that the pipeline got, as in others it can find nothing. `kept` alone where it is among those of truth.
        """
        manifest, truth = self.run.manifest, self.run.truth_table("2d").boxes
        names = set(manifest.rig.cameras)
        if isinstance(truth, Boxes2D) and any("2d" in frame.truth_spaces.split() for frame in self.run.frames):
            names = {str(name) for name in np.unique(truth.camera)} or names
        if kept in names:
            return (kept,)
        if isinstance(boxes, Boxes2D):
            sensors = manifest.rig.sensors("camera", "lidar", "radar")
            names -= set(sensors) - set(choose_sensors(sensors, manifest.frames.sensors))
        return tuple(sorted(names))

    def rigs(self, frame: Int64) -> Iterator[tuple[Rig, Bool]]:
        """Yield each rig of the log with the rows whose frames (N,) have it."""
        manifest = self.run.manifest
        if not manifest.rig_changes:
            yield manifest.rig, np.ones(len(frame), bool)
            return
        segments = np.array([record.segment for record in self.frames], np.int64)[frame]
        for segment in np.unique(segments):
            yield manifest.rig_of(int(segment)), segments == segment

    def steps(self, cameras: tuple[str, ...] = ()) -> Steps:
        """One step a frame, or one for each camera of each frame."""
        num = max(len(cameras), 1)
        rows = [(f.index, f.stamp_ns, f.segment) for f in self.frames]
        index, stamp, segment = np.repeat(np.array(rows, np.int64).reshape(-1, 3), num, axis=0).T
        camera = np.tile(np.arange(num), len(self.frames))
        return Steps(index, stamp, segment * num + camera, cameras * len(self.frames))
