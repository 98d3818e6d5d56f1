"""Boxes that Argoverse 2's challenges count."""

from dataclasses import dataclass, replace

import numpy as np

from fbench.metrics.core.exact import Counts
from fbench.metrics.profiles.nuscenes.boxes import find_invalid, solids
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.data.sequences import Objects, Sequence
from fbench.replay.formats.export_request import AV2_CLASSES

CLASSES = tuple(sorted(name.lower() for name in AV2_CLASSES))
"""`SensorCompetitionCategories` of av2-api 0.3.6, `evaluation/__init__.py`; RAILED_VEHICLE and others aren't scored."""


@dataclass(frozen=True)
class LeftOut(Counts):
    """Boxes that neither side is judged on, except `invalid`, which are false positives; for reports."""

    unknown_class: int = 0
    unknown_class_truth: int = 0
    out_of_range: int = 0
    out_of_range_truth: int = 0
    no_points_truth: int = 0
    ignored_truth: int = 0
    above_limit: int = 0  # Results beyond the highest scores of their class and sweep
    invalid: int = 0  # Results that aren't finite or have no size (PRD001)
    invalid_truth: int = 0  # Truth boxes that aren't finite or have no size (GT004)


@dataclass(frozen=True, eq=False)
class Side:
    """N boxes that count, and how many were left out for which reason."""

    boxes: Objects
    kind: Int64  # (N,) index in `CLASSES`
    invalid: Bool  # (N,) never match; truth has none
    left_out: dict[str, int]


def check_places(sequence: Sequence) -> None:
    """Check that boxes are in space. Raises MetricError where they aren't."""
    for boxes in (sequence.truth, sequence.estimates):
        if len(boxes) and (boxes.center_m is None or boxes.size_lwh_m is None or boxes.yaw_rad is None):
            raise MetricError(f"{sequence.name}: boxes without a place in space, Argoverse 2's challenges need one")


def select_side(sequence: Sequence, boxes: Objects, range_m: float, in_plane: bool) -> Side:
    """Return the boxes of known classes up to a range from the ego: in space below it, or in the ground plane up to it,
    as detections and as tracks are filtered. What isn't finite stays.
    """
    kind = np.full(len(boxes), -1, np.int64)
    for i, name in enumerate(CLASSES):
        kind[boxes.label == name] = i
    invalid = find_invalid(replace(boxes, velocity_mps=None))  # Argoverse 2 knows no velocities
    offset = solids(boxes).center_m - (0.0 if sequence.ego_m is None else sequence.ego_m[boxes.step])
    distance_m = np.linalg.norm(offset[:, : 2 if in_plane else 3], axis=1)
    far = distance_m > range_m if in_plane else distance_m >= range_m
    unknown = kind < 0
    far &= ~unknown & ~invalid
    kept = ~unknown & ~far
    counts = {"unknown_class": int(unknown.sum()), "out_of_range": int(far.sum())}
    return Side(boxes[kept], kind[kept], invalid[kept], counts)
