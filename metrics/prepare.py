"""From a run to what the matcher needs: scored frames, and one problem a frame and image."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fbench.metrics.ground import GroundSpace
from fbench.metrics.groups import Group
from fbench.metrics.image import ImageSpace
from fbench.metrics.items import Items
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import LABELS
from fbench.replay.scores import ScoreOptions
from fbench.replay.store import Run
from fbench.replay.tables import BoxTable


@dataclass(frozen=True, eq=False)
class Scene:
    """Truth and estimates of one frame, in the ground plane or in one camera's image."""

    frame: int
    segment: int
    stream: str
    """The camera; empty for the ground plane."""
    truth: Items
    estimates: Items
    num_bad_truth: int
    """Truth boxes that aren't finite; they are left out."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What the matcher needs of one scene and class: N truth boxes to be found, M estimates, K boxes that excuse."""

    frame: int
    segment: int
    stream: str
    similarity: Float64
    """(N, M), higher is nearer; -inf for invalid estimates."""
    excuse: Float64
    """(K, M), as `similarity`; -inf where the box doesn't excuse the estimate."""
    threshold: float
    shared_excuse: bool
    """Whether one box can excuse several estimates."""
    score: Float64
    """(M,)"""
    inside: Bool
    """(M,) false for estimates outside the region: they can be hits but no false alarms."""
    invalid: Bool
    """(M,) estimates that aren't finite."""
    truth_id: Int64
    """(N,) negative where there is none."""
    estimate_id: Int64
    """(M,) negative where there is none."""
    num_bad_truth: int


@dataclass(frozen=True)
class View:
    """How the detections or tracks of one run are scored in one space."""

    run: Run
    table: BoxTable
    space: GroundSpace | ImageSpace

    @cached_property
    def scenes(self) -> tuple[Scene, ...]:
        """All scenes that have truth, in the order of frames, then cameras."""
        return tuple(self._scenes())

    @cached_property
    def num_scored(self) -> int:
        """Frames that have truth."""
        return sum(self.space.truth(self.run, frame.index) is not None for frame in self.run.frames)

    @property
    def reason(self) -> str | None:
        """Why there is nothing to score."""
        return self.space.reason or (None if self.num_scored else "no truth")

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels that truth or estimates have, where the pipeline knows labels."""
        if self.table.boxes.label is None:
            return ()
        met = {str(n) for s in self.scenes for n in (*s.truth.label[~s.truth.ignore], *s.estimates.label)}
        return tuple(label for label in LABELS if label in met)

    def problems(self, group: Group) -> Iterator[Problem]:
        """Yield one problem a scene for one class."""
        return (_problem(self.space, scene, group) for scene in self.scenes)

    def _space_of(self, segment: int) -> GroundSpace | ImageSpace:
        """The space with the calibration of a segment."""
        manifest = self.run.manifest
        return replace(self.space, rig=manifest.rig_of(segment)) if manifest.rig_changes else self.space

    def _scenes(self) -> Iterator[Scene]:
        for record in self.run.frames if self.space.reason is None else ():
            truth = self.space.truth(self.run, record.index)
            if truth is None:
                continue
            space = self._space_of(record.segment)
            for stream, boxes, estimates in space.split(truth, self.table.at(record.index)):
                good = boxes[boxes.valid]
                yield Scene(record.index, record.segment, stream, good, estimates, len(boxes) - len(good))


def views(run: Run, table: BoxTable, options: ScoreOptions) -> tuple[View, ...]:
    """Return the native view of a run first: 3D runs are scored in 3D and, projected, in the image."""
    image = View(run, table, ImageSpace.of(run, options))
    if isinstance(table.boxes, Boxes3D):
        return View(run, table, GroundSpace(run.manifest.rig, options)), image
    return (image,)


def _problem(space: GroundSpace | ImageSpace, scene: Scene, group: Group) -> Problem:
    estimates = scene.estimates[group.holds(scene.estimates)]
    counts = group.counts(scene.truth)
    truth, rest = scene.truth[counts], scene.truth[~counts]
    excused = group.excused(rest, estimates) & estimates.valid[None, :]
    similarity = np.where(estimates.valid[None, :], space.similarity(truth, estimates), -np.inf)
    return Problem(
        frame=scene.frame,
        segment=scene.segment,
        stream=scene.stream,
        similarity=similarity,
        excuse=np.where(excused, space.excuse(rest, estimates), -np.inf),
        threshold=space.threshold,
        shared_excuse=space.shared_excuse,
        score=np.where(estimates.valid, estimates.score, 0.0),
        inside=estimates.inside,
        invalid=~estimates.valid,
        truth_id=truth.track_id,
        estimate_id=estimates.track_id,
        num_bad_truth=scene.num_bad_truth,
    )
