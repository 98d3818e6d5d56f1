"""Fusion in images: observations of several kinds of sensors of one object become one box."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.observations import inside_shares
from fbench.pipelines.fusion.reliability import CameraReliability, saturate
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.image.stage import SURE, ImageObservations, InImages, Rays, by_camera
from fbench.pipelines.sensors.odds import combine_factors, log_odds
from fbench.pipelines.sensors.rows import suppress
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Source, concatenate
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import rays
from fbench.replay.geometry.iou import iou_2d
from fbench.replay.geometry.transforms import transform

_CONTAINED = 0.7
"""What lies inside another box counts as similar by this share of itself: of what is hidden only a part is measured."""
_MISTAKEN = 0.35
"""Depths that a camera guesses agree at least so far with others: the class that gives the size may be wrong."""
_PART, _AGREE = 0.6, 0.2  # What lies by this share in an object's box, and agrees so far in depth, is a part of it
_SAME = 0.5  # Of two objects with a larger IoU the farther one would be hidden
_HALF_LENGTH_M = 2.0  # From the near side of an object to its middle [m], where only that is known


@dataclass(frozen=True)
class ImageFusionParams(CheckedParams, prefix="fusion"):
    """How boxes of several sensors in one image become one, and how sure that makes us.

    Each sensor that sees an object says with which probability it is one; probabilities are joined as those of
    independent witnesses. Sensors that could see it and don't have a factor on its odds.
    """

    camera_share: float = in_range(0.25, 0, 1)
    """Of cameras, boxes down to this share of their `min_score` are used where LiDAR or radar confirm them [0 to 1]."""
    min_similarity: float = in_range(0.25, 0, 1)
    """Least overlap times agreement in depth of two boxes that show one object [0 to 1]."""
    prior: float = in_range(0.3, 0, 1)
    """How likely an object is before any sensor looks [0 to 1]; the lower, the more it means that two agree."""
    lidar_weight: float = in_range(0.75, 0, 1)
    """Probability of what looks fully like a vehicle to LiDAR, by itself [0 to 1]."""
    radar_weight: float = in_range(0.7, 0, 1)  # The same for radar.
    stereo_weight: float = in_range(0.7, 0, 1)
    """The same for a stereo pair, where its error of depth is small: the evidence falls as that grows."""
    measured_share: float = in_range(0.1, 0, 1)
    """By so much the outline of a camera that is sure is drawn toward that of the points [0 to 1]."""
    weak_measured_share: float = in_range(1.0, 0, 1)  # The same where the camera is least sure; in proportion between.
    unseen_by_camera: float = in_range(0.1, 0, 1)
    """Factor on the odds of an object that a working camera ought to see and doesn't, where cameras see everything
    that LiDAR and radar see; nearer to 1 the less they saw of that lately, as by night."""
    camera_size_px: float = in_range(40.0, 0.1, 1e5)
    """Of objects whose box has an area of n x n pixels a camera that sees well sees the share 1 - exp(-n / this)."""
    unseen_by_rays: float = in_range(0.25, 0, 1)
    """The same for LiDAR, where its rays go on behind the object. Radar says nothing by that: its echoes are too poor
    in angle, and come from under and over a vehicle, too."""
    through: float = in_range(0.6, 0, 1)
    """Share of the rays through the middle of a box that go on behind the object, from which on it counts as unseen."""
    min_score: float = in_range(0.5, 0, 1)  # Objects that are less likely are dropped.


@dataclass(frozen=True, eq=False)
class ImageView:
    """Observations of all sensors in one image."""

    rig: Rig
    camera: str
    seen: ImageObservations
    works: bool  # Whether the camera itself worked
    rays: Rays | None = None  # All points of LiDARs, where they delivered


@dataclass(frozen=True, eq=False)
class ImageObject:
    """One object in one image."""

    xyxy_px: Float64
    label: str
    score: float
    distance_m: float
    rate_mps: float
    sources: int


class ImageFusion:
    """Merges what the sensors see in each image, and learns from it how well the cameras see."""

    def __init__(self, rig: Rig, cameras: Sequence[str], params: ImageFusionParams) -> None:
        self._rig, self._cameras, self._params, self._reliability = rig, cameras, params, CameraReliability()

    def reset(self) -> None:
        """Forget how well the cameras see."""
        self._reliability.reset()

    def merge(self, working: Mapping[str, CameraDetections], lidar: InImages, *others: InImages) -> Boxes2D:
        """Merge one frame; `working` holds the cameras that worked, `others` what radars and stereo see. Any number of
        boxes has the same fields.
        """
        params, share = self._params, self._reliability.share
        views = [self._view(name, working.get(name), lidar, others) for name in self._cameras]
        every = concatenate([fuse(view, params, share) for view in views])
        found = every if every.score is None else every[every.score >= params.min_score]
        self._reliability.learn(found[np.isin(found.camera, sorted(working))])
        return found

    def _view(
        self, camera: str, found: CameraDetections | None, lidar: InImages, others: Sequence[InImages]
    ) -> ImageView:
        parts = [view.seen[camera] for view in (lidar, *others) if camera in view.seen]
        if found is not None:
            parts.append(by_camera(found, self._rig.cameras[camera]))
        return ImageView(
            rig=self._rig,
            camera=camera,
            seen=ImageObservations.join(parts),
            works=found is not None,
            rays=lidar.rays.get(camera),
        )


def fuse(view: ImageView, params: ImageFusionParams, camera_share: float = 0.9) -> Boxes2D:
    """Merge what was seen into labeled boxes by falling score, with the sensors that contributed.

    An object has its outline and class from the camera, its distance from LiDAR, else radar, else stereo, and its range
    rate from radar, as far as they see it. Parts of an object that a camera sees whole are left out. `camera_share`:
    share of objects that the camera sees at present. All objects are there, whatever their score.
    """
    seen = view.seen
    groups = [rows for rows in associate(seen, params.min_similarity) if len(rows) > 1 or not seen.weak[rows[0]]]
    groups = _drop_parts(seen, groups)
    share = camera_share if view.works else 0.0
    objects = sorted(
        (_object(view, rows, share, params) for rows in groups), key=lambda o: (-o.score, *o.xyxy_px.tolist())
    )
    # Of objects in the place of a surer one sensors disagreed on how far away it is.
    boxes = np.array([o.xyxy_px for o in objects], np.float64).reshape(-1, 4)
    objects = [objects[at] for at in suppress(iou_2d(boxes, boxes) > _SAME)]
    return Boxes2D(
        camera=np.full(len(objects), view.camera),
        xyxy_px=np.array([o.xyxy_px for o in objects], np.float64).reshape(-1, 4),
        label=np.array([o.label for o in objects], np.str_),
        score=np.array([o.score for o in objects], np.float64),
        distance_m=np.array([o.distance_m for o in objects], np.float64),
        range_rate_mps=np.array([o.rate_mps for o in objects], np.float64),
        sources=np.array([o.sources for o in objects], np.uint8),
    )


def associate(seen: ImageObservations, min_similarity: float) -> list[Int64]:
    """Group boxes (N) that show one object; each group has at most one box of each kind of sensor.

    The best pair is joined first, whichever sensors it is of: the most similar one of the surest boxes. A camera's weak
    boxes take what all others leave. Returns rows of each group, in ascending order.
    """
    alike = similarity(seen)
    score = seen.score * seen.exactness
    sure = np.sqrt(score[:, None] * score[None, :])
    first, second = np.nonzero(np.triu(alike >= min_similarity, 1) & (seen.source[:, None] != seen.source[None, :]))
    group = np.arange(len(seen))
    kinds = seen.source.astype(np.int64)
    weak = (seen.weak[:, None] | seen.weak[None, :])[first, second]
    for at in np.lexsort((-(alike * sure)[first, second], weak)):
        a, b = group[first[at]], group[second[at]]
        if a != b and not kinds[a] & kinds[b]:
            low, high = min(a, b), max(a, b)
            kinds[low] |= kinds[high]
            group[group == high] = low
    return [np.flatnonzero(group == number) for number in np.unique(group)]


def similarity(seen: ImageObservations) -> Float64:
    """Similarity of boxes (N, N), 0 to 1: their overlap in the image times how well their depths agree."""
    flat = seen.xyxy_px.copy()
    flat[:, 1], flat[:, 3] = 0.0, 1.0  # compares left and right only
    upright = seen.upright[:, None] & seen.upright[None, :]
    guessed = seen.source == int(Source.C)
    depths = np.maximum(_depth_agreement(seen), np.where(guessed[:, None] | guessed[None, :], _MISTAKEN, 0.0))
    overlaps = [np.maximum(iou_2d(xyxy, xyxy), _CONTAINED * inside_shares(xyxy, xyxy)) for xyxy in (seen.xyxy_px, flat)]
    return np.where(upright, *(np.maximum(overlap, overlap.T) for overlap in overlaps)) * depths


def _depth_agreement(seen: ImageObservations) -> Float64:
    """How well depths agree (N, N): 1 where they are equal or one isn't known, falling with their relative errors."""
    log = np.log(np.maximum(seen.depth_m, 0.1))
    difference = np.nan_to_num(log[:, None] - log[None, :])
    variance = seen.depth_std[:, None] ** 2 + seen.depth_std[None, :] ** 2
    return np.asarray(np.exp(-0.5 * difference**2 / variance), np.float64)


