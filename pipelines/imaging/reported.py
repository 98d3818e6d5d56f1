"""Boxes in images that a pipeline without classes reports."""

from collections.abc import Mapping

import numpy as np

from fbench.pipelines.imaging.sightings import Sightings
from fbench.replay.boxes import Boxes2D, concatenate


def unlabelled(seen: Mapping[str, Sightings], min_score: float) -> Boxes2D:
    """Boxes by camera with at least `min_score`, of each the highest first; the same fields in every frame."""
    parts = [_boxes(name, one.rows(one.score >= min_score)) for name, one in sorted(seen.items())]
    return concatenate([*parts, _boxes("", Sightings.none())])


def _boxes(camera: str, seen: Sightings) -> Boxes2D:
    return Boxes2D(
        camera=np.full(len(seen), camera),
        xyxy_px=seen.xyxy_px,
        score=seen.score,
        distance_m=seen.distance_m,
        range_rate_mps=seen.rate_mps,
        sources=seen.source,
    )
