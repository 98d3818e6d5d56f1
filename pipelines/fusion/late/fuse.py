"""Late fusion in 3D: what all sensors detected, merged in body coordinates."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from fbench.pipelines.fusion.kernels import count_near
from fbench.pipelines.fusion.late.association import Group, groups
from fbench.pipelines.fusion.late.existence import Agreement, Evidence, blocking, lidar_weight, probabilities
from fbench.pipelines.fusion.late.params import AssociationParams, FusionParams
from fbench.pipelines.fusion.late.place import Placed, Scene, boxes_of, place
from fbench.pipelines.fusion.observations import Clusters, Sighting, clusters, sightings
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.lidar.lidar import LidarView
from fbench.pipelines.sensors.radar.radar import RadarView
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.rig import Kind, Rig
from fbench.replay.geometry.camera import project_body
from fbench.replay.geometry.iou import iou_bev


@dataclass(frozen=True, eq=False)
class Found:
    """One object in body coordinates."""

    center_m: Float64
    """(3,) [m]."""
    size_lwh_m: Float64
    """(3,) length, width, height [m]."""
    yaw_rad: float
    """Heading [rad]."""
    velocity_mps: Float64
    """(3,) over ground [m/s]; NaN where unknown."""
    label: str
    """One of `LABELS`."""
    score: float
    """How sure it is that the object exists, 0 to 1."""
    sources: int
    """Bits of `Source`."""


def distance_m(a: Found, b: Found) -> float:
    """Distance of two centres on the ground [m]."""
    return math.hypot(float(a.center_m[0]) - float(b.center_m[0]), float(a.center_m[1]) - float(b.center_m[1]))


def one_object(a: Found, b: Found, merge_m: float) -> bool:
    """Tell whether two boxes show one object: centres nearer than `merge_m`, or the centre of one inside the other.

    The latter matters for long vehicles, of which radar shows only the near end.
    """
    distance = distance_m(a, b)
    return distance < merge_m or (distance < _reach_m(a) and _holds(a, b)) or (distance < _reach_m(b) and _holds(b, a))


def _reach_m(box: Found) -> float:
    """No point of the box is farther from its middle, seen from above [m]."""
    return float(box.size_lwh_m[0] + box.size_lwh_m[1]) / 2


def _holds(box: Found, other: Found) -> bool:
    east, north = (other.center_m - box.center_m)[:2]
    cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    along, across = abs(east * cos + north * sin), abs(north * cos - east * sin)
    return bool(along <= box.size_lwh_m[0] / 2 and across <= box.size_lwh_m[1] / 2)


def to_boxes(objects: Sequence[Found]) -> Boxes3D:
    """Boxes by falling score, equal scores by place; the same fields for any number of objects."""
    ordered = sorted(objects, key=lambda o: (-o.score, *o.center_m.tolist()))
    return Boxes3D(
        center_m=np.array([o.center_m for o in ordered]).reshape(-1, 3),
        size_lwh_m=np.array([o.size_lwh_m for o in ordered]).reshape(-1, 3),
        yaw_rad=np.array([o.yaw_rad for o in ordered], np.float64),
        velocity_mps=np.array([o.velocity_mps for o in ordered]).reshape(-1, 3),
        label=np.array([o.label for o in ordered], np.str_),
        score=np.array([o.score for o in ordered], np.float64),
        sources=np.array([o.sources for o in ordered], np.uint8),
    )


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


_MARGIN_M = 0.5
_FEWEST = 4
_DEPTH_M = 3.0
_GATE = 2.5


def standing_echoes(radar: Clusters, targets: Boxes3D) -> Float64:
    """Number (N,) of echoes of no moving cluster about each object; 0 where it is a handful."""
    reach = np.hypot(targets.size_lwh_m[:, 0], targets.size_lwh_m[:, 1]) / 2 + _MARGIN_M
    xy = np.ascontiguousarray(radar.loose[:, :2]), np.ascontiguousarray(targets.center_m[:, :2])
    num = count_near(*xy, reach).astype(np.float64)
    return np.where(num >= _FEWEST, num, 0.0)


def standing_near_m(rig: Rig, seen: list[Sighting], loose: Float64, params: AssociationParams) -> list[float]:
    """Distance of the near side [m] of what each sighting shows, by the stationary echoes (M, 3) in its direction; NaN
    where they tell nothing: that at which most of them lie within some metres, by how likely the image makes it.
    """
    result = []
    for camera in dict.fromkeys(s.camera for s in seen):
        uv, _ = project_body(rig, camera, loose)
        eye = rig.body_T_sensor(camera)[:2, 3]
        reach = np.hypot(loose[:, 0] - eye[0], loose[:, 1] - eye[1])
        result += [_near(s, uv[:, 0], reach) for s in seen if s.camera == camera]
    return result


def _near(s: Sighting, u_px: Float64, reach_m: Float64) -> float:
    rows = np.flatnonzero((u_px > s.xyxy_px[0]) & (u_px < s.xyxy_px[2]))
    deviation = np.log(np.maximum(reach_m[rows], 0.1) / s.near_m) / s.std
    inside = np.abs(deviation) < _GATE
    if np.count_nonzero(inside) <= _FEWEST:
        return float("nan")
    order = np.argsort(reach_m[rows[inside]], kind="stable")
    distance, likelihood = reach_m[rows[inside]][order], np.exp(-(deviation[inside][order] ** 2) / 2)
    stop = np.searchsorted(distance, distance + _DEPTH_M)
    begin = int(np.argmax((stop - np.arange(len(distance))) * likelihood))
    num = int(stop[begin]) - begin
    return float(distance[begin + num // 10]) if num > _FEWEST else float("nan")


_COVERED = 0.15
"""Solid things don't share their place: where a footprint covers more of another than this share, one is wrong."""
_TWICE = 0.25
"""Distances whose logarithms differ by less may be guesses of one."""


