"""Making truth fit to be scored: in body coordinates, without boxes that aren't real."""

from collections import Counter
from dataclasses import replace
from typing import TypeVar

import numpy as np

from fbench.replay.arrays import Bool, Float64
from fbench.replay.boxes import Boxes2D, Boxes3D, finite
from fbench.replay.data import Truth
from fbench.replay.errors import LogError
from fbench.replay.faults import FaultLog
from fbench.replay.geometry.boxes import moved
from fbench.replay.geometry.transforms import inverse

B = TypeVar("B", Boxes2D, Boxes3D)


def fitted(truth: Truth, index: int, world_T_body: Float64 | None, has_poses: bool, faults: FaultLog) -> Truth | None:
    """Return the truth of a frame without boxes that aren't finite or have no size, which are counted as GT004; those
    in the world are moved to the body. `None` where that can't be done at this frame alone, counted as GT006.

    Args:
        truth: Of frame `index`.
        index: The frame's.
        world_T_body: Pose (4, 4) at the frame's instant, where known.
        has_poses: Whether any frame has one.
        faults: Where boxes are counted.

    Raises:
        LogError: where boxes are in the world and no pose is known.
    """
    boxes3d, boxes2d = truth.boxes3d, truth.boxes2d
    if boxes3d is not None:
        boxes3d = _real(boxes3d, index, faults)
    if boxes3d is not None and truth.in_world and len(boxes3d):
        if not has_poses:
            raise LogError(
                "truth is in world coordinates, but the log has no poses of the body at its frames; give boxes in body "
                "coordinates, or a log with poses"
            )
        if world_T_body is None:
            faults.add("GT006", f"truth of frame {index} in the world, where the log has no pose")
            return None
        boxes3d = moved(boxes3d, inverse(world_T_body))
    return replace(
        truth,
        boxes3d=boxes3d,
        boxes2d=None if boxes2d is None else _real(boxes2d, index, faults),
        in_world=False,
    )


def is_real(boxes: Boxes2D | Boxes3D) -> Bool:
    """Tell which boxes (N,) are finite and have a size."""
    sane, _ = finite(boxes)
    sizes = boxes.size_lwh_m if isinstance(boxes, Boxes3D) else boxes.xyxy_px[:, 2:] - boxes.xyxy_px[:, :2]
    real: Bool = sane & np.all(sizes > 0, axis=1)
    return real


def _real(boxes: B, index: int, faults: FaultLog) -> B:
    real = is_real(boxes)
    if real.all():
        return boxes
    names = boxes.source_label if boxes.source_label is not None else boxes.label
    labels = Counter([""] * int((~real).sum()) if names is None else names[~real].tolist())
    for name, num in sorted(labels.items()):
        faults.add("GT004", f"frame {index}: {num} of class '{name}'" if name else f"frame {index}: {num}", num)
    return boxes[real]
