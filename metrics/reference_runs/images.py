"""A run as KITTI's and MOTChallenge's files would have it: objects of one camera with rectangles."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fbench.metrics.files.side import find_unreal
from fbench.metrics.reference_runs.rows import join_sides, objects_of
from fbench.metrics.runs.columns import Labelled
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Family
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D, finite
from fbench.replay.data.metadata import CAMERA0
from fbench.replay.data.sequences import Objects, Sequence, Space
from fbench.replay.formats.sequence import KITTI_CAMERA, ImageRows, body_T_level
from fbench.replay.geometry.camera import not_projectable, project_boxes
from fbench.replay.geometry.transforms import inverse, transform
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import BoxTable


@dataclass(frozen=True, eq=False)
class View:
    """Frames with truth, and the images in which they are seen."""

    labeled: Labelled
    space: Space
    cameras: tuple[str, ...]
    """In images each is a stream; in space at most one: rules about heights and regions are about one image."""
    is_recorded: bool  # Whether truth has rectangles of its own


def view_of(run: Run, boxes: Boxes, space: Space) -> View:
    """Return how results are scored against the truth of their run. Raises MetricError where there is no such truth
    (GT001), no camera, or one into which nothing can be projected.
    """
    spaces = {kind for frame in run.frames for kind in frame.truth_spaces.split()}
    is_recorded = "2d" in spaces
    wanted = "3d" if space == "3d" or not is_recorded else "2d"
    if wanted not in spaces:
        what = "truth in 3D" if spaces else "truth"
        raise MetricError(f"{run.folder}: no {what}, so there is nothing to score", "GT001")
    labeled, known = Labelled.of(run, wanted), run.manifest.rig.cameras
    # KITTI's own camera, where the log is KITTI's.
    kept = KITTI_CAMERA if run.manifest.log.metadata.get(CAMERA0) is not None else ""
    cameras, bent = labeled.cameras(boxes, kept), ""
    if isinstance(boxes, Boxes3D) or not is_recorded:  # cameras whose lens isn't modeled, or that the rig doesn't know
        unknown = (name for name in cameras if name not in known or not_projectable(known[name]) is not None)
        bent = next(unknown, "")
    if space == "2d":
        if not cameras:
            raise MetricError(f"{run.folder}: no camera, in whose image boxes could be scored")
        if bent:
            raise MetricError(f"{run.folder}: lens distortion of '{bent}' isn't modeled, so boxes can't be projected")
    elif len(cameras) > 1 or bent:
        cameras = ()
    return View(labeled, space, cameras, is_recorded)


def image_sequence(run: Run, table: BoxTable, family: Family, space: Space) -> Sequence:
    """Return truth and results of a run by the names of a benchmark; solids are in body coordinates.

    Rectangles are those that were recorded, else those around projected 3D boxes. In space what a single camera doesn't
    see is left out on both sides, as its benchmark's files do; where there are several cameras, nothing has a
    rectangle. Raises MetricError where the run has no such truth (GT001), or no image.
    """
    view = view_of(run, table.boxes, space)
    frame, boxes, nothing = *view.labeled.rows(table), np.zeros(0, np.int64)

    def results(camera: str) -> ImageRows:
        if isinstance(boxes, Boxes2D):
            return join_sides(frame, boxes, np.flatnonzero(boxes.camera == camera), nothing, Boxes3D.empty())
        return join_sides(nothing, Boxes2D.empty(), nothing, frame, boxes)

    truth = _objects(view, family, lambda camera: _truth(view, camera))
    bad = find_unreal(truth)
    return Sequence(
        run.manifest.log.name,
        view.labeled.steps(view.cameras if len(view.cameras) > 1 else ()),
        truth[~bad],
        _objects(view, family, results),
        view.labeled.num_unlabeled,
        int(bad.sum()),
    )


def _objects(view: View, family: Family, rows_in: Callable[[str], ImageRows]) -> Objects:
    """All cameras' rows: one step a frame, or one for each camera of it."""
    cameras = view.cameras or ("",)
    parts = [_place(view, camera, rows_in(camera)) for camera in cameras]
    alpha = np.concatenate([_alphas(view, camera, part) for camera, part in zip(cameras, parts, strict=True)])
    step = np.concatenate([part.frame * len(cameras) + i for i, part in enumerate(parts)])
    order = np.argsort(step, kind="stable")
    names = ("frame", "xyxy_px", "flat_rows", "solid_rows")
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return objects_of(replace(parts[0], **columns)[order], family, step[order], alpha[order])


def _truth(view: View, camera: str) -> ImageRows:
    frame2d, flat = view.labeled.rows(view.labeled.run.truth_table("2d"))
    frame3d, solid = view.labeled.rows(view.labeled.run.truth_table("3d"))
    flat = flat if isinstance(flat, Boxes2D) else Boxes2D.empty()
    solid = solid if isinstance(solid, Boxes3D) else Boxes3D.empty()
    rows = join_sides(frame2d, flat, np.flatnonzero(flat.camera == camera), frame3d, solid)
    if view.space == "2d":
        return rows[rows.flat_rows >= 0] if view.is_recorded else rows
    return rows[(rows.solid_rows >= 0) | rows.column("ignore", False)] if view.space == "3d" else rows


def _place(view: View, camera: str, rows: ImageRows) -> ImageRows:
    """Project what has no rectangle, and leave out what the camera doesn't see; what isn't finite stays once."""
    alone = np.flatnonzero(rows.flat_rows < 0)
    if not camera or not len(alone):
        return rows
    solid = rows.solid[rows.solid_rows[alone]]
    sane = finite(solid)[0]
    outline, kept = np.full((len(solid), 4), np.nan), ~sane & (camera == view.cameras[0])
    for rig, own in view.labeled.rigs(rows.frame[alone]):
        good = np.flatnonzero(own & sane)
        outline[good], kept[good] = project_boxes(rig, camera, solid[good])
    xyxy, seen = np.array(rows.xyxy_px), np.ones(len(rows), bool)
    xyxy[alone], seen[alone] = outline, kept
    return replace(rows, xyxy_px=xyxy)[seen]


def _alphas(view: View, camera: str, rows: ImageRows) -> Float64:
    """Angles (N,) at which the camera sees the solids, as KITTI has them; NaN where there is none."""
    angles = np.full(len(rows), np.nan)
    has = np.flatnonzero(rows.solid_rows >= 0)
    solid, owner = rows.solid[rows.solid_rows[has]], view.labeled.run.manifest.log.metadata.get(CAMERA0, camera)
    for rig, own in view.labeled.rigs(rows.frame[has]):
        body_T = body_T_level(owner, rig) if owner else None
        center, yaw = solid[own].center_m, solid[own].yaw_rad
        if body_T is not None and len(yaw):
            level_T_body = inverse(body_T)
            turn = level_T_body.copy()
            turn[:3, 3] = 0
            ahead = transform(turn, np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))]))
            center, yaw = transform(level_T_body, center), np.arctan2(ahead[:, 1], ahead[:, 0])
        angles[has[own]] = np.arctan2(center[:, 1], center[:, 0]) - yaw - np.pi / 2
    return angles
