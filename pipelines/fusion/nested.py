"""Boxes of one image that lie in others: detectors take parts of an object for objects, too."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from fbench.pipelines.fusion.lift import Sighting
from fbench.replay.arrays import Float64

_PART = 0.5
"""Up to this share of a box may lie in a surer one without a doubt: objects hide each other."""
_LEAST = 0.01
"""What is left of the score of a box that lies in a surer one as a whole."""
_SURE, _NEARLY = 0.5, 0.9
"""A camera alone reports a box whose score is still this high, or this share of what it was."""
_IN_FRONT_PX = 1.0
"""A box whose lower edge is by more than this lower in the image stands in front of the other."""


def less_sure_of_parts(seen: Sequence[Sighting]) -> list[Sighting]:
    """Lower the scores of boxes of which more than half lies in a surer one of the same image, in proportion to it,
    unless they stand in front of that; those that aren't likelier there than not count only where others confirm them.

    The surest box goes first, and what it lowered counts as lowered. Of equal scores the first by its edges and its
    label is the surer, so that the order in which they were listed doesn't matter. Scores that aren't above 0 stay.
    """
    ordered = sorted(seen, key=lambda s: (s.camera, -s.score, *s.xyxy_px.tolist(), s.label))
    found = list[Sighting]()
    for _, group in groupby(ordered, key=lambda s: s.camera):
        own = list(group)
        scores = _lowered([s.score for s in own], _shares(np.array([s.xyxy_px for s in own])))
        found += [_believed(s, score) for s, score in zip(own, scores, strict=True)]
    return found


def _shares(xyxy: Float64) -> Float64:
    """Share (N, N) of each box (N, 4) that another one, which it isn't in front of, covers."""
    low = np.maximum(xyxy[:, None, :2], xyxy[None, :, :2])
    high = np.minimum(xyxy[:, None, 2:], xyxy[None, :, 2:])
    area = np.prod(xyxy[:, 2:] - xyxy[:, :2], axis=1)
    share = np.prod(np.maximum(high - low, 0.0), axis=2) / np.maximum(area, 1e-9)[:, None]
    in_front = xyxy[:, None, 3] > xyxy[None, :, 3] + _IN_FRONT_PX
    return np.where(in_front, 0.0, share)


def _lowered(scores: list[float], share: Float64) -> list[float]:
    """Scores, from the highest down, each by the largest share in a box whose lowered score is still higher."""
    result = list[float]()
    for at, score in enumerate(scores):
        surer = [k for k, other in enumerate(result) if other >= score]
        part = float(share[at, surer].max(initial=0.0))
        factor = min(max((1.0 - part) / (1.0 - _PART), _LEAST), 1.0)
        result.append(score * factor if score > 0 else score)
    return result


def _believed(sighting: Sighting, score: float) -> Sighting:
    if score == sighting.score:
        return sighting
    is_sure = sighting.is_sure and score >= min(_SURE, _NEARLY * sighting.score)
    return replace(sighting, score=score, is_sure=is_sure)
