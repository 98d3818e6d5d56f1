"""Fusion in images: observations of several kinds of sensors of one object become one box."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fbench.pipelines.fusion.reliability import CameraTrust, Evidence, ImageFusionParams, evidence, rate_at
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.image.objects import Points
from fbench.pipelines.sensors.image.observations import SURE, Sightings, agreed, by_camera, log_odds
from fbench.pipelines.sensors.image.stage import InImages, Rays, seen_through
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Source, concatenate
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import rays
from fbench.replay.geometry.iou import iou_2d
from fbench.replay.geometry.transforms import transform

_CONTAINED = 0.7
"""What lies inside another box counts as alike by this share of itself: of what is hidden only a part is measured."""
_MISTAKEN = 0.35
"""Depths that a camera guesses agree at least so far with others: the class that tells the size may be wrong."""


def merged(seen: Sightings, min_similarity: float) -> list[Int64]:
    """Group boxes (N) that show one object; each group has at most one box of each kind of sensor.

    The best pair is joined first, whichever sensors it is of: the most similar one of the surest boxes. A camera's weak
    boxes take what all others leave. Returns rows of each group, in ascending order.
    """
    alike = similarity(seen)
    sure = np.sqrt(seen.score[:, None] * seen.score[None, :])
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


def similarity(seen: Sightings) -> Float64:
    """How alike boxes are (N, N), 0 to 1: their overlap in the image times how well their depths agree."""
    flat = seen.xyxy_px.copy()
    flat[:, 1], flat[:, 3] = 0.0, 1.0  # compares left and right only
    upright = seen.upright[:, None] & seen.upright[None, :]
    guessed = seen.source == int(Source.C)
    depths = np.maximum(agreement(seen), np.where(guessed[:, None] | guessed[None, :], _MISTAKEN, 0.0))
    return np.where(upright, _overlap(seen.xyxy_px), _overlap(flat)) * depths


def _overlap(xyxy_px: Float64) -> Float64:
    overlap = np.maximum(iou_2d(xyxy_px, xyxy_px), _CONTAINED * inside(xyxy_px, xyxy_px))
    return np.asarray(np.maximum(overlap, overlap.T), np.float64)


def agreement(seen: Sightings) -> Float64:
    """How well depths agree (N, N): 1 where they are equal or one isn't known, falling with their relative errors."""
    log = np.log(np.maximum(seen.depth_m, 0.1))
    difference = np.nan_to_num(log[:, None] - log[None, :])
    variance = seen.depth_std[:, None] ** 2 + seen.depth_std[None, :] ** 2
    return np.asarray(np.exp(-0.5 * difference**2 / variance), np.float64)


def inside(a: Float64, b: Float64) -> Float64:
    """Share of each box of `a` (N, 4) that lies in each of `b` (M, 4): (N, M)."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    common = np.prod(np.clip(high - low, 0.0, None), axis=2)
    area = np.prod(a[:, 2:] - a[:, :2], axis=1)
    return np.asarray(common / np.maximum(area, 1e-9)[:, None], np.float64)


_PART, _AGREE = 0.6, 0.2
"""What lies by this share in an object's box, and agrees so far in depth, is a part of it."""
_SAME = 0.5
"""Of two objects with a larger IoU the farther one would be hidden."""
_BEHIND_M = 4.0
"""Rays that end so far [m] behind the near side of an object went through it."""
_BEFORE_M = 2.0
_LEAST_RAYS = 4
_HALF_LENGTH_M = 2.0
"""From the near side of an object to its middle [m], where only that is known."""


@dataclass(frozen=True, eq=False)
class ImageView:
    """What all sensors see in one image."""

    rig: Rig
    camera: str
    seen: Sightings
    looked: bool
    """Whether the camera itself worked."""
    points: Mapping[Source, Points] = field(default_factory=dict)
    """Points of LiDAR and radar over the ground, where fusion is early."""
    rays: Mapping[Source, Rays] = field(default_factory=dict)
    """All their points."""


@dataclass(frozen=True, eq=False)
class _Object:
    xyxy_px: Float64
    label: str
    score: float
    distance_m: float
    rate_mps: float
    sources: int


def fuse(view: ImageView, params: ImageFusionParams, camera_trust: float = 0.9) -> Boxes2D:
    """Merge what was seen into labelled boxes by falling score, with the sensors that contributed.

    An object has its outline and class from the camera, its distance from LiDAR, else radar, and its range rate from
    radar, as far as they see it. Parts of an object that a camera sees whole are left out. `camera_trust`: share of
    objects that the camera sees at present. All objects are there, whatever their score.
    """
    seen = view.seen
    groups = [rows for rows in merged(seen, params.min_similarity) if len(rows) > 1 or not seen.weak[rows[0]]]
    groups = _without_parts(seen, groups)
    free = {kind: _free(view, kind, groups) for kind in view.points}
    trust = camera_trust if view.looked else 0.0
    objects = [_object(view, rows, free, trust, params) for rows in groups]
    return _boxes(view.camera, _distinct(sorted(objects, key=lambda o: (-o.score, *o.xyxy_px.tolist()))))


