"""Boxes of several sensors merged pairwise, in the order of the sensors."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fbench.pipelines.plain.extents import Extents, iou, joined
from fbench.replay.arrays import Int64


def merged(parts: Sequence[Extents], min_iou: float) -> Extents:
    """Merge the boxes of sensors, one sensor after the other, into those that are there already.

    A box joins the one that it overlaps most, the first of several, where that is at least `min_iou`; else it stays by
    itself. Boxes of one sensor aren't merged with each other, but several of them may join the same box. A box that
    others joined keeps its outline; label, distance and range rate are the first that are known, the score is the
    highest. So the order of sensors matters: the thesis takes outline and class from the camera and distance from
    LiDAR, which therefore come first.
    """
    result = parts[0]
    for part in parts[1:]:
        if not len(result) or not len(part):
            result = joined([result, part])
            continue
        overlap = iou(part, result)
        partner = np.argmax(overlap, axis=1)
        joins = overlap[np.arange(len(part)), partner] >= min_iou
        result = joined([_with(result, part[joins], partner[joins]), part[~joins]])
    return result


def _with(boxes: Extents, others: Extents, partner: Int64) -> Extents:
    """Add what others know to the boxes (M,) that they join."""
    distance, rate, label = boxes.distance_m.copy(), boxes.range_rate_mps.copy(), boxes.label.copy()
    score, sources = boxes.score.copy(), boxes.sources.copy()
    for row, at in enumerate(partner):
        distance[at] = others.distance_m[row] if np.isnan(distance[at]) else distance[at]
        rate[at] = others.range_rate_mps[row] if np.isnan(rate[at]) else rate[at]
        label[at] = label[at] or others.label[row]
        score[at] = max(score[at], others.score[row])
        sources[at] |= others.sources[row]
    return replace(boxes, distance_m=distance, range_rate_mps=rate, label=label, score=score, sources=sources)
