"""A run in the ground plane: 3D boxes in body coordinates."""

import numpy as np

from fbench.metrics.objects import Objects
from fbench.metrics.profile import Match
from fbench.metrics.runs.columns import objects_of
from fbench.metrics.runs.places import on_ground
from fbench.metrics.runs.seen import only_seen, require_told, seen_by_some
from fbench.metrics.runs.shared import once
from fbench.metrics.runs.view import Labelled, View
from fbench.metrics.sequence import Sequence
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.boxes import Boxes3D, finite
from fbench.replay.data import Boxes, Rig
from fbench.replay.errors import MetricError
from fbench.replay.geometry.camera import in_image, not_projectable, project_body
from fbench.replay.scores import ScoreOptions
from fbench.replay.store import Run
from fbench.replay.tables import BoxTable


def ground_view(run: Run, table: BoxTable, options: ScoreOptions) -> View:
    """Return the detections or tracks of a run beside its 3D truth.

    Raises:
        MetricError: where the results are in images.
        ConfigError: where the log has no such regions as the options ask for, no poses, or doesn't tell what is seen.
    """
    labelled = Labelled.of(run, "3d")
    truth, num_invalid = once(run, ("truth on the ground", options), lambda: _truth(labelled, options))
    sequence = Sequence(
        run.manifest.log.name,
        labelled.steps(),
        truth,
        _objects(labelled, *labelled.rows(table), options),
        labelled.num_unlabelled,
        num_invalid,
    )
    view = ", in view" if options.in_view and modelled_cameras(run.manifest.rig) else ""
    matching = (
        f"bev {options.distance_m:g} m, within {options.range_m:g} m{view}{only_seen(options)}{in_regions(options)}"
    )
    reason = None if labelled.frames else "no truth"
    return View(Match("bev", options.distance_m), matching, sequence, len(run.frames), reason)


def modelled_cameras(rig: Rig) -> tuple[str, ...]:
    """Cameras whose view is known: those whose lens distortion is modelled."""
    return tuple(name for name, camera in sorted(rig.cameras.items()) if not_projectable(camera) is None)


def within(centers: Float64, range_m: float) -> Bool:
    """Tell which points (N, 3) in body coordinates are at most `range_m` from the body's origin in the ground plane."""
    near: Bool = np.hypot(centers[:, 0], centers[:, 1]) <= range_m
    return near


def in_view(rig: Rig, camera: str, centers: Float64) -> Bool:
    """Tell which points (N, 3) in body coordinates project into the image of a camera.

    Raises:
        LogError: where the camera's distortion isn't modelled.
    """
    return in_image(rig.cameras[camera], project_body(rig, camera, centers)[0])


def in_regions(options: ScoreOptions) -> str:
    """Say to which regions scores are restricted."""
    return f", in region {' or '.join(sorted(options.regions))}" if options.regions else ""


def _truth(labelled: Labelled, options: ScoreOptions) -> tuple[Objects, int]:
    frame, truth = labelled.rows(labelled.run.truth_table("3d"))
    good, _ = finite(truth)
    frame, boxes = frame[good], _solid(truth[good])
    seen = seen_by_some(labelled, frame, boxes, options)
    require_told(labelled, seen, options)
    return _objects(labelled, frame, boxes, options, seen), int((~good).sum())


def _solid(boxes: Boxes) -> Boxes3D:
    if not isinstance(boxes, Boxes3D):
        raise MetricError("2D boxes can't be scored in 3D")
    return boxes


def _objects(
    labelled: Labelled, frame: Int64, any_boxes: Boxes, options: ScoreOptions, seen: Bool | None = None
) -> Objects:
    boxes = _solid(any_boxes)
    centers = np.where(finite(boxes)[0][:, None], boxes.center_m, 0.0)
    inside = within(centers, options.range_m)
    for rig, rows in labelled.rigs(frame) if options.in_view else ():
        cameras = modelled_cameras(rig)
        if cameras:
            inside[rows] &= np.any([in_view(rig, name, centers[rows]) for name in cameras], axis=0)
    if options.regions:
        inside &= on_ground(labelled.run, options.regions, labelled.indices[frame], centers)
    if options.seen and seen is not None:
        inside &= seen
    return objects_of(boxes, frame, inside, seen=seen)
