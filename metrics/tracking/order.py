"""An order of boxes that doesn't depend on how they were written down, for profiles where ties must not either."""

import numpy as np

from fbench.metrics.matching.lives import content_ranks, life_ranks
from fbench.metrics.objects import Objects
from fbench.replay.arrays import Array, Int64


def by_content(objects: Objects, rows: Int64) -> Int64:
    """Order rows (K,) within their steps by box, then by the life of their tracks: ids are names only."""
    chosen = objects[rows]
    box = content_ranks([chosen.step, *_columns(chosen)])
    return np.asarray(rows[np.lexsort((life_ranks(box, chosen.track_id), box))])


def _columns(objects: Objects) -> list[Array]:
    """What tells boxes of a step apart, most important first."""
    boxes = (objects.xyxy_px, objects.center_m, objects.size_lwh_m)
    columns = [column for box in boxes if box is not None for column in box.T]
    yaw = [] if objects.yaw_rad is None else [objects.yaw_rad]
    return [*columns, *yaw, objects.score, objects.label]
