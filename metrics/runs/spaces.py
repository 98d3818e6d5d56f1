"""The spaces in which a run is scored: the ground plane and its images."""

from collections.abc import Callable
from collections.abc import Sequence as AbstractSequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np

from fbench.metrics.core.slices import VEHICLE, Group, ScoreCounts, ScoreKey, find_labels, label_group
from fbench.metrics.runs.columns import Labelled, View, objects_of
from fbench.metrics.runs.places import find_seen, ground_height, on_ground, once, place_in_space, place_truth
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Match, Statistics
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import LABELS, Boxes, Boxes2D, Boxes3D, finite
from fbench.replay.data.rig import Rig
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.data.sequences import Objects, Sequence, Steps
from fbench.replay.geometry.camera import in_image, not_projectable, project_body, project_boxes
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import BoxTable

S = TypeVar("S", bound=Statistics)
Place = Callable[[Int64, Boxes, Bool | None], Objects]
"""Makes objects of boxes (N,) of these frames (N,); of truth, some sensor of the log sees these (N,)."""


def ground_view(run: Run, table: BoxTable, options: ScoreOptions) -> View:
    """Return the detections or tracks of a run beside its 3D truth. Raises MetricError where the results are in images.
    Raises ConfigError where the log has no such regions as the options ask for, no poses, or doesn't tell what is seen.
    """
    return once(run, ("ground view", table, options), lambda: _view_ground(run, table, options))


def _view_ground(run: Run, table: BoxTable, options: ScoreOptions) -> View:
    labeled = Labelled.of(run, "3d")

    def place(frame: Int64, boxes: Boxes, seen: Bool | None = None) -> Objects:
        if not isinstance(boxes, Boxes3D):
            raise MetricError("2D boxes can't be scored in 3D")
        centers = np.where(finite(boxes)[0][:, None], boxes.center_m, 0.0)
        inside = np.asarray(np.hypot(centers[:, 0], centers[:, 1]) <= options.range_m)
        for rig, rows in labeled.rigs(frame) if options.in_view else ():
            if cameras := _cameras_with_model(rig):
                inside[rows] &= np.any([_in_view(rig, name, centers[rows]) for name in cameras], axis=0)
        if options.regions:
            inside &= on_ground(run, options.regions, labeled.indices[frame], centers)
        if options.seen and seen is not None:
            inside &= seen
        return objects_of(boxes, frame, inside, seen=seen)

    truth, num_invalid = once(run, ("truth on the ground", options), lambda: _truth(labeled, "3d", options, place))
    estimates = place(*labeled.rows(table))
    sequence = Sequence(run.manifest.log.name, labeled.steps(), truth, estimates, labeled.num_unlabeled, num_invalid)
    view = ", in view" if options.in_view and _cameras_with_model(run.manifest.rig) else ""
    matching = f"bev {options.distance_m:g} m, within {options.range_m:g} m{view}{_limits(options)}"
    reason = None if labeled.frames else "no truth"
    key = ScoreKey(VEHICLE.name, "all", matching, reason, len(labeled.frames))
    return View(Match("bev", options.distance_m), sequence, key)


def _truth(labeled: Labelled, space: Literal["2d", "3d"], options: ScoreOptions, place: Place) -> tuple[Objects, int]:
    """Truth of `3d` or `2d`, and how many boxes of it aren't finite."""
    frame, truth = labeled.rows(labeled.run.truth_table(space))
    good, _ = finite(truth)
    frame, boxes = frame[good], truth[good]
    seen = find_seen(labeled, frame, boxes, options) if isinstance(boxes, Boxes3D) else None
    return place(frame, boxes, seen), int((~good).sum())


def _cameras_with_model(rig: Rig) -> list[str]:
    """Cameras whose view is known: those whose lens distortion is modeled."""
    return [name for name, camera in sorted(rig.cameras.items()) if not_projectable(camera) is None]


def _in_view(rig: Rig, camera: str, centers: Float64) -> Bool:
    """Which points (N, 3) in body coordinates project into the image of a camera."""
    return in_image(rig.cameras[camera], project_body(rig, camera, centers)[0])