@dataclass(frozen=True, eq=False)
class Observations:
    """What the sensors that worked saw in one frame."""

    rig: Rig
    cameras: Mapping[str, CameraDetections]
    """By camera name; a camera that failed isn't in it."""
    lidar: LidarView
    """Empty where no LiDAR delivered."""
    radar: RadarView
    """Empty where no radar delivered."""


class LateFusion:
    """Merges what sensors detect, frame by frame, and remembers how well each of them works."""

    def __init__(self, params: FusionParams) -> None:
        self._params = params
        self._agreement = Agreement(params.agreement)

    def reset(self) -> None:
        """Forget how well the sensors work."""
        self._agreement.reset()

    def step(self, seen: Observations) -> Boxes3D:
        """Merge all that was seen into labelled boxes with score, sources and, where radar measured it, velocity.

        Measurements of all sensors are grouped at once, each group is placed, and its probability to exist follows
        from the sensors that see it and those that should. Of objects in one place the most probable stays.
        """
        params, scene = self._params, _scene(seen, self._params)
        found = groups(seen.rig, scene.sightings, scene.lidar, scene.radar, _eye(seen.rig, "radar"), params.association)
        found = [group for group in found if _may_exist(group, scene, params)]
        placed = [place(group, scene, params.association) for group in found]
        if not placed:
            return to_boxes([])
        targets = boxes_of(placed)
        standing = standing_echoes(scene.radar, targets)
        obstacles = blocking(np.concatenate([scene.lidar.xyz, scene.lidar.loose]), scene.plane)
        cameras = tuple(sorted(seen.cameras))
        evidence = Evidence(seen.rig, cameras, scene, found, targets, standing, _eye(seen.rig, "radar"), obstacles)
        probability = probabilities(evidence, self._agreement, params)
        kept = [
            _found(p, float(probability[i]), _sources(found[i], float(standing[i])))
            for i, p in enumerate(placed)
            if probability[i] > 0 and probability[i] >= params.min_score
        ]
        return to_boxes(_apart(kept))


def fuse(seen: Observations, params: FusionParams) -> Boxes3D:
    """Merge what was seen in a single frame; see `LateFusion.step`."""
    return LateFusion(params).step(seen)


