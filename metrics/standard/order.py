"""An order of boxes that depends on what they are, not on how they were written or what their tracks are called."""

import numpy as np

from fbench.metrics.matching.lives import content_ranks, life_ranks
from fbench.metrics.objects import Objects
from fbench.replay.arrays import Array


def in_order(objects: Objects) -> Objects:
    """Sort the boxes of each step by place, size, score, class and what else is known of them, so that the order in
    which they come never decides a match. Equal boxes go by the life of their tracks: ids are names only.
    """
    box = content_ranks([objects.step, *_columns(objects)])
    if len(box) and int(box.max()) + 1 < len(box):
        return objects[np.lexsort((life_ranks(box, objects.track_id), box))]
    return objects[np.argsort(box, kind="stable")]


def _columns(objects: Objects) -> list[Array]:
    """What tells the boxes of a step apart, most important first."""
    o = objects
    boxes = [box.T for box in (o.center_m, o.size_lwh_m) if box is not None]
    boxes += [] if o.yaw_rad is None else [o.yaw_rad[None]]
    boxes += [] if o.xyxy_px is None else [o.xyxy_px.T]
    others = (o.distance_m, o.range_rate_mps, o.visibility, o.sources, o.ignore, o.inside, o.seen)
    last = [] if o.predicted is None else [o.predicted]
    return [*(row for box in boxes for row in box), o.score, *(c for c in others if c is not None), o.label, *last]