def _limits(options: ScoreOptions, has_seen: bool = True) -> str:
    """Say what else scores are restricted to."""
    seen = ""
    if has_seen and options.seen:
        seen = ", seen" if options.seen == 1 else f", seen with {options.seen} points"
    return seen + (f", in region {' or '.join(sorted(options.regions))}" if options.regions else "")


def image_view(run: Run, table: BoxTable, options: ScoreOptions) -> View:
    """Return the detections or tracks of a run beside the 2D truth of its log where that has any, in the cameras that
    it names; else beside its 3D truth, projected.

    A pipeline that works in images is judged in those of the cameras that it got.
    """
    return once(run, ("image view", table, options), lambda: _view_images(run, table, options))


def _view_images(run: Run, table: BoxTable, options: ScoreOptions) -> View:
    derived = not any("2d" in frame.truth_spaces.split() for frame in run.frames)
    space: Literal["2d", "3d"] = "3d" if derived else "2d"
    labeled, recorded = Labelled.of(run, space), run.truth_table("2d").boxes
    ranged = derived
    if not derived and isinstance(recorded, Boxes2D):
        ranged = recorded.distance_m is not None and bool(np.isfinite(recorded.distance_m).any())
    cameras = tuple(name for name in labeled.cameras(table.boxes) if name in options.cameras or not options.cameras)
    images = _Images(labeled, options, cameras, derived, ranged)
    near = f", within {options.range_m:g} m" if ranged else ""
    view = ", in view" if derived and options.in_view else ""
    from_3d = ", truth projected from 3D" if derived else ""
    those = f", in image of {' or '.join(sorted(options.cameras))}" if options.cameras else ""
    matching = f"iou {options.iou:g}{from_3d}{near}{view}{those}{_limits(options, derived)}"

    reason, known = None if labeled.frames else "no truth", run.manifest.rig.cameras
    unknown = [name for name in images.cameras if name not in known]  # of truth, whose calibration was left out
    bent = [name for name in images.cameras if name in known and not_projectable(known[name]) is not None]
    if not images.cameras:
        is_there = bool(run.manifest.rig.sensors("camera"))
        which = f"the run has no camera called {' or '.join(sorted(options.cameras))}" if options.cameras else ""
        reason = (reason or which or "no camera is calibrated") if is_there else "no cameras"
    elif unknown and (derived or isinstance(table.boxes, Boxes3D)):
        reason = f"camera '{unknown[0]}' has no intrinsics"
    elif bent and (derived or isinstance(table.boxes, Boxes3D)):
        reason = f"lens distortion of '{bent[0]}' isn't modeled"
    if reason is None:
        key = ("truth in images", images.cameras, derived, options)
        truth, num_invalid = once(run, key, lambda: _truth(labeled, space, options, images.place_truth))
        estimates, steps = images.place(*labeled.rows(table)), labeled.steps(images.cameras)
    else:
        truth = estimates = Objects(np.zeros(0, np.int64), np.zeros(0, "U1"), np.zeros(0, np.int64), np.zeros(0))
        steps, num_invalid = Steps.of_one_stream(0), 0
    sequence = Sequence(run.manifest.log.name, steps, truth, estimates, labeled.num_unlabeled, num_invalid)
    score_key = ScoreKey(VEHICLE.name, "all", matching, reason, 0 if reason else len(labeled.frames))
    return View(Match("iou2d", options.iou), sequence, score_key)


