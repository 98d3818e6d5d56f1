"""Classification of LiDAR clusters: boxes with scores, by the fitted model or by rules for passenger cars."""

import json
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from fbench.pipelines.sensors.odds import log_odds, probability_of
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.points.vehicle import OtherSizes, VehicleSize, center_offsets, complete, fade
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import CheckedParams, in_range, require_between
from fbench.replay.data.arrays import Bool, Float64, Int64, Text
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.kernels import kernel
from fbench.replay.geometry.transforms import wrap_angle


@kernel
def points_inside(rectangles: Float64, points: Float64, begin: Int64, end: Int64) -> Float64:
    """Number of points (N, 3) in each rectangle (M, 5), and the highest third coordinate of them: (M, 2).

    Rectangles hold heading [rad], low along and across it, high along and across; borders don't belong to them. Of
    rectangle m only points `begin[m]` to `end[m]` (M,) are looked at. Without points the highest is -inf.
    """
    result = np.zeros((len(rectangles), 2))
    for m in range(len(rectangles)):
        c, s = np.cos(rectangles[m, 0]), np.sin(rectangles[m, 0])
        result[m, 1] = -np.inf
        for i in range(begin[m], end[m]):
            u, v = c * points[i, 0] + s * points[i, 1], c * points[i, 1] - s * points[i, 0]
            if rectangles[m, 1] < u < rectangles[m, 3] and rectangles[m, 2] < v < rectangles[m, 4]:
                result[m, 0] += 1.0
                result[m, 1] = max(result[m, 1], points[i, 2])
    return result


def measure_inside(points: Float64, rectangles: Float64, margin_m: float) -> Float64:
    """Count the points in each rectangle (M, 5 or more), as `fit_rectangles` gives them, widened by a margin [m], and
    find the highest third coordinate of them, -inf where there are none: (M, 2).

    Points (N, 3) hold x and y [m], and what is asked for about them, such as heights. They are sorted by x, so that
    only those between the least and greatest x of a rectangle are looked at.
    """
    points = np.ascontiguousarray(points[np.argsort(points[:, 0], kind="stable")])
    wide = np.column_stack([rectangles[:, 0], rectangles[:, [1, 3]] - margin_m, rectangles[:, [2, 4]] + margin_m])
    cos, sin = np.cos(wide[:, :1]), np.sin(wide[:, :1])
    x = cos * wide[:, [1, 1, 3, 3]] - sin * wide[:, [2, 4, 2, 4]]
    # A hair more than needed, so that rounding leaves no point out.
    begin = np.searchsorted(points[:, 0], x.min(axis=1) - 1e-6)
    end = np.searchsorted(points[:, 0], x.max(axis=1) + 1e-6)
    return points_inside(wide, points, begin, end)


FEATURES = (
    "length_m", "width_m", "top_m", "reach_m", "bottom_m", "log2_points", "filling_m", "upper_share", "over_share",
    "near_share",
)  # fmt: skip
"""Names of the columns of `features`:

- length_m, width_m: longer and shorter edge of the rectangle around the cluster [m]
- top_m: height above ground of the highest point in the cluster or over its rectangle [m]
- reach_m: top_m plus the widest gap [m] between heights of the cluster's points, from the ground up: between sparse
  beams it may be higher than it was seen to be
- bottom_m: height of its lowest point [m]
- log2_points: logarithm of the number of points to base 2
- filling_m: mean distance of the points from the nearest edge of the rectangle [m]: vegetation fills it
- upper_share: share of the points above the middle between the lowest and the highest
- over_share: of the cluster's points and those over its rectangle, the share of the latter: poles and trees go on
- near_share: of all points on and beside its rectangle, the share of others: parts of something larger have neighbors
"""
_OVER_MARGIN_M = 0.3
_NEAR_MARGIN_M = 0.6


@dataclass(frozen=True, eq=False)
class Standing:
    """What stands on the ground."""

    xy_height: Float64
    """(N, 3) x and y in body coordinates and height above ground [m], sorted by cluster, those of none first."""
    first: Int64  # (M + 1,) rows where the clusters begin, and the end
    tall: Float64  # (K, 3) the same of points above the height up to which they are clustered

    @cached_property
    def low_high_m(self) -> tuple[Float64, Float64]:
        """Heights (M,) of the lowest and of the highest point of each cluster [m]."""
        height, begin = self.xy_height[self.first[0] :, 2], self.first[:-1] - self.first[0]
        return np.minimum.reduceat(height, begin), np.maximum.reduceat(height, begin)