def _drop_parts(seen: ImageObservations, groups: list[Int64]) -> list[Int64]:
    """Leave out parts of what a sure camera and another sensor show together, unless a camera is surer of the part; and
    what only stereo shows of what any other sensor does.
    """
    sure = (seen.source == int(Source.C)) & ~seen.weak
    whole = [rows for rows in groups if sure[rows[0]] and len(rows) > 1]
    boxes, depths = (np.array([rows[k] for rows in whole], np.int64) for k in (0, 1))
    share = inside_shares(seen.xyxy_px, seen.xyxy_px[boxes])
    less = ~sure[:, None] | (seen.score[:, None] < seen.score[None, boxes])
    agreement = _depth_agreement(seen)
    is_part = ((share > _PART) & (agreement[:, depths] > _AGREE) & less).any(axis=1)
    by_stereo = seen.source == int(Source.S)
    others = ~by_stereo & ~seen.weak
    within = inside_shares(seen.xyxy_px, seen.xyxy_px[others]) > _PART
    is_part |= by_stereo & (within & (agreement[:, others] > _AGREE)).any(axis=1)
    return [rows for rows in groups if rows[0] in boxes or not is_part[rows].all()]


def _object(view: ImageView, rows: Int64, camera_share: float, params: ImageFusionParams) -> ImageObject:
    seen = view.seen
    of = {Source(int(seen.source[row])): int(row) for row in rows}
    measured = [kind for kind in (Source.L, Source.R, Source.S) if kind in of]
    upright = [of[kind] for kind in measured if seen.upright[of[kind]]]
    shown = of.get(Source.C, next(iter(upright), int(rows[0])))
    depth, depth_std = seen.depth_m[shown], float(seen.depth_std[shown])
    if measured:
        row = of[measured[0]]
        depth, depth_std = seen.depth_m[row], float(seen.depth_std[row]) if measured[0] == Source.S else 0.0
    box: Float64 = seen.xyxy_px[shown]
    if upright and Source.C in of:  # drawn toward the outline of the points, the more the less the camera is sure
        sure = min(float(seen.score[of[Source.C]]) / SURE, 1.0)
        share = sure * params.measured_share + (1 - sure) * params.weak_measured_share
        box = box + share * seen.exactness[upright[0]] * (seen.xyxy_px[upright[0]] - box)
    return ImageObject(
        xyxy_px=box,
        label=str(seen.label[shown]),
        score=_score(view, of, box, depth, depth_std, camera_share, params),
        distance_m=seen.distance_m[of[measured[0]]]
        if measured
        else _find_distance(view.rig, view.camera, box, depth + _HALF_LENGTH_M),
        rate_mps=float(seen.rate_mps[of[Source.R]]) if Source.R in of else float("nan"),
        sources=sum(int(kind) for kind in of),
    )