def _distinct(objects: list[_Object]) -> list[_Object]:
    """Leave out objects that are in the place of one named before: sensors disagreed on how far away it is."""
    boxes = np.array([o.xyxy_px for o in objects], np.float64).reshape(-1, 4)
    rivals, kept = iou_2d(boxes, boxes) > _SAME, np.ones(len(objects), np.bool_)
    for at in range(len(objects)):
        kept[at] = not (rivals[at, :at] & kept[:at]).any()
    return [objects[at] for at in np.flatnonzero(kept)]


def _without_parts(seen: Sightings, groups: list[Int64]) -> list[Int64]:
    """Leave out groups that are a part of what a camera, sure of it, and another sensor show together; not those of
    which a camera is surer.
    """
    sure = (seen.source == int(Source.C)) & ~seen.weak
    boxes = np.array([rows[0] for rows in groups if sure[rows[0]] and len(rows) > 1], np.int64)
    depths = np.array([rows[1] for rows in groups if sure[rows[0]] and len(rows) > 1], np.int64)
    share, agree = inside(seen.xyxy_px, seen.xyxy_px[boxes]), agreement(seen)[:, depths]
    less = ~sure[:, None] | (seen.score[:, None] < seen.score[None, boxes])
    is_part = np.asarray(((share > _PART) & (agree > _AGREE) & less).any(axis=1), np.bool_)
    return [rows for rows in groups if rows[0] in boxes or not is_part[rows].all()]


def _free(view: ImageView, kind: Source, groups: list[Int64]) -> Points:
    """Points that no object has: those of no cluster, or of one that is a group by itself, but not of large things."""
    alone = [rows[0] for rows in groups if len(rows) == 1 and view.seen.source[rows[0]] == int(kind)]
    points = view.points[kind]
    return points.rows((points.cluster < 0) | np.isin(points.cluster, view.seen.spot[np.array(alone, np.int64)]))


def _object(
    view: ImageView, rows: Int64, free: Mapping[Source, Points], camera_trust: float, params: ImageFusionParams
) -> _Object:
    seen = view.seen
    of = {Source(int(seen.source[row])): int(row) for row in rows}
    shown = of.get(Source.C, of.get(Source.L, int(rows[0])))
    found = _evidence(view, of, free)
    measured = [kind for kind in (Source.L, Source.R) if kind in of]
    depth = seen.depth_m[of[measured[0]]] if measured else next((e.depth_m for e in found.values()), np.nan)
    if np.isnan(depth):
        depth = seen.depth_m[shown]
    box = _outline(seen, of, params)
    distance = seen.distance_m[of[measured[0]]] if measured else _distance_m(view, box, depth)
    return _Object(
        xyxy_px=box,
        label=str(seen.label[shown]),
        score=_score(view, of, found, box, depth, camera_trust, params),
        distance_m=distance,
        rate_mps=_rate(view, of, found, box, depth),
        sources=sum(int(kind) for kind in {*of, *found}),
    )


def _evidence(view: ImageView, of: Mapping[Source, int], free: Mapping[Source, Points]) -> dict[Source, Evidence]:
    """What free points say of a camera's box that isn't an object for their sensor."""
    if Source.C not in of:
        return {}
    absent = [kind for kind in (Source.L, Source.R) if kind not in of and kind in free]
    found = {kind: evidence(view.seen, of[Source.C], free[kind]) for kind in absent}
    return {kind: one for kind, one in found.items() if one is not None}


def _outline(seen: Sightings, of: Mapping[Source, int], params: ImageFusionParams) -> Float64:
    """Outline (4,) [px] by the camera, drawn towards that of the points, the more the less the camera is sure; without
    a camera by LiDAR, else radar.
    """
    boxes = [seen.xyxy_px[of[kind]] for kind in (Source.L, Source.R) if kind in of and seen.upright[of[kind]]]
    own: Float64 = seen.xyxy_px[of.get(Source.C, of.get(Source.L, of.get(Source.R, 0)))]
    if not boxes or Source.C not in of:
        return own
    sure = min(float(seen.score[of[Source.C]]) / SURE, 1.0)
    share = sure * params.measured_share + (1 - sure) * params.weak_measured_share
    return np.asarray(own + share * (boxes[0] - own), np.float64)


def _rate(
    view: ImageView, of: Mapping[Source, int], found: Mapping[Source, Evidence], box: Float64, depth: float
) -> float:
    if Source.R in of:
        return float(view.seen.rate_mps[of[Source.R]])
    if Source.R in found:
        return found[Source.R].rate_mps
    return rate_at(view.points[Source.R], box, depth) if Source.R in view.points else float("nan")


