"""Late fusion in 3D: what all sensors detected, merged in body coordinates."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.camera.detector import CameraDetections
from fbench.pipelines.fusion.agreement import Agreement
from fbench.pipelines.fusion.clusters import clusters
from fbench.pipelines.fusion.existence import Evidence, lidar_weight, probabilities
from fbench.pipelines.fusion.found import Found, one_object, to_boxes
from fbench.pipelines.fusion.groups import Group, groups
from fbench.pipelines.fusion.lift import sightings
from fbench.pipelines.fusion.nested import less_sure_of_parts
from fbench.pipelines.fusion.params import FusionParams
from fbench.pipelines.fusion.place import Placed, Scene, boxes_of, place
from fbench.pipelines.fusion.standing import standing_echoes, standing_near_m
from fbench.pipelines.fusion.views import blocking
from fbench.pipelines.points.lidar import LidarView
from fbench.pipelines.points.radar import RadarView
from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Kind, Rig, Source
from fbench.replay.geometry.rotated import iou_bev

_COVERED = 0.15
"""Solid things don't share their place: where a footprint covers more of another than this share, one is wrong."""
_TWICE = 0.25
"""Distances whose logarithms differ by less may be guesses of one."""


@dataclass(frozen=True, eq=False)
class Seen:
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

    def step(self, seen: Seen) -> Boxes3D:
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


def fuse(seen: Seen, params: FusionParams) -> Boxes3D:
    """Merge what was seen in a single frame; see `LateFusion.step`."""
    return LateFusion(params).step(seen)


def _scene(seen: Seen, params: FusionParams) -> Scene:
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
