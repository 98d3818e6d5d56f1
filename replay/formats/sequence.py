"""Boxes of one run or log as exporters see them."""

from collections import defaultdict, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import MAX_MAGNITUDE, Boxes2D, Boxes3D, finite
from fbench.replay.data.metadata import CAMERA0
from fbench.replay.data.rig import Kind, Rig
from fbench.replay.formats.export_request import LeftOut, Namer
from fbench.replay.geometry.camera import project_boxes, require_projection
from fbench.replay.logs.coordinate_frames import BODY

B = TypeVar("B", Boxes2D, Boxes3D)
CAMERA_T_LEVEL: Float64 = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64)
"""(4, 4) from a coordinate frame at the camera with x forward, y left, z up: there boxes stand upright. In the camera's
own, with z forward, yaw, pitch and roll of a box that stands upright aren't unique."""
KITTI_CAMERA = "image_02"  # Whose image KITTI's labels are in
_LIMIT = 2**31  # Tools read ids as int32, or as float64 that don't tell larger ones apart


@dataclass(frozen=True, eq=False)
class BoxFrame:
    """One frame and the boxes in it; `None` where it has none of a kind, which isn't the same as nothing there."""

    index: int  # Place among the frames of the log, from 0
    number: int | None  # As the recorder or dataset numbers it
    stamp_ns: int
    rig: Rig
    boxes3d: Boxes3D | None  # In body coordinates at the stamp
    boxes2d: Boxes2D | None
    world_T_body: Float64 | None = None  # (4, 4) where known


@dataclass(frozen=True, eq=False)
class BoxSequence:
    """One run or log."""

    where: str  # For errors
    name: str  # For files
    metadata: Mapping[str, str]
    is_truth: bool
    frames: Sequence[BoxFrame]
    num_frames: int  # Of the log up to the last one that is known, also those without truth
    kinds: Collection[Kind] = ()  # Of the sensors that results come from

    @property
    def boxes(self) -> Sequence[Boxes2D | Boxes3D]:
        """Those of all frames, 3D ones first."""
        both = ((frame.boxes3d, frame.boxes2d) for frame in self.frames)
        return [boxes for pair in both for boxes in pair if boxes is not None and len(boxes)]

    @property
    def rig(self) -> Rig:
        """The sensors as it begins."""
        return self.frames[0].rig if self.frames else Rig({}, {})

    @cached_property
    def cameras_of_boxes(self) -> Sequence[str]:
        """Those in whose images there are 2D boxes, sorted."""
        flat = (frame.boxes2d.camera for frame in self.frames if frame.boxes2d is not None)
        return sorted({name for names in flat for name in names.tolist()})

    def numbers(self) -> list[int]:
        """Number of each frame: the log's own where every frame has one of its own, else its index."""
        own = [frame.number for frame in self.frames]
        known = [number for number in own if number is not None]
        return known if len(set(known)) == len(own) else [frame.index for frame in self.frames]


def drop_unusable(boxes: B | None, left: LeftOut) -> B | None:
    """Drop boxes whose geometry or score isn't finite, or is beyond all reason, and count them."""
    if boxes is None or not len(boxes):
        return boxes
    sane, scored = finite(boxes)
    good: Bool = sane & scored if boxes.score is None else sane & (np.abs(boxes.score) < MAX_MAGNITUDE)
    left["not finite"] += int(np.count_nonzero(~good))
    return boxes if good.all() else boxes[good]


def pair_boxes(
    flat: Boxes2D, solid: Boxes3D, flat_frame: Int64 | None = None, solid_frame: Int64 | None = None
) -> Int64:
    """Return the 3D box (N,) of each of N 2D boxes, -1 where it has none. Boxes of one track id belong together. Those
    without an id do in their order, within a class as the source names it; ignore regions have no other half.
    `flat_frame` (N,) and `solid_frame` (M,) are the frames of boxes, where they are of several.
    """
    ignored, ids, classes, keys = [], [], [], []
    for boxes, frame in ((flat, flat_frame), (solid, solid_frame)):
        num, names = len(boxes), boxes.label if boxes.source_label is None else boxes.source_label
        ignored.append(np.zeros(num, bool) if boxes.ignore is None else boxes.ignore)
        ids.append(np.full(num, -1) if boxes.track_id is None else boxes.track_id)
        at = [0] * num if frame is None else frame.tolist()
        classes.append(list(zip(at, [""] * num if names is None else names.tolist(), strict=True)))
        keys.append(list(zip(at, ids[-1].tolist(), strict=True)))
    by_id = {key: j for j, key in enumerate(keys[1]) if key[1] >= 0}
    mates = np.array([by_id.get(key, -1) if key[1] >= 0 else -1 for key in keys[0]], np.int64)
    waiting: defaultdict[tuple[int, str], deque[int]] = defaultdict(deque)
    for j in np.flatnonzero((ids[1] < 0) & ~ignored[1]).tolist():
        waiting[classes[1][j]].append(j)
    for i in np.flatnonzero((ids[0] < 0) & ~ignored[0]).tolist():
        if rows := waiting[classes[0][i]]:
            mates[i] = rows.popleft()
    return mates


