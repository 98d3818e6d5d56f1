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
_SURE = 0.5


def less_sure_of_parts(seen: Sequence[Sighting]) -> list[Sighting]:
    """Lower the scores of boxes of which more than half lies in a surer one of the same image, in proportion to it;
    those that aren't likelier there than not count only where others confirm them.

    The order in which they were listed doesn't matter: of equal scores the box that is first by its edges is the surer.
    The result is ordered by camera and certainty.
    """
    ordered = sorted(seen, key=lambda s: (s.camera, -s.score, *s.xyxy_px.tolist(), s.label))
    found = list[Sighting]()
    for _, group in groupby(ordered, key=lambda s: s.camera):
        own = list(group)
        factors = np.clip((1.0 - _largest_shares(np.array([s.xyxy_px for s in own]))) / (1.0 - _PART), _LEAST, 1.0)
        found += [_doubted(s, factor) for s, factor in zip(own, factors.tolist(), strict=True)]
    return found


def _largest_shares(xyxy: Float64) -> Float64:
    """Largest share (N,) of each box (N, 4) that one of those before it covers."""
    low = np.maximum(xyxy[:, None, :2], xyxy[None, :, :2])
    high = np.minimum(xyxy[:, None, 2:], xyxy[None, :, 2:])
    area = np.prod(xyxy[:, 2:] - xyxy[:, :2], axis=1)
    share = np.prod(np.maximum(high - low, 0.0), axis=2) / np.maximum(area, 1e-9)[:, None]
    return np.asarray(np.tril(share, -1).max(axis=1, initial=0.0), np.float64)


def _doubted(sighting: Sighting, factor: float) -> Sighting:
    if factor == 1.0:
        return sighting
    score = sighting.score * factor
    return replace(sighting, score=score, is_sure=sighting.is_sure and score >= _SURE)