def _score(
    view: ImageView, of: Mapping[Source, int], found: Mapping[Source, Evidence], box: Float64, depth: float,
    camera_trust: float, params: ImageFusionParams,
) -> float:  # fmt: skip
    weight = {Source.C: 1.0, Source.L: params.lidar_weight, Source.R: params.radar_weight}
    said = {kind: _factor(weight[kind] * float(view.seen.score[row]), params.prior) for kind, row in of.items()}
    size_px = np.sqrt((box[2] - box[0]) * (box[3] - box[1]))
    shown = camera_trust * (1 - np.exp(-size_px / params.camera_size_px))
    # A weak box never says less than none.
    said[Source.C] = max(said.get(Source.C, 0.0), 1 - (1 - params.unseen_by_camera) * shown)
    for kind in (Source.L, Source.R):
        if kind in of and Source.C in of and not view.seen.weak[of[Source.C]]:
            said[kind] = max(said[kind], 1.0)  # odd shapes say nothing against what a camera is sure of
        elif kind in found:
            said[kind] = params.points_factor ** found[kind].strength
        elif kind not in of and _goes_through(view, kind, box, depth, params.through):
            said[kind] = params.unseen_by_rays
    return agreed(params.prior, said.values())


def _factor(probability: float, prior: float) -> float:
    """Ratio of the odds of an object as one sensor alone tells to those before it looked."""
    return float(np.exp(log_odds(probability) - log_odds(prior)))


def _goes_through(view: ImageView, kind: Source, box: Float64, depth_m: float, share: float) -> bool:
    """Tell whether most rays of a sensor in a box go on behind the object, so that it isn't there."""
    if kind not in view.rays or np.isnan(depth_m):
        return False
    depths = view.rays[kind].depths(box)
    return len(depths) >= _LEAST_RAYS and seen_through(depths, depth_m - _BEFORE_M, depth_m + _BEHIND_M) > share


def _distance_m(view: ImageView, box: Float64, depth_m: float) -> float:
    """Distance of an object's middle from the body's origin [m], given the depth of its near side."""
    if np.isnan(depth_m):
        return float("nan")
    middle = np.array([[(box[0] + box[2]) / 2, (box[1] + box[3]) / 2]])
    ray = rays(view.rig.cameras[view.camera], middle)
    if not ray[0, 2] > 0:
        return float("nan")
    place = transform(view.rig.body_T_sensor(view.camera), ray / ray[0, 2] * (depth_m + _HALF_LENGTH_M))
    return float(np.sqrt((place**2).sum()))


def _boxes(camera: str, objects: list[_Object]) -> Boxes2D:
    return Boxes2D(
        camera=np.full(len(objects), camera),
        xyxy_px=np.array([o.xyxy_px for o in objects], np.float64).reshape(-1, 4),
        label=np.array([o.label for o in objects], np.str_),
        score=np.array([o.score for o in objects], np.float64),
        distance_m=np.array([o.distance_m for o in objects], np.float64),
        range_rate_mps=np.array([o.rate_mps for o in objects], np.float64),
        sources=np.array([o.sources for o in objects], np.uint8),
    )


class ImageFusion:
    """Merges what the sensors see in each image, and learns from it how well the cameras see."""

    def __init__(self, rig: Rig, cameras: Sequence[str], params: ImageFusionParams) -> None:
        self._rig, self._cameras, self._params, self._trust = rig, cameras, params, CameraTrust()

    def reset(self) -> None:
        """Forget how well the cameras see."""
        self._trust.reset()

    def merge(self, looked: Mapping[str, CameraDetections], lidar: InImages, radar: InImages) -> Boxes2D:
        """Merge one frame; `looked` holds the cameras that worked. Any number of boxes has the same fields."""
        params, trust = self._params, self._trust.share
        views = [_view(self._rig, name, looked.get(name), lidar, radar) for name in self._cameras]
        every = concatenate([fuse(view, params, trust) for view in views])
        found = every if every.score is None else every[every.score >= params.min_score]
        self._trust.learn(found[np.isin(found.camera, sorted(looked))])
        return found


def _view(rig: Rig, camera: str, found: CameraDetections | None, lidar: InImages, radar: InImages) -> ImageView:
    kinds = {Source.L: lidar, Source.R: radar}
    parts = [view.seen[camera] for view in kinds.values() if camera in view.seen]
    if found is not None:
        parts.append(by_camera(found, rig.cameras[camera]))
    return ImageView(
        rig=rig,
        camera=camera,
        seen=Sightings.joined(parts),
        looked=found is not None,
        points={kind: view.points[camera] for kind, view in kinds.items() if camera in view.points},
        rays={kind: view.rays[camera] for kind, view in kinds.items() if camera in view.rays},
    )
