"""Which boxes of one sensor a pipeline reports."""

from dataclasses import replace

import numpy as np

from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Source


def reported(boxes: Boxes3D, min_score: float, source: Source, labelled: bool = False) -> Boxes3D:
    """Keep boxes with at least `min_score`, highest first, with the same fields in every frame.

    Velocities are NaN where none were measured. Equal scores are ordered by place. `labelled` tells whether boxes of
    this pipeline have labels, also where there are no boxes.
    """
    num = len(boxes)
    score = np.zeros(num) if boxes.score is None else boxes.score
    full = replace(
        boxes,
        velocity_mps=np.full((num, 3), np.nan) if boxes.velocity_mps is None else boxes.velocity_mps,
        label=np.zeros(0, np.str_) if labelled and not num else boxes.label,
        score=score,
        sources=np.full(num, int(source), np.uint8),
    )
    order = np.lexsort((*boxes.center_m.T[::-1], -score))
    return full[order[score[order] >= max(min_score, np.finfo(np.float64).tiny)]]
