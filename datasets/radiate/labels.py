"""Labels of RADIATE: boxes drawn on the Cartesian radar images.

M. Sheeny, E. De Pellegrin, S. Mukherjee, A. Ahrabian, S. Wang and A. Wallace, "RADIATE: A Radar Dataset for Automotive
Perception in Bad Weather", ICRA 2021.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field, StringConstraints

from fbench.datasets.radiate.radar import RANGE_STEP_M
from fbench.replay.arrays import Array, Bool, text_array
from fbench.replay.data import Boxes3D
from fbench.replay.errors import LogError
from fbench.replay.geometry.transforms import wrap_angle
from fbench.replay.imports.models import read_json
from fbench.replay.imports.wish import BadInput

CENTRE_PX = 576
"""Where the radar is in a Cartesian image, which has 1152 x 1152 px of one range step each; ahead is up."""

LABELS: Mapping[str, str] = {
    "car": "car", "van": "van", "truck": "truck", "bus": "bus", "motorbike": "motorcycle", "bicycle": "bicycle",
    "pedestrian": "pedestrian", "group_of_pedestrians": "pedestrian", "vehicle": "car",
}  # fmt: skip
"""Classes of the set; any other becomes `other`. The SDK draws `vehicle` as it draws `car`."""
GROUP = "group_of_pedestrians"
"""One box around several people: neither a hit nor a miss."""
HEIGHTS_M: Mapping[str, float] = {
    "car": 1.5, "van": 2.0, "truck": 2.5, "bus": 3.0, "motorbike": 1.5, "bicycle": 1.5, "pedestrian": 1.8, GROUP: 1.8,
    "vehicle": 1.5,
}  # fmt: skip
"""Heights [m] with which the SDK draws boxes into camera images; labels have none."""
OTHER_HEIGHT_M = 1.5

_Px = Annotated[float, Field(gt=-1e5, lt=1e5)]
_SizePx = Annotated[float, Field(gt=0, lt=1e5)]
_Nothing = Annotated[list[int], Field(max_length=0)]


class Box(BaseModel):
    """A box before it is turned about its middle: left, top, width, height [px], and the turn [deg]."""

    position: tuple[_Px, _Px, _SizePx, _SizePx]
    rotation: Annotated[float, Field(gt=-1e5, lt=1e5)]


class Object(BaseModel):
    """One object; slot k of `bboxes` is its box in radar frame k + 1, or an empty list."""

    id: Annotated[int, Field(ge=0, lt=2**62)]
    class_name: Annotated[str, StringConstraints(max_length=100)]
    bboxes: list[Box | _Nothing]


@dataclass(frozen=True)
class Annotations:
    """The objects of a sequence, each with an id of its own."""

    objects: Sequence[Object]

    @property
    def num_slots(self) -> int:
        """How many radar frames are labelled, from the first one on."""
        return max((len(o.bboxes) for o in self.objects), default=0)

    def boxes(self, number: int, radar_height_m: float) -> Boxes3D | None:
        """Return what was there in a radar frame (the first is 1), in body coordinates; `None` where it isn't labelled.

        Boxes stand on the road, `radar_height_m` below the radar; their heights are those of their classes.
        """
        if not 1 <= number <= self.num_slots:
            return None
        slots = ((o, o.bboxes[number - 1]) for o in self.objects if number <= len(o.bboxes))
        return _boxes([(o, box) for o, box in slots if isinstance(box, Box)], radar_height_m)


def read_annotations(path: Path, bad: BadInput) -> Annotations:
    """Read `annotations.json`.

    Raises:
        LogError: naming object and field that are wrong, or ids that aren't unique.
    """
    by_id: dict[int, Object] = {}
    for i, o in enumerate(read_json(path, list[Object])):
        if o.id in by_id:
            bad.met(LogError(f"{path}: {i}: another object has the id {o.id} already"))
        else:
            by_id[o.id] = o
    return Annotations(list(by_id.values()))


def _boxes(found: Sequence[tuple[Object, Box]], radar_height_m: float) -> Boxes3D:
    """Length is along the box's height in the image: boxes of oncoming vehicles are turned by 180 degrees, which tells
    that the turn is that of the heading. It is counter-clockwise (SDK, `gen_boundingbox_rot`).
    """
    left, top, width, height = np.array([box.position for _, box in found], np.float64).reshape(-1, 4).T
    tall_m = np.array([HEIGHTS_M.get(o.class_name, OTHER_HEIGHT_M) for o, _ in found], np.float64)
    forward_m = (CENTRE_PX - (top + height / 2)) * RANGE_STEP_M
    left_m = (CENTRE_PX - (left + width / 2)) * RANGE_STEP_M
    return Boxes3D(
        center_m=np.stack([forward_m, left_m, tall_m / 2 - radar_height_m], axis=1),
        size_lwh_m=np.stack([height * RANGE_STEP_M, width * RANGE_STEP_M, tall_m], axis=1),
        yaw_rad=wrap_angle(np.radians(np.array([box.rotation for _, box in found], np.float64))),
        label=text_array([LABELS.get(o.class_name, "other") for o, _ in found]),
        track_id=np.array([o.id for o, _ in found], np.int64),
        ignore=np.array([o.class_name == GROUP for o, _ in found], np.bool_),
        source_label=text_array([o.class_name for o, _ in found]),
    )


def inside_bev(boxes: Boxes3D, xyz: Array) -> Bool:
    """Tell which points (M, 3) are in which boxes (N,) from above: (N, M)."""
    x = xyz[None, :, 0] - boxes.center_m[:, 0, None]
    y = xyz[None, :, 1] - boxes.center_m[:, 1, None]
    cos, sin = np.cos(boxes.yaw_rad)[:, None], np.sin(boxes.yaw_rad)[:, None]
    half = boxes.size_lwh_m[:, :2, None] / 2
    inside: Bool = (np.abs(cos * x + sin * y) <= half[:, 0]) & (np.abs(cos * y - sin * x) <= half[:, 1])
    return inside
