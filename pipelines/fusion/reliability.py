"""Reliability of sensors: how well each sees at present, and how sure that makes fusion of an object."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.params import require_ranges
from fbench.pipelines.sensors.image.objects import Points
from fbench.pipelines.sensors.image.observations import Sightings
from fbench.pipelines.sensors.image.stage import nearest_dense
from fbench.pipelines.sensors.radar.radar import median_rate
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.boxes import Boxes2D, Source

_GATE = 2.5
_LEAST = 3
_FULL = 10.0
_AROUND_M = 2.5
"""Points that differ by less [m] from the depth of an object belong to it."""


@dataclass(frozen=True)
class Evidence:
    """What the points of one kind of sensor say of a box."""

    depth_m: float
    """Depth of the object they are on [m]."""
    strength: float
    """How much there is of it, 0 to 1."""
    rate_mps: float
    """Change of its distance [m/s], positive when receding; NaN where unknown."""


def evidence(seen: Sightings, at: int, points: Points) -> Evidence | None:
    """Find the nearest dense depth of the points in box `at`, near what the camera guesses; `None` without any."""
    inside = _inside(points, seen.xyxy_px[at])
    guess, std = seen.depth_m[at], seen.depth_std[at]
    if np.isfinite(guess):
        inside &= np.abs(np.log(np.maximum(points.depth_m, 0.1) / guess)) < _GATE * std
    depth = nearest_dense(np.sort(points.depth_m[inside]), _LEAST)
    if np.isnan(depth):
        return None
    on_it = inside & (np.abs(points.depth_m - depth) < _AROUND_M)
    num = int(np.count_nonzero(on_it))
    return Evidence(depth, float(1 - np.exp(-num / _FULL)), _rate(points, on_it))


def rate_at(points: Points, xyxy_px: Float64, depth_m: float) -> float:
    """Change of the distance [m/s] of what is in a box (4,) at a depth, by its echoes; NaN without any."""
    return _rate(points, _inside(points, xyxy_px) & (np.abs(points.depth_m - depth_m) < _AROUND_M))


def _inside(points: Points, xyxy_px: Float64) -> Bool:
    left, top, right, bottom = xyxy_px
    u, v = points.uv_px.T
    inside: Bool = (u > left) & (u < right) & (v > top) & (v < bottom)
    return inside


def _rate(points: Points, rows: Bool) -> float:
    own = points.cloud.own_mps[rows]
    if not np.isfinite(own).any():
        return float("nan")
    rate = median_rate(points.cloud.over_ground_mps[rows], points.cloud.period_mps[rows])
    return rate - float(np.nanmedian(own))


_BEFORE, _SEEN_BEFORE = 20.0, 18.0
"""Before anything was seen, cameras are taken to have seen 9 of 10 objects."""
_KEPT = 0.97
"""Share of what was seen that still counts one frame later."""
_BOTH = int(Source.L) | int(Source.R)


class CameraTrust:
    """Share of the objects that both LiDAR and radar see which cameras see too, over some twenty frames."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin a segment."""
        self._num, self._num_seen = _BEFORE, _SEEN_BEFORE

    @property
    def share(self) -> float:
        """0 to 1."""
        return self._num_seen / self._num

    def learn(self, objects: Boxes2D) -> None:
        """Take the objects of a frame that are reported in images of cameras that worked."""
        sources = np.zeros(0, np.uint8) if objects.sources is None else objects.sources
        score = np.zeros(len(objects)) if objects.score is None else objects.score
        sure = np.where((sources & _BOTH) == _BOTH, np.clip(2 * score - 1, 0.0, 1.0), 0.0)
        self._num = _KEPT * self._num + float(sure.sum())
        self._num_seen = _KEPT * self._num_seen + float(sure[(sources & int(Source.C)) > 0].sum())
        if self._num < 1.0:  # long without anything to learn from: as in the beginning
            self.reset()


@dataclass(frozen=True)
class ImageFusionParams:
    """How boxes of several sensors in one image become one, and how sure that makes us.

    Each sensor that sees an object says with which probability it is one; probabilities are joined as those of
    independent witnesses. Sensors that could see it and don't have a factor on its odds.
    """

    camera_share: float = 0.25
    """Of cameras, boxes down to this share of their `min_score` are used where LiDAR or radar confirm them [0 to 1]."""
    min_similarity: float = 0.25
    """Least overlap times agreement in depth of two boxes that show one object [0 to 1]."""
    prior: float = 0.3
    """How likely an object is before any sensor looks [0 to 1]; the lower, the more it means that two agree."""
    lidar_weight: float = 0.75
    """Probability of what looks fully like a vehicle to LiDAR, as it alone tells [0 to 1]."""
    radar_weight: float = 0.7
    """The same for radar."""
    points_factor: float = 1.6
    """Factor on the odds of an object where many points lie in the camera's box, at about its distance, that are no
    object themselves; nearer to 1 for few."""
    measured_share: float = 0.2
    """By so much the outline of a camera that is sure is drawn towards that of the points [0 to 1]."""
    weak_measured_share: float = 1.0
    """The same where the camera is least sure; in proportion between."""
    unseen_by_camera: float = 0.1
    """Factor on the odds of an object that a working camera ought to see and doesn't, where cameras see everything
    that LiDAR and radar see; nearer to 1 the less they saw of that lately, as by night."""
    camera_size_px: float = 40.0
    """Of objects whose box has an area of n x n pixels a camera that sees well sees the share 1 - exp(-n / this)."""
    unseen_by_rays: float = 0.25
    """The same for LiDAR and radar, where their rays go on behind the object."""
    through: float = 0.6
    """Share of the rays through the middle of a box that go on behind the object, from which on it counts as unseen."""
    min_score: float = 0.5
    """Objects that are less likely are dropped."""

    def __post_init__(self) -> None:
        names = (
            "camera_share", "min_similarity", "prior", "lidar_weight", "radar_weight", "measured_share",
            "weak_measured_share", "unseen_by_camera", "unseen_by_rays", "through", "min_score",
        )  # fmt: skip
        others = {"points_factor": (1.0, 1000.0), "camera_size_px": (0.1, 1e5)}
        require_ranges("fusion", self, dict.fromkeys(names, (0.0, 1.0)) | others)
