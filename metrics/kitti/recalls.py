"""Which confidence thresholds stand for which recalls, as KITTI's devkits choose them."""

import numpy as np

from fbench.replay.arrays import Float64


def recall_thresholds(scores: Float64, num_truth: int, num_recalls: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the thresholds nearest to recalls 0, 1/`num_recalls`, 2/`num_recalls` ..., falling, and these recalls.

    Recalls beyond what the hits reach have no threshold; the lowest score always has one.

    Args:
        scores: (H,) of the hits.
        num_truth: Truth boxes, found or missed.
        num_recalls: 40.
    """
    thresholds, recalls, aim = [], [], 0.0
    for i, score in enumerate(np.sort(scores)[::-1].tolist()):
        here, is_last = (i + 1) / num_truth, i == len(scores) - 1
        if not is_last and (i + 2) / num_truth - aim < aim - here:
            continue
        thresholds.append(score)
        recalls.append(aim)
        aim += 1 / num_recalls
    return tuple(thresholds), tuple(recalls)