def _score(
    view: ImageView,
    of: Mapping[Source, int],
    box: Float64,
    depth: float,
    depth_std: float,
    camera_share: float,
    params: ImageFusionParams,
) -> float:
    """Probability of an object, by the ratio of its odds as each sensor alone gives them to those before it looked."""
    weight = {
        Source.C: 1.0, Source.L: params.lidar_weight, Source.R: params.radar_weight, Source.S: params.stereo_weight
    }  # fmt: skip
    factor = dict[Source, float]()
    for kind, row in of.items():
        said = weight[kind] * float(view.seen.score[row])
        factor[kind] = float(np.exp(view.seen.exactness[row] * (log_odds(said) - log_odds(params.prior))))
    if Source.S in of and len(of) > 1:  # stereo says nothing beside LiDAR, and nothing against what others see
        factor[Source.S] = 1.0 if Source.L in of else max(factor[Source.S], 1.0)
    size_px = np.sqrt((box[2] - box[0]) * (box[3] - box[1]))
    shown = camera_share * float(saturate(size_px, params.camera_size_px))
    # A weak box never says less than none.
    factor[Source.C] = max(factor.get(Source.C, 0.0), 1 - (1 - params.unseen_by_camera) * shown)
    for kind in (Source.L, Source.R):
        if kind in of and Source.C in of and not view.seen.weak[of[Source.C]]:
            factor[kind] = max(factor[kind], 1.0)  # odd shapes say nothing against what a camera is sure of
    if Source.L not in of and view.rays is not None and view.rays.go_through(box, depth, depth_std, params.through):
        factor[Source.L] = params.unseen_by_rays
        factor[Source.S] = min(factor.get(Source.S, 1.0), 1.0)
    return combine_factors(params.prior, factor.values())


def _find_distance(rig: Rig, camera: str, box: Float64, depth_m: float) -> float:
    """Distance from the body's origin [m] of what lies in the middle of a box (4,) at this depth [m], NaN where that
    isn't known.
    """
    ray = rays(rig.cameras[camera], np.array([[(box[0] + box[2]) / 2, (box[1] + box[3]) / 2]]))
    if np.isnan(depth_m) or not ray[0, 2] > 0:
        return float("nan")
    place = transform(rig.body_T_sensor(camera), ray / ray[0, 2] * depth_m)
    return float(np.sqrt((place**2).sum()))