def features(standing: Standing, rectangles: Float64) -> Float64:
    """Describe clusters by `FEATURES` (M, F); `rectangles` (M, 6) are those of `fit_rectangles`."""
    first = standing.first
    num = np.diff(first).astype(np.float64)
    height = standing.xy_height[first[0] :, 2]
    begin = first[:-1] - first[0]
    bottom, top = standing.low_high_m
    upper = np.add.reduceat((height > np.repeat((bottom + top) / 2, np.diff(first))).astype(np.float64), begin)
    extent = np.sort(rectangles[:, [2, 4]] - rectangles[:, [1, 3]], axis=1)
    over = measure_inside(standing.tall, rectangles, _OVER_MARGIN_M)
    near = measure_inside(standing.xy_height, rectangles, _NEAR_MARGIN_M)[:, 0]
    highest = np.maximum(top, over[:, 1])
    # Gaps between neighboring ones of 0 and the heights of each cluster.
    ordered = height[np.lexsort((height, np.repeat(np.arange(len(num)), np.diff(first))))]
    gap = np.diff(ordered, prepend=0.0)
    gap[begin] = ordered[begin]
    columns = (
        extent[:, 1], extent[:, 0], highest, highest + np.maximum.reduceat(gap, begin), bottom, np.log2(num),
        rectangles[:, 5], upper / num, over[:, 0] / (over[:, 0] + num), 1.0 - num / np.maximum(near, num),
    )  # fmt: skip
    return np.column_stack(columns)


FITTED = Path(__file__).with_name("road_users.json")
"""Made by `benchmarks/fit_road_users.py`, which says how and from what."""


@dataclass(frozen=True, eq=False)
class RoadUserModel:
    """Log-odds of each class against everything else, the sum of one piecewise linear function of each feature.

    These functions vary with how high the LiDAR looks (Hastie, Tibshirani, "Varying-coefficient models", Journal of the
    Royal Statistical Society B, 1993): one that can't see the tops of walls and trees tells them otherwise.
    """

    labels: Text  # (C,) classes
    knots: tuple[Float64, ...]
    """For each feature of `FEATURES` the values (K,) between which its function is linear; beyond them it is level."""
    ceiling_m: Float64  # (L,) ceilings between which the functions are interpolated; beyond them the outermost counts
    log_odds: tuple[Float64, ...]  # For each feature what it adds at each ceiling for each class at its knots (L, C, K)
    offset: Float64  # (C,) what is added to the sum

    def probabilities(self, features: Float64, ceiling_m: Float64) -> Float64:
        """Probabilities (M, C) that clusters with features (M, F), which the LiDAR sees up to the height `ceiling_m`
        (M,), are one road user each of these classes. What is missing to 1 is that of being anything else.
        """
        shape = len(features), len(self.ceiling_m), len(self.labels)
        by_ceiling = np.zeros((shape[0], shape[1] * shape[2]))
        for column, knots, values in zip(features.T, self.knots, self.log_odds, strict=True):
            by_ceiling += interpolation_weights(column, knots) @ values.reshape(-1, len(knots)).T
        share = interpolation_weights(ceiling_m, self.ceiling_m)[:, :, None]
        total = self.offset + (by_ceiling.reshape(shape) * share).sum(axis=1)
        least = np.maximum(total.max(axis=1, initial=0.0, keepdims=True), 0.0)
        odds = np.exp(total - least)
        return np.asarray(odds / (odds.sum(axis=1, keepdims=True) + np.exp(-least)), np.float64)


def interpolation_weights(values: Float64, knots: Float64) -> Float64:
    """Weights (N, K) with which values (N,) lie between ascending knots (K,); beyond them the outermost counts."""
    at = np.clip(values, knots[0], knots[-1])
    right = np.clip(np.searchsorted(knots, at, side="right"), 1, len(knots) - 1)
    share = (at - knots[right - 1]) / (knots[right] - knots[right - 1])
    weights = np.zeros((len(values), len(knots)))
    rows = np.arange(len(values))
    weights[rows, right - 1] = 1.0 - share
    weights[rows, right] = share
    return weights


