"""Boxes in 3D and in images: one struct of arrays each for truth, detections and tracks."""

from dataclasses import dataclass, fields, replace
from enum import IntFlag
from typing import Any, Self, TypeAlias, TypeVar

import numpy as np

from fbench.replay.contracts.errors import DataError
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Shape, Text, freeze_fields

LABELS = ("car", "van", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian", "other")
VEHICLES = ("car", "van", "truck", "bus", "trailer", "motorcycle")

MAX_MAGNITUDE = 1e9
"""Coordinates, sizes and angles from here on count as not finite: no box of a vehicle's world has them."""


MAX_BOXES = 1000
"""Boxes of one frame in space, or in one camera's image: more are refused, since pairs of boxes are compared. Devkits
allow fewer (nuScenes 500 of a sample, COCO 100 of an image)."""


class Source(IntFlag):
    """Which sensors contributed to a box."""

    C = 1
    L = 2
    R = 4
    S = 8


class Rows:
    """Selecting rows of a struct of arrays."""

    def arrays(self) -> dict[str, Array]:
        """Return all arrays that are present, by field name."""
        named = ((f.name, getattr(self, f.name)) for f in fields(self))  # type: ignore[arg-type]
        return {name: value for name, value in named if value is not None}

    def __getitem__(self, rows: Array | slice) -> Self:
        """Select rows by mask, index array or slice; those of `Objects` must stay in order."""
        return replace(self, **{name: value[rows] for name, value in self.arrays().items()})  # type: ignore[type-var]


_ONE: tuple[str, Shape] = ("f8", ("N",))
_TEXT: tuple[str, Shape] = ("U", ("N",))
_COMMON: dict[str, tuple[str, Shape]] = {
    "label": _TEXT, "score": _ONE, "track_id": ("i8", ("N",)), "sources": ("u1", ("N",)), "predicted": ("?", ("N",)),
    "visibility": _ONE, "occlusion": _ONE, "truncation": _ONE, "attribute": _TEXT, "num_lidar_pts": ("i8", ("N",)),
    "num_radar_pts": ("i8", ("N",)), "ignore": ("?", ("N",)), "source_label": _TEXT,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Boxes3D(Rows):
    """N boxes in body coordinates at the frame's stamp: x forward, y left, z up."""

    center_m: Float64
    """(N, 3), the middle of the box."""
    size_lwh_m: Float64
    """(N, 3) length along heading, width, height."""
    yaw_rad: Float64
    """(N,) heading about z; R = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll_rad: Float64 | None = None
    pitch_rad: Float64 | None = None
    velocity_mps: Float64 | None = None
    """(N, 3) over ground, in body axes; NaN where unknown."""
    label: Text | None = None
    """(N,) of `LABELS`; `None`: the pipeline knows no classes."""
    score: Float64 | None = None
    track_id: Int64 | None = None
    sources: Array | None = None
    """(N,) uint8, bits of `Source`."""
    predicted: Bool | None = None
    """(N,) true where a tracker predicted the box and nothing measured it."""
    visibility: Float64 | None = None
    """(N,) visible share, 0 to 1."""
    occlusion: Float64 | None = None
    """(N,) in the dataset's own levels."""
    truncation: Float64 | None = None
    attribute: Text | None = None
    num_lidar_pts: Int64 | None = None
    num_radar_pts: Int64 | None = None
    ignore: Bool | None = None
    """(N,) neither a hit nor a miss."""
    source_label: Text | None = None
    """(N,) the class as the dataset names it."""

    def __post_init__(self) -> None:
        three: tuple[str, Shape] = ("f8", ("N", 3))
        angles = {"yaw_rad": _ONE, "roll_rad": _ONE, "pitch_rad": _ONE}
        freeze_fields(self, center_m=three, size_lwh_m=three, **angles, velocity_mps=three, **_COMMON)

    def __len__(self) -> int:
        return len(self.center_m)

    @property
    def geometry(self) -> Float64:
        """(N, 7 to 9) center, size, and the angles that are there."""
        angles = [a for a in (self.yaw_rad, self.roll_rad, self.pitch_rad) if a is not None]
        return np.column_stack([self.center_m, self.size_lwh_m, *angles])

    @classmethod
    def empty(cls) -> "Boxes3D":
        """Return no boxes."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True, eq=False)
class Boxes2D(Rows):
    """N boxes in images, of one or several cameras."""

    camera: Text
    """(N,) name of the camera."""
    xyxy_px: Float64
    """(N, 4) left, top, right, bottom [px]; pixel centers are at integers, the image spans -0.5 to size - 0.5."""
    visible_xyxy_px: Float64 | None = None
    label: Text | None = None
    score: Float64 | None = None
    track_id: Int64 | None = None
    distance_m: Float64 | None = None
    """(N,) from the body's origin to the box's middle; NaN where unknown."""
    range_rate_mps: Float64 | None = None
    """(N,) change of distance, positive when receding; NaN where unknown."""
    sources: Array | None = None
    predicted: Bool | None = None
    visibility: Float64 | None = None
    occlusion: Float64 | None = None
    truncation: Float64 | None = None
    attribute: Text | None = None
    num_lidar_pts: Int64 | None = None
    num_radar_pts: Int64 | None = None
    ignore: Bool | None = None
    source_label: Text | None = None

    def __post_init__(self) -> None:
        four: tuple[str, Shape] = ("f8", ("N", 4))
        radial = {"distance_m": _ONE, "range_rate_mps": _ONE}
        freeze_fields(self, camera=_TEXT, xyxy_px=four, visible_xyxy_px=four, **radial, **_COMMON)

    def __len__(self) -> int:
        return len(self.xyxy_px)

    @property
    def geometry(self) -> Float64:
        """(N, 4) left, top, right, bottom [px]."""
        return self.xyxy_px

    @classmethod
    def empty(cls) -> "Boxes2D":
        """Return no boxes."""
        return cls(np.zeros(0, "U1"), np.zeros((0, 4)))


def finite(boxes: Boxes2D | Boxes3D) -> tuple[Bool, Bool]:
    """Tell of which boxes (N,) the geometry is finite, and motion and distance are finite or unknown; and of which the
    score is finite or absent.
    """
    sane: Bool = np.all(np.abs(np.nan_to_num(boxes.geometry, nan=np.inf)) < MAX_MAGNITUDE, axis=1)
    known = (boxes.velocity_mps,) if isinstance(boxes, Boxes3D) else (boxes.distance_m, boxes.range_rate_mps)
    for values in known:
        if values is not None:
            infinite = np.abs(values) >= MAX_MAGNITUDE  # NaN: unknown
            sane &= ~(infinite if infinite.ndim == 1 else infinite.any(axis=1))
    scored: Bool = np.ones(len(boxes), bool) if boxes.score is None else np.isfinite(boxes.score)
    return sane, scored


def most_boxes(boxes: Boxes2D | Boxes3D) -> int:
    """How many boxes are compared with each other, at most: those in space, or in one image where all are too many."""
    if isinstance(boxes, Boxes3D) or len(boxes) <= MAX_BOXES:
        return len(boxes)
    return int(np.unique(boxes.camera, return_counts=True)[1].max())


B = TypeVar("B", "Boxes2D", "Boxes3D")


def concatenate(parts: list[B]) -> B:
    """Join boxes of one type. Raises DataError where an optional field is present only in some non-empty parts."""
    full = [part for part in parts if len(part)] or parts[:1]
    if not full:
        raise DataError("concatenate: expected at least one part, got none")
    joined: dict[str, Any] = {}
    for f in fields(full[0]):
        present = [array for part in full if (array := getattr(part, f.name)) is not None]
        if present and len(present) < len(full):
            what = f"expected in all {len(full)} parts, absent in {len(full) - len(present)}"
            raise DataError(f"{type(full[0]).__name__}.{f.name}: {what}")
        if present:
            joined[f.name] = np.concatenate(present)
    return type(full[0])(**joined)


Boxes: TypeAlias = Boxes2D | Boxes3D
