"""How sure it is that a group of points is a road user."""

import math
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.checks import require_ranges
from fbench.pipelines.fusion.lift import AT_MIN_SCORE
from fbench.replay.arrays import Bool, Float64

_LEAST = math.log(AT_MIN_SCORE / (1 - AT_MIN_SCORE))


@dataclass(frozen=True)
class ExistenceParams:
    """What speaks for a group of points, as logarithms of odds that add up: score = 1 / (1 + exp(-sum)).

    The shape of LiDAR points has odds of its own, by the LiDAR's model.
    """

    camera: float = 1.3
    """Of a box that has its detector's least score, and whose projected 3D box covers half of it."""
    camera_score: float = 1.4
    """Times how far the logarithm of the odds of the box's score is above that of the least score."""
    overlap: float = 0.8
    """Times how far the IoU of the projected 3D box with the camera's is above 0.5."""
    camera_shape: float = 1.1
    """Times the logarithm of the odds by shape, where a camera's box holds the group."""
    camera_shapeless: float = -1.6
    """Of a group in a camera's box with too few points to have a shape."""
    camera_points: float = 0.2
    """Times the logarithm of the number of points and moving echoes, where a camera's box holds the group."""
    alone: float = 0.3
    """Of a group that no camera's box holds, beside what its shape says."""
    shapeless: float = -2.3
    """Of such a group with too few points to have a shape, instead of that."""
    unconfirmed: float = -1.2
    """Of such a group where LiDAR or stereo deliver, and ought to have seen more."""
    unseen: float = -1.8
    """Of a group that a working camera looks at from near and doesn't report."""
    unseen_px: float = 80.0
    """Where a car looks n pixels high, 1 - exp(-n / this) of that counts."""
    moving: float = 0.8
    """Times the logarithm of the number of moving echoes, where no camera's box holds the group."""
    most_odds: float = 4.0
    """Largest logarithm of odds, and the negative of the smallest, that a shape can have."""

    def __post_init__(self) -> None:
        names = (
            "camera", "camera_score", "overlap", "camera_shape", "camera_shapeless", "camera_points", "alone",
            "shapeless", "unconfirmed", "unseen", "moving",
        )  # fmt: skip
        require_ranges("fusion.existence", self, {"most_odds": (0.0, 30.0), "unseen_px": (0.1, 1e5)})
        require_ranges("fusion.existence", self, dict.fromkeys(names, (-1000.0, 1000.0)))


@dataclass(frozen=True, eq=False)
class Witnesses:
    """What speaks for groups (M,)."""

    camera_score: Float64
    """Of the camera's box, NaN without."""
    is_sure: Bool
    """Whether the camera alone would report it."""
    overlap: Float64
    """IoU of the projected 3D box with the camera's, NaN without."""
    height_px: Float64
    """How high a car there looks in a working camera [px], 0 out of view."""
    by_shape: Float64
    """Probability of a road user by the shape of LiDAR and stereo points, NaN where they are too few."""
    dense: Float64
    """Points of LiDAR and stereo."""
    moving: Float64
    """Moving echoes."""
    has_dense: bool
    """Whether LiDAR or stereo delivered anything in this frame."""


def existence(seen: Witnesses, params: ExistenceParams) -> Float64:
    """Probability (M,) that groups are road users."""
    by_shape, has_shape = _odds(seen.by_shape, params.most_odds), np.isfinite(seen.by_shape)
    with_camera = (
        params.camera
        + params.camera_score * (_odds(seen.camera_score, params.most_odds) - _LEAST)
        + params.overlap * (seen.overlap - 0.5)
        + np.where(has_shape, params.camera_shape * by_shape, params.camera_shapeless)
        + params.camera_points * np.log1p(seen.dense + seen.moving)
    )
    alone = (
        np.where(has_shape, params.alone + by_shape, params.shapeless + params.unconfirmed * seen.has_dense)
        + params.unseen * (1 - np.exp(-seen.height_px / params.unseen_px))
        + params.moving * np.log1p(seen.moving)
    )
    confirmed = np.where(seen.is_sure, with_camera, np.where(has_shape, np.fmax(with_camera, alone), alone))
    total = np.where(np.isfinite(seen.camera_score), confirmed, alone)
    return np.asarray(1 / (1 + np.exp(-np.clip(total, -30.0, 30.0))), np.float64)


def _odds(probability: Float64, most: float) -> Float64:
    """Logarithm of odds (M,), NaN where the probability is."""
    safe = np.clip(probability, 1e-9, 1 - 1e-9)
    return np.asarray(np.clip(np.log(safe / (1 - safe)), -most, most), np.float64)
