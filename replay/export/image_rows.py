"""Objects as one camera sees them, for the benchmarks that score in its image."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fbench.replay.arrays import Array, Bool, Float64, Int64
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.errors import ConfigError
from fbench.replay.export.classes import Namer
from fbench.replay.export.pairs import paired
from fbench.replay.export.sequence import BoxFrame, BoxSequence, usable
from fbench.replay.export.wish import LeftOut
from fbench.replay.geometry.camera import project_boxes, require_projection
from fbench.replay.log_keys import CAMERA0
from fbench.replay.names import did_you_mean

_KITTI_CAMERA = "image_02"
"""Whose image KITTI's labels are in."""


@dataclass(frozen=True, eq=False)
class ImageRows:
    """N objects of one frame: each with a 2D box, a 3D box, or both."""

    xyxy_px: Float64
    """(N, 4) as labelled or found, else around the projected 3D box."""
    flat: Boxes2D
    flat_rows: Int64
    """(N,) row in `flat`, -1 where there is none."""
    solid: Boxes3D
    solid_rows: Int64
    """(N,) row in `solid`, -1 where there is none."""

    def __len__(self) -> int:
        return len(self.xyxy_px)

    def column(self, name: str, fill: Any) -> Array:
        """What boxes say of themselves in a field (N,): the 2D one, else the 3D one, else `fill`."""
        flat, solid = getattr(self.flat, name), getattr(self.solid, name)
        kind = np.asarray(fill).dtype if flat is None and solid is None else np.result_type(
            *(column.dtype for column in (flat, solid) if column is not None)
        )  # fmt: skip
        values = np.full(len(self), fill, kind)
        for column, rows in ((solid, self.solid_rows), (flat, self.flat_rows)):
            if column is not None:
                values[rows >= 0] = column[rows[rows >= 0]]
        return values

    def names(self, namer: Namer) -> list[str]:
        """Classes (N,), see `classes.namer`."""
        return namer(self.column("source_label", ""), self.column("label", ""))

    def __getitem__(self, rows: Bool) -> "ImageRows":
        return ImageRows(self.xyxy_px[rows], self.flat, self.flat_rows[rows], self.solid, self.solid_rows[rows])


def camera_of(sequence: BoxSequence, wished: str) -> str:
    """Return the camera whose image is meant.

    Raises:
        ConfigError: where there is no such camera, or several and none is named.
    """
    owners = sequence.cameras_of_boxes
    known = sorted({*sequence.rig.sensors("camera"), *owners})
    if wished and wished not in known:
        raise ConfigError(f"{sequence.where}: --camera {wished}: isn't in the log{did_you_mean(wished, known)}")
    preferred = [_KITTI_CAMERA] if CAMERA0 in sequence.metadata and _KITTI_CAMERA in known else []
    for names in ([wished] if wished else [], preferred, owners, known):
        if len(names) == 1:
            return names[0]
    there = f"name one of {', '.join(known)} with --camera" if known else "the log has none"
    raise ConfigError(f"{sequence.where}: which camera's image is meant? {there}")


def image_rows(frame: BoxFrame, camera: str, left: LeftOut) -> ImageRows:
    """Return the objects of a frame in the order of its 2D boxes, then 3D boxes without one, which are projected into
    the image and clipped to it; those that aren't seen in it are counted.

    Raises:
        LogError: where boxes can't be projected into the camera.
    """
    flat = _of_camera(usable(frame.boxes2d, left), camera, left)
    solid = usable(frame.boxes3d, left)
    solid = Boxes3D.empty() if solid is None else solid
    mates = paired(flat, solid) if len(flat) and len(solid) else np.full(len(flat), -1, np.int64)
    alone = np.setdiff1d(np.arange(len(solid)), mates)
    xyxy = np.zeros((0, 4))
    if len(alone):
        xyxy, seen = project_boxes(frame.rig, camera, solid[alone])
        left.add(f"not seen by {camera}", int(np.count_nonzero(~seen)))
        alone, xyxy = alone[seen], xyxy[seen]
    return ImageRows(
        np.concatenate([flat.xyxy_px, xyxy]), flat, np.concatenate([np.arange(len(flat)), np.full(len(alone), -1)]),
        solid, np.concatenate([mates, alone]),
    )  # fmt: skip


def require_view(sequence: BoxSequence, camera: str) -> None:
    """Refuse a camera that 3D boxes would have to be projected into, and can't.

    Raises:
        LogError: saying why.
    """
    for rig in {id(frame.rig): frame.rig for frame in sequence.frames if frame.boxes2d is None}.values():
        require_projection(rig, camera)


def _of_camera(boxes: Boxes2D | None, camera: str, left: LeftOut) -> Boxes2D:
    if boxes is None or not len(boxes):
        return Boxes2D.empty()
    own = boxes.camera == camera
    left.add("of other cameras", int(np.count_nonzero(~own)))
    return boxes if own.all() else boxes[own]
