"""Objects in space by hand, one a line of the table."""

from collections.abc import Sequence as List
from dataclasses import dataclass

import numpy as np

from fbench.replay.data.sequences import Objects, Sequence, Steps


@dataclass(frozen=True)
class Box:
    """One truth box or estimate, 4 x 2 x 1.5 m at (x, y)."""

    step: int
    x: float
    y: float = 0.0
    id: int = -1
    score: float = 0.0
    label: str = "car"
    visibility: float = 1.0
    distance: float = np.nan
    rate: float = np.nan
    sources: int = 0


def objects(boxes: List[Box]) -> Objects:
    """Boxes in the order of their steps."""
    rows = sorted(boxes, key=lambda box: box.step)
    n = len(rows)
    return Objects(
        np.array([b.step for b in rows], np.int64), np.array([b.label for b in rows], np.str_),
        np.array([b.id for b in rows], np.int64), np.array([b.score for b in rows], np.float64),
        center_m=np.array([[b.x, b.y, 0.0] for b in rows], np.float64).reshape(n, 3),
        size_lwh_m=np.tile([4.0, 2.0, 1.5], (n, 1)), yaw_rad=np.zeros(n),
        visibility=np.array([b.visibility for b in rows], np.float64),
        distance_m=np.array([b.distance for b in rows], np.float64),
        range_rate_mps=None if np.isnan([b.rate for b in rows]).all() else np.array([b.rate for b in rows], np.float64),
        sources=np.array([b.sources for b in rows], np.uint8),
    )  # fmt: skip


def sequence(
    truth: List[Box], estimates: List[Box], num: int, streams: List[int] | None = None, period_s: float = 0.1
) -> Sequence:
    """Steps 0 to `num` - 1, at equal intervals."""
    stream = np.zeros(num, np.int64) if streams is None else np.array(streams, np.int64)
    steps = Steps(np.arange(num), (np.arange(num) * period_s * 1e9).astype(np.int64), stream)
    return Sequence("s", steps, objects(truth), objects(estimates))