@cache
def load_model() -> RoadUserModel:
    """Return the model that fbench ships."""
    content = json.loads(FITTED.read_text(encoding="utf-8"))
    by_feature = content["features"]
    return RoadUserModel(
        np.array(content["labels"], np.str_),
        tuple(np.array(by_feature[name]["knots"], np.float64) for name in FEATURES),
        np.array(content["ceiling_m"], np.float64),
        tuple(np.array(by_feature[name]["log_odds"], np.float64) for name in FEATURES),
        np.array(content["offset"], np.float64),
    )


_RISING = ("bottom_m", "top_m", "most_length_m", "most_width_m", "filling_m", "num_over")
_FALLING = ("least_extent_m", "num_points")
_LEAST_STEP = 1e-6


@dataclass(frozen=True)
class CarShapeParams(CheckedParams, prefix="lidar.shape"):
    """What a cluster must be like; in each pair, values from the first on are fine, from the second on impossible."""

    bottom_m: tuple[float, float] = (0.75, 1.1)
    """Height of the lowest point [m]: cars stand on the ground, but LiDARs look between rings."""
    top_m: tuple[float, float] = (2.1, 2.5)  # Height of the highest point [m].
    least_extent_m: tuple[float, float] = (1.3, 0.8)  # Longer edge [m] where only a part is seen.
    most_length_m: tuple[float, float] = (5.2, 6.5)  # Longer edge [m].
    most_width_m: tuple[float, float] = (2.0, 2.5)  # Shorter edge [m].
    filling_m: tuple[float, float] = (0.12, 0.25)
    """Mean distance of the points from the nearest edge [m]: vegetation fills its rectangle."""
    num_points: tuple[float, float] = (10.0, 4.0)  # Number of points: a handful is too few to tell.
    num_over: tuple[float, float] = (0.0, 4.0)
    """Number of points above the height of cars: poles, walls and trees go on."""
    margin_m: float = in_range(0.3, 0, 100)  # How far beside the rectangle points count as above it [m].

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in (*_RISING, *_FALLING):
            for value in getattr(self, name):
                require_between(f"{self._prefix}{name}", value, 0)
        for name, sign, word in (*((n, 1, "above") for n in _RISING), *((n, -1, "below") for n in _FALLING)):
            fine, impossible = getattr(self, name)
            if not sign * (impossible - fine) >= _LEAST_STEP:
                raise ConfigError(
                    f"{self._prefix}{name}: expected a second value {word} the first, got {fine:g},{impossible:g}"
                )


def plausibility(
    rectangles: Float64, num_points: Int64, bottom_m: Float64, top_m: Float64, tall: Float64, params: CarShapeParams
) -> Float64:
    """Score clusters in [0, 1], as the product of all that is known about cars.

    Takes rectangles (M, 6) as `fit_rectangles` gives them, counts and heights (M,) of the points in them, and the
    points `tall` (N, 3) [m] above the height of cars.
    """
    extent = np.sort(rectangles[:, [2, 4]] - rectangles[:, [1, 3]], axis=1)
    score: Float64 = fade(bottom_m, *params.bottom_m) * fade(top_m, *params.top_m)
    score *= fade(extent[:, 1], *params.least_extent_m) * fade(extent[:, 1], *params.most_length_m)
    score *= fade(extent[:, 0], *params.most_width_m)
    score *= fade(rectangles[:, 5], *params.filling_m) * fade(num_points, *params.num_points)
    likely = np.flatnonzero(score > 0)
    score[likely] *= fade(measure_inside(tall, rectangles[likely], params.margin_m)[:, 0], *params.num_over)
    return score


