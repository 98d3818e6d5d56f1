"""What nuScenes calls attributes: whether something moves, or is ridden."""

from collections.abc import Sequence

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D

NAMES = (
    "pedestrian.moving", "pedestrian.sitting_lying_down", "pedestrian.standing", "cycle.with_rider",
    "cycle.without_rider", "vehicle.moving", "vehicle.parked", "vehicle.stopped",
)  # fmt: skip
_MOVING_MPS = 0.2
"""Slower things stand, as baselines of the benchmark have it; measured velocities are never quite 0."""
_BY_CLASS = {
    "pedestrian": ("pedestrian.moving", "pedestrian.standing"),
    "bicycle": ("cycle.with_rider", "cycle.without_rider"),
    "motorcycle": ("cycle.with_rider", "cycle.without_rider"),
    "bus": ("vehicle.moving", "vehicle.stopped"),
    **dict.fromkeys(("car", "truck", "trailer", "construction_vehicle"), ("vehicle.moving", "vehicle.parked")),
}
"""When moving and when not; what isn't here has no attribute."""


def attributes(boxes: Boxes3D, names: Sequence[str], velocity_mps: Float64) -> list[str]:
    """Return the attribute (N,) of boxes: the one that they have, where it is one of nuScenes, else by their speed;
    empty where that isn't known (the devkit takes this, and counts it as wrong).

    Args:
        boxes: N of them.
        names: Their classes as nuScenes calls them.
        velocity_mps: (N, 3) over ground, NaN where unknown.
    """
    own = [""] * len(boxes) if boxes.attribute is None else boxes.attribute.tolist()
    speeds = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1]).tolist()
    return [
        told if told in NAMES else _by_speed(name, speed) for told, name, speed in zip(own, names, speeds, strict=True)
    ]


def _by_speed(name: str, speed_mps: float) -> str:
    if np.isnan(speed_mps) or name not in _BY_CLASS:
        return ""
    moving, still = _BY_CLASS[name]
    return moving if speed_mps > _MOVING_MPS else still