@dataclass(frozen=True, eq=False)
class _Images:
    """Which images, and where truth in them comes from."""

    labeled: Labelled
    options: ScoreOptions
    cameras: tuple[str, ...]
    derived: bool  # Whether truth is 3D truth, projected
    ranged: bool  # Whether the distance of truth is known; where it isn't, boxes of any distance count

    def place_truth(self, frame: Int64, boxes: Boxes, seen: Bool | None = None) -> Objects:
        """Truth of these frames (N,) in each camera, and which of it some sensor sees."""
        return self.place(frame, boxes, seen, is_truth=True)

    def place(self, frame: Int64, boxes: Boxes, seen: Bool | None = None, *, is_truth: bool = False) -> Objects:
        """Boxes of these frames (N,) in each camera; of truth, which of them some sensor sees."""
        if isinstance(boxes, Boxes2D):
            held = np.isin(boxes.camera, self.cameras)
            boxes, frame = boxes[held], frame[held]
            step = frame * len(self.cameras) + np.searchsorted(self.cameras, boxes.camera)
            inside = np.ones(len(boxes), bool)
            if self.ranged and boxes.distance_m is not None:
                inside = ~(boxes.distance_m > self.options.range_m)
            if self.options.regions:
                inside &= self._in_regions(frame, boxes, is_truth)
            return objects_of(boxes, step, inside)
        parts = [self._project(camera, frame, boxes) for camera in range(len(self.cameras))]
        step, rows, inside, xyxy = (np.concatenate(part) for part in zip(*parts, strict=True))
        if self.options.seen and seen is not None:
            inside &= seen[rows]
        return objects_of(boxes[rows], step, inside, xyxy, None if seen is None else seen[rows])

    def _in_regions(self, frame: Int64, boxes: Boxes2D, is_truth: bool) -> Bool:
        run, index = self.labeled.run, self.labeled.indices[frame]
        places = np.full((len(boxes), 3), np.nan)
        for rig, rows in self.labeled.rigs(frame):
            places[rows] = place_in_space(rig, boxes[rows], ground_height(run))
        if is_truth:
            places = place_truth(run, index, boxes, places)
        return on_ground(run, self.options.regions, index, places)

    def _project(self, camera: int, frame: Int64, boxes: Boxes3D) -> tuple[Int64, Int64, Bool, Float64]:
        """Steps, rows, region and outlines of the boxes in one camera."""
        name, labeled, options = self.cameras[camera], self.labeled, self.options
        sane = finite(boxes)[0] & np.all(boxes.size_lwh_m >= 0, axis=1)
        outline, seen, inside = np.full((len(boxes), 4), np.nan), np.zeros(len(boxes), bool), np.ones(len(boxes), bool)
        for rig, rows in labeled.rigs(frame):
            good = np.flatnonzero(rows & sane)
            outline[good], seen[good] = project_boxes(rig, name, boxes[good])
            centers = np.where(sane[rows, None], boxes.center_m[rows], 0.0)
            if self.ranged:
                inside[rows] &= np.hypot(centers[:, 0], centers[:, 1]) <= options.range_m
            if self.derived and options.in_view:
                inside[rows] &= _in_view(rig, name, centers)
            if options.regions:
                inside[rows] &= on_ground(labeled.run, options.regions, labeled.indices[frame[rows]], centers)
        # What isn't finite, or has a negative size, can't be projected; it counts once, in the first image.
        kept = np.flatnonzero(seen | (~sane & (camera == 0)))
        return frame[kept] * len(self.cameras) + camera, kept, inside[kept], outline[kept]


def views(run: Run, table: BoxTable, options: ScoreOptions, match: Match | None = None) -> tuple[View, ...]:
    """Return the native view of a run's detections or tracks first: 3D runs are scored in 3D and, projected, in the
    image. Which boxes count, and how they match, is as the options say; with a `match` instead there is one view, in
    the image or not, as it needs. Raises MetricError where that needs 3D boxes, and the results are in images.
    """
    if match is not None:
        flat = match.kind == "iou2d"
        view = image_view(run, table, options) if flat else ground_view(run, table, options)
        _, comma, which = view.key.matching.partition(",")
        how = f"iou {match.threshold:g}" if flat else str(match)
        return (replace(view, match=match, key=replace(view.key, matching=f"{how}{comma}{which}")),)
    image = image_view(run, table, options)
    return (ground_view(run, table, options), image) if isinstance(table.boxes, Boxes3D) else (image,)


def measure_classes(
    spaces: AbstractSequence[View], table: BoxTable, measure: Callable[[Sequence, Group, Match], S], nothing: S
) -> tuple[ScoreCounts[S], ...]:
    """Measure all vehicles in each space, then labels in the first: those that truth or results have, where the
    pipeline knows labels. Where there is nothing to score the statistics are `nothing`.
    """
    classes = [(view, VEHICLE) for view in spaces]
    if table.boxes.label is not None:
        met = find_labels(spaces[0].sequence.truth, spaces[0].sequence.estimates)
        classes += [(spaces[0], label_group(label)) for label in LABELS if label in met]
    return tuple(
        ScoreCounts(
            replace(view.key, class_=group.name),
            nothing if view.key.reason else measure(view.sequence, group, view.match),
        )
        for view, group in classes
    )