_TOP = FEATURES.index("top_m")
_SECTORS, _LEAST_SECTORS = 120, 10  # Of 3 degrees, and in how many of them the highest beam must be seen to end
_USUAL_SLOPE = float(np.tan(np.radians(15.0)))
_SAME_SLOPE = 0.02  # By so much [m/m] a tilt of the LiDAR, or of the road, moves it
_TELLING_POINTS = 30  # Clusters with fewer fill too small an angle
_HIGHEST_M = 4.5  # No road user is higher [m]: what is seen above that is a tree or a bridge


@dataclass(frozen=True, eq=False)
class Seen:
    """Clusters of one frame, M of them."""

    standing: Standing  # Their points, and those beside and above them
    rectangles: Float64  # (M, 6) as `fit_rectangles` gives them
    plane: Plane  # The ground
    viewpoint: Float64  # (3,) where the LiDAR is [m]

    @property
    def ceiling_m(self) -> Float64:
        """Height above ground (M,) up to which the LiDAR looks at each cluster [m]: the tops of what reaches higher are
        out of its sight. Unless its highest beam shows, at one angle in many directions as no thing does, it looks up
        as spinning LiDARs do.
        """
        eye_m = float(self.viewpoint[2] - self.plane.z_m(self.viewpoint[None])[0])
        points = np.concatenate([self.standing.xy_height, self.standing.tall])
        x, y = (points[:, :2] - self.viewpoint[:2]).T
        slope = (points[:, 2] - eye_m) / np.maximum(np.hypot(x, y), 1.0)
        in_sector = np.full(_SECTORS, -np.inf)
        np.maximum.at(
            in_sector, np.floor((np.arctan2(y, x) / (2 * np.pi) + 0.5) * _SECTORS).astype(int) % _SECTORS, slope
        )
        steepest = float(in_sector.max())
        if steepest <= 0 or np.count_nonzero(in_sector > steepest - _SAME_SLOPE) < _LEAST_SECTORS:
            steepest = max(steepest, _USUAL_SLOPE)
        cos, sin = np.cos(self.rectangles[:, 0]), np.sin(self.rectangles[:, 0])
        along, across = (self.rectangles[:, [1, 2]] + self.rectangles[:, [3, 4]]).T / 2
        x, y = cos * along - sin * across - self.viewpoint[0], sin * along + cos * across - self.viewpoint[1]
        return np.asarray(eye_m + steepest * np.hypot(x, y), np.float64)

    @property
    def density_per_deg2(self) -> float:
        """How many points the LiDAR has in a square degree [1/deg²]: the median of its clusters, each by the angles
        that it fills; 0 where they are too small to tell.
        """
        first, num = self.standing.first, np.diff(self.standing.first)
        points, begin = self.standing.xy_height[first[0] :], first[:-1] - first[0]
        eye_m = float(self.viewpoint[2] - self.plane.z_m(self.viewpoint[None])[0])
        x, y = (points[:, :2] - self.viewpoint[:2]).T
        bearing, elevation = np.arctan2(y, x), np.arctan2(points[:, 2] - eye_m, np.hypot(x, y))
        aside = wrap_angle(bearing - np.repeat(bearing[begin], num))
        wide, high = (
            np.degrees(np.maximum.reduceat(v, begin) - np.minimum.reduceat(v, begin)) for v in (aside, elevation)
        )
        is_telling = (num >= _TELLING_POINTS) & (wide * high > 0)
        return float(np.median((num / np.maximum(wide * high, 1e-9))[is_telling])) if is_telling.any() else 0.0


def classify(seen: Seen, judge: str | None, car: VehicleSize, others: OtherSizes, shape: CarShapeParams) -> Boxes3D:
    """Complete clusters to road users by the model, by itself or by both, or to cars by rules: also where `judge` says
    nothing.
    """
    if judge in ("model", "both"):
        return road_users(seen, car, others, shape if judge == "both" else None)
    return classify_cars(seen, car, shape)


def classify_cars(seen: Seen, size: VehicleSize, shape: CarShapeParams) -> Boxes3D:
    """Complete clusters to cars; the score says how much they look like one, in [0, 1]."""
    score, top = _by_rules(seen, shape)
    return _complete(seen, np.zeros(len(top), np.int64), (size,), top, score)


