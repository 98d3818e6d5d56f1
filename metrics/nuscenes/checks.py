"""What stops an evaluation: boxes that can't be told apart, too many of them, or none of the kind."""

import numpy as np

from fbench.metrics.objects import Objects
from fbench.metrics.sequence import Sequence
from fbench.replay.errors import MetricError


def check_sequence(sequence: Sequence, max_boxes: int) -> None:
    """Check what both benchmarks take for granted.

    Raises:
        MetricError: where boxes have no solid, an id is twice in a sample, a sample has too many results, or nobody
            tells where the ego is in a sample with boxes, while it is known in others.
    """
    for side, boxes in (("truth", sequence.truth), ("results", sequence.estimates)):
        _check_solids(sequence, side, boxes)
        _check_ids(sequence, side, boxes)
        _check_ego(sequence, side, boxes)
    most = np.bincount(sequence.estimates.step, minlength=1)
    if most.max(initial=0) > max_boxes:
        where = _place(sequence, int(most.argmax()))
        raise MetricError(f"{where}: {most.max()} results, nuScenes allows {max_boxes} a sample")


def check_tracked(sequence: Sequence, side: str, boxes: Objects) -> None:
    """Check that each box belongs to a track.

    Raises:
        MetricError: where one doesn't.
    """
    if (boxes.track_id < 0).any():
        step = int(boxes.step[np.argmax(boxes.track_id < 0)])
        raise MetricError(
            f"{_place(sequence, step)}: {side} without track id, nuscenes-tracking needs one for each box"
        )


def _check_solids(sequence: Sequence, side: str, boxes: Objects) -> None:
    if len(boxes) and (boxes.center_m is None or boxes.size_lwh_m is None or boxes.yaw_rad is None):
        raise MetricError(f"{sequence.name}: {side} without boxes in space, the nuScenes benchmarks need them")


def _check_ids(sequence: Sequence, side: str, boxes: Objects) -> None:
    order = np.lexsort((boxes.track_id, boxes.step))
    step, number = boxes.step[order], boxes.track_id[order]
    twice = np.flatnonzero((step[1:] == step[:-1]) & (number[1:] == number[:-1]) & (number[1:] >= 0))
    if len(twice):
        where = _place(sequence, int(step[twice[0]]))
        raise MetricError(f"{where}: {side} has id {number[twice[0]]} twice", "GT003")


def _check_ego(sequence: Sequence, side: str, boxes: Objects) -> None:
    """Ranges are about the ego."""
    if sequence.ego_m is None:
        return
    unknown = np.isnan(sequence.ego_m[boxes.step, :2]).any(axis=1)
    if unknown.any():
        where = _place(sequence, int(boxes.step[np.argmax(unknown)]))
        raise MetricError(
            f"{where}: nobody tells where the ego is, so not how far off {side} are; give each sample of the truth its "
            "ego_x, ego_y, ego_z in samples.csv"
        )


def _place(sequence: Sequence, step: int) -> str:
    return f"{sequence.name}, sample {sequence.steps.frame[step]}"