@dataclass(frozen=True, eq=False)
class ImageRows:
    """N objects: each with a 2D box, a 3D box, or both."""

    frame: Int64  # (N,) ascending, where they are of several frames
    xyxy_px: Float64  # (N, 4) as labeled or found, else around the projected 3D box; NaN where there is none
    flat: Boxes2D
    flat_rows: Int64  # (N,) row in `flat`, -1 where there is none
    solid: Boxes3D
    solid_rows: Int64  # (N,) row in `solid`, -1 where there is none

    def __len__(self) -> int:
        return len(self.xyxy_px)

    def column(self, name: str, fill: Any) -> Array:
        """What boxes say of themselves in a field (N,): the 2D one, else the 3D one, else `fill`."""
        flat, solid = getattr(self.flat, name), getattr(self.solid, name)
        kinds = [column.dtype for column in (flat, solid) if column is not None] or [np.asarray(fill).dtype]
        values = np.full(len(self), fill, np.result_type(*kinds))
        for column, rows in ((solid, self.solid_rows), (flat, self.flat_rows)):
            if column is not None:
                values[rows >= 0] = column[rows[rows >= 0]]
        return values

    def names(self, namer: Namer) -> list[str]:
        """Classes (N,), see `export_request.namer`."""
        return namer(self.column("source_label", ""), self.column("label", ""))

    def __getitem__(self, rows: Bool | Int64) -> "ImageRows":
        columns = self.frame[rows], self.xyxy_px[rows]
        return ImageRows(*columns, self.flat, self.flat_rows[rows], self.solid, self.solid_rows[rows])


def choose_camera(sequence: BoxSequence, requested: str) -> str:
    """Return the camera whose image is meant. Raises ConfigError where it isn't there, or none of several is named."""
    owners = sequence.cameras_of_boxes
    known = sorted({*sequence.rig.sensors("camera"), *owners})
    if requested and requested not in known:
        raise ConfigError(f"{sequence.where}: --camera {requested}: isn't in the log{did_you_mean(requested, known)}")
    preferred = [KITTI_CAMERA] if CAMERA0 in sequence.metadata and KITTI_CAMERA in known else []
    for names in ([requested] if requested else [], preferred, owners, known):
        if len(names) == 1:
            return names[0]
    there = f"name one of {', '.join(known)} with --camera" if known else "the log has none"
    raise ConfigError(f"{sequence.where}: which camera's image is meant? {there}")


def coordinate_frame(sequence: BoxSequence, requested: str, camera: str) -> str:
    """Return `body` or a camera: as asked for, as the log says, else that of the image. ConfigError otherwise."""
    known = [BODY, *sequence.rig.sensors("camera")]
    name = requested or sequence.metadata.get(CAMERA0, camera)
    if name not in known and any(frame.boxes3d is not None for frame in sequence.frames):
        raise ConfigError(f"{sequence.where}: --frame {name}: neither 'body' nor a camera{did_you_mean(name, known)}")
    return name


def body_T_level(name: str, rig: Rig) -> Float64 | None:
    """Matrix (4, 4) from coordinates at a camera, with x forward, y left, z up, to the body; `None`: they are the same,
    as in KITTI's logs. There boxes stand upright, and the camera's own coordinates are these with the axes turned.
    """
    return None if name == BODY or name not in rig.mounts else rig.body_T_sensor(name) @ CAMERA_T_LEVEL


def image_frames(sequence: BoxSequence, camera: str, left: LeftOut) -> Iterator[tuple[BoxFrame, ImageRows]]:
    """Return frames and their objects: first the 2D boxes, then 3D boxes without one, which are projected into the
    image and clipped to it; those that aren't seen in it are counted. Raises LogError where boxes can't be projected
    into the camera.
    """
    for rig in {id(frame.rig): frame.rig for frame in sequence.frames if frame.boxes2d is None}.values():
        require_projection(rig, camera)
    return ((frame, _image_rows(frame, camera, left)) for frame in sequence.frames)


def _image_rows(frame: BoxFrame, camera: str, left: LeftOut) -> ImageRows:
    flat, solid = drop_unusable(frame.boxes2d, left), drop_unusable(frame.boxes3d, left)
    flat = Boxes2D.empty() if flat is None else flat
    solid = Boxes3D.empty() if solid is None else solid
    own = flat.camera == camera
    left["of other cameras"] += int(np.count_nonzero(~own))
    flat = flat if own.all() else flat[own]
    mates = pair_boxes(flat, solid) if len(flat) and len(solid) else np.full(len(flat), -1, np.int64)
    alone = np.setdiff1d(np.arange(len(solid)), mates)
    xyxy = np.zeros((0, 4))
    if len(alone):
        xyxy, seen = project_boxes(frame.rig, camera, solid[alone])
        left[f"not seen by {camera}"] += int(np.count_nonzero(~seen))
        alone, xyxy = alone[seen], xyxy[seen]
    flat_rows = np.concatenate([np.arange(len(flat)), np.full(len(alone), -1)])
    both, solid_rows = np.concatenate([flat.xyxy_px, xyxy]), np.concatenate([mates, alone])
    return ImageRows(np.zeros(len(both), np.int64), both, flat, flat_rows, solid, solid_rows)


def small_ids(parts: Iterable[Boxes2D | Boxes3D]) -> Callable[[int], int]:
    """Return what numbers ids: as they are where all of a sequence are small, else 0, 1 ... as they come; -1 stays."""
    ids = [id_ for boxes in parts if boxes.track_id is not None for id_ in boxes.track_id.tolist() if id_ >= 0]
    if max(ids, default=0) < _LIMIT:
        return lambda id_: id_
    numbers = {id_: number for number, id_ in enumerate(dict.fromkeys(ids))}
    return lambda id_: numbers.get(id_, -1)