def _scene(seen: Observations, params: FusionParams) -> Scene:
    found = [
        sighting
        for name in sorted(seen.cameras)
        for sighting in sightings(seen.rig, name, seen.cameras[name], seen.lidar.plane, params.association)
    ]
    found = less_sure_of_parts(found)
    found.sort(key=lambda s: (s.camera, *s.xyxy_px.tolist(), s.label, s.score))
    lidar = clusters(seen.lidar.xyz, seen.lidar.cluster, seen.lidar.boxes)
    radar = clusters(seen.radar.xyz, seen.radar.cluster, seen.radar.boxes)
    near = standing_near_m(seen.rig, found, radar.loose, params.association)
    return Scene(seen.rig, found, lidar, radar, seen.lidar.plane, _eye(seen.rig, "lidar"), near)


def _may_exist(group: Group, scene: Scene, params: FusionParams) -> bool:
    """Leave out what only cameras see that aren't sure of it, and most of what only LiDAR sees: a street is full of
    clusters that look like no road user.
    """
    if group.lidar < 0 and group.radar < 0:
        return any(scene.sightings[i].is_sure for i in group.sightings)
    alone = not group.sightings and group.radar < 0
    return not alone or lidar_weight(scene, params) * float(scene.lidar.score[group.lidar]) >= params.min_score / 2


def _eye(rig: Rig, kind: Kind) -> Float64:
    """Where the sensors of a kind look from (2,) [m]: the middle between them."""
    places = [rig.body_T_sensor(name)[:2, 3] for name in rig.sensors(kind)]
    return np.asarray(np.mean(places, axis=0), np.float64) if places else np.zeros(2)


def _sources(group: Group, standing: float) -> int:
    camera = int(Source.C) if group.sightings else 0
    lidar = int(Source.L) if group.lidar >= 0 else 0
    return camera | lidar | (int(Source.R) if group.radar >= 0 or standing > 0 else 0)


def _found(p: Placed, score: float, sources: int) -> Found:
    return Found(p.center_m, p.size_lwh_m, p.yaw_rad, p.velocity_mps, p.label, score, sources)


def _apart(objects: list[Found]) -> list[Found]:
    """Leave out objects in the place of more probable ones."""
    ordered = sorted(objects, key=lambda o: (-o.score, *o.center_m.tolist()))
    covered = _covered(to_boxes(ordered))
    kept: list[int] = []
    for i, found in enumerate(ordered):
        if not any(
            covered[i, k] > _COVERED or one_object(found, ordered[k], _reach(found, ordered[k]))
            or _in_line(found, ordered[k])
            for k in kept
        ):  # fmt: skip
            kept.append(i)
    return [ordered[i] for i in kept]


def _covered(boxes: Boxes3D) -> Float64:
    """Share (N, N) of the smaller of two footprints that the other one covers."""
    iou, area = iou_bev(boxes, boxes), boxes.size_lwh_m[:, 0] * boxes.size_lwh_m[:, 1]
    both = iou * (area[:, None] + area[None, :]) / (1 + iou)
    return np.asarray(both / np.maximum(np.minimum(area[:, None], area[None, :]), 1e-9), np.float64)


def _in_line(found: Found, other: Found) -> bool:
    """Tell whether an object whose distance only a camera guesses is another one, seen twice: it lies in its direction,
    about as far away.
    """
    if found.sources & Source.L or np.isfinite(found.velocity_mps).any():
        return False
    (x, y), (u, v) = (f.center_m[:2].tolist() for f in (found, other))
    reach, away = max(float(np.hypot(x, y)), 0.1), max(float(np.hypot(u, v)), 0.1)
    aside = abs(x * v - y * u) / away
    return x * u + y * v > 0 and aside < other.size_lwh_m[1] / 2 and abs(float(np.log(reach / away))) < _TWICE


def _reach(a: Found, b: Found) -> float:
    """Centres nearer than this [m] can't be those of two objects: the mean of both widths."""
    return float(a.size_lwh_m[1] + b.size_lwh_m[1]) / 2