def _by_rules(seen: Seen, shape: CarShapeParams) -> tuple[Float64, Float64]:
    """How much clusters (M,) look like a car, in [0, 1], and how high they reach [m]."""
    bottom, top = seen.standing.low_high_m
    num = np.diff(seen.standing.first)
    return plausibility(seen.rectangles, num, bottom, top, seen.standing.tall, shape), top


_RULES_SAY = 0.1
"""Rules make a car at most as sure as 1 less this, and at least this likely: they hold for a sparse LiDAR, and know
neither roofs that a high and dense one sees nor anything but cars."""
_RULES_SHARE = 0.5
_SPARSE_PER_DEG2, _DENSE_PER_DEG2 = 4.0, 7.0
"""LiDARs of 16 and 32 beams have 1 to 6 points in a square degree, those of 64 and more have 7 to 15."""
_VEHICLES = ("car", "van", "truck")


def add_rules(probability: Float64, is_vehicle: Bool, score: Float64, share: float | Float64 = _RULES_SHARE) -> Float64:
    """Probabilities (M, C) of classes, where rules say by a score (M,) how much clusters look like a car.

    The odds of being a vehicle become the geometric mean of those by the model and by rules, which weigh `share`
    (logarithmic opinion pool, Genest and Zidek, "Combining probability distributions", Statistical Science 1986); those
    of others stay.
    """
    known = probability[:, is_vehicle].sum(axis=1)
    pooled = probability_of((1 - share) * log_odds(known, 1e-9) + share * log_odds(score, _RULES_SAY))
    scale = np.where(is_vehicle, (pooled / np.maximum(known, 1e-9))[:, None], 1.0)
    result = probability * scale
    return np.asarray(result / np.maximum(result.sum(axis=1, keepdims=True), 1.0), np.float64)


def road_users(seen: Seen, car: VehicleSize, others: OtherSizes, shape: CarShapeParams | None = None) -> Boxes3D:
    """Complete clusters to road users of the likeliest class; the score is the probability of any class. With the
    `shape` of cars rules have a say, too.
    """
    model = load_model()
    found = features(seen.standing, seen.rectangles)
    probability = model.probabilities(found, seen.ceiling_m)
    if shape is not None:
        share = _RULES_SHARE * fade(np.array(seen.density_per_deg2), _SPARSE_PER_DEG2, _DENSE_PER_DEG2)
        probability = add_rules(probability, np.isin(model.labels, _VEHICLES), _by_rules(seen, shape)[0], share)
    kind = np.argmax(probability, axis=1)
    sizes = tuple({"car": car, **vars(others)}[label] for label in model.labels.tolist())
    boxes = _complete(seen, kind, sizes, np.minimum(found[:, _TOP], _HIGHEST_M), probability.sum(axis=1))
    # Scores count times the probability that none of the likelier boxes around their middles is there: where two parts
    # of one vehicle are two clusters, both are completed to all of it. Of equal scores the first counts.
    score = np.zeros(0) if boxes.score is None else boxes.score
    along, across = center_offsets(boxes)
    inside = (boxes.size_lwh_m[:, 0] / 2 > along.T) & (boxes.size_lwh_m[:, 1] / 2 > across.T)
    order = np.arange(len(score))
    likelier = (score > score[:, None]) | ((score == score[:, None]) & (order < order[:, None]))
    score = score * np.prod(np.where(inside & likelier, 1.0 - score, 1.0), axis=1)
    return Boxes3D(boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad, label=model.labels[kind], score=score)


def _complete(seen: Seen, kind: Int64, sizes: tuple[VehicleSize, ...], top_m: Float64, score: Float64) -> Boxes3D:
    num = len(kind)
    center, size, yaw = np.zeros((num, 3)), np.zeros((num, 3)), np.zeros(num)
    for number, typical in enumerate(sizes):
        rows = kind == number
        footprint = complete(seen.rectangles[rows], seen.viewpoint, typical)
        height = np.maximum(top_m[rows], typical.height_m)
        z = seen.plane.z_m(footprint.center_m) + height / 2
        center[rows] = np.column_stack([footprint.center_m, z])
        size[rows] = np.column_stack([footprint.size_lw_m, height])
        yaw[rows] = footprint.yaw_rad
    return Boxes3D(center, size, yaw, score=np.clip(score, 0.0, 1.0))
