"""How the detections or the tracks of one run are scored in one space."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fbench.metrics.profile import Match
from fbench.metrics.sequence import Sequence, Steps
from fbench.replay.arrays import Bool, Int64
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.data import Rig
from fbench.replay.store import FrameRecord, Run
from fbench.replay.tables import BoxTable


@dataclass(frozen=True, eq=False)
class View:
    """One run in the ground plane or in its images."""

    match: Match
    matching: str
    """How boxes match and which of them count."""
    sequence: Sequence
    num_frames: int
    """Of the run."""
    reason: str | None
    """Why there is nothing to score."""

    @property
    def num_scored(self) -> int:
        """Frames that have truth; none where there is nothing to score."""
        return 0 if self.reason else self.num_frames - self.sequence.num_unlabelled


@dataclass(frozen=True, eq=False)
class Labelled:
    """The frames of a run that have truth in one space."""

    run: Run
    frames: tuple[FrameRecord, ...]

    @classmethod
    def of(cls, run: Run, space: str) -> "Labelled":
        """Frames labelled in `3d` or `2d`."""
        return cls(run, tuple(frame for frame in run.frames if space in frame.truth_spaces.split()))

    @property
    def num_unlabelled(self) -> int:
        """The others."""
        return len(self.run.frames) - len(self.frames)

    @property
    def indices(self) -> Int64:
        """(F,) of these frames."""
        return np.array([frame.index for frame in self.frames], np.int64)

    def rows(self, table: BoxTable) -> tuple[Int64, Boxes2D | Boxes3D]:
        """Boxes of these frames, and which of them (N,) each belongs to."""
        indices = self.indices
        if not len(indices):
            return np.zeros(0, np.int64), table.boxes[:0]
        order = np.argsort(indices, kind="stable")
        at = np.minimum(np.searchsorted(indices[order], table.frames), len(indices) - 1)
        held = indices[order][at] == table.frames
        return order[at[held]].astype(np.int64), table.boxes[held]

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
