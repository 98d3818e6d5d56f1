"""Late fusion in 3D: the boxes of all sensors merged in body coordinates."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fbench.pipelines.camera.detector import CameraDetections
from fbench.pipelines.fusion.cameras import Placed, join
from fbench.pipelines.fusion.evidence import Evidence, Points, by_lidar, by_moving, by_standing
from fbench.pipelines.fusion.found import Found, joined_score, one_object, radar_weight, row, to_boxes
from fbench.pipelines.fusion.lift import Sighting, sightings
from fbench.pipelines.fusion.params import FusionParams
from fbench.pipelines.fusion.place import place
from fbench.pipelines.points.ground import Plane
from fbench.pipelines.points.lidar import LidarView
from fbench.pipelines.points.radar import RadarView
from fbench.replay.arrays import Bool, Int64
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Rig, Source
from fbench.replay.geometry.camera import in_image, project_body


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


def fuse(seen: Seen, params: FusionParams) -> Boxes3D:
    """Merge all that was seen into labelled boxes with score, sources and, where radar measured it, velocity.

    Each camera box is an object; nearer ones take their points first, in each camera anew, and what several cameras
    see of one object is joined. What LiDAR and radar found besides is added, with a lower score where a camera
    looked there and saw nothing.
    """
    lidar_free = {name: np.ones(len(seen.lidar.xyz), np.bool_) for name in seen.cameras}
    radar_free = {name: np.ones(len(seen.radar.xyz), np.bool_) for name in seen.cameras}
    views = {name: _points(seen, name) for name in sorted(seen.cameras)}
    alone = not len(seen.lidar.xyz) and not len(seen.radar.xyz)
    placed: list[Placed] = []
    lidar_used: list[int] = []
    radar_used: list[int] = []
    for sighting in _nearest_first(seen, params):
        camera = sighting.camera
        lidar_points, radar_points = views[camera]
        lidar = by_lidar(sighting, lidar_points, lidar_free[camera], params)
        moving = by_moving(sighting, radar_points, radar_free[camera], params)
        radar = moving or by_standing(sighting, radar_points, radar_free[camera], params)
        boxes = _box(seen.lidar.boxes, lidar), _box(seen.radar.boxes, moving)
        found = place(sighting, lidar, radar, *boxes, seen.lidar.plane, alone, params)
        placed = join(placed, found, sighting, params)
        lidar_free[camera] = _taken(lidar, lidar_free[camera], lidar_used)
        radar_free[camera] = _taken(radar, radar_free[camera], radar_used)
    objects = [known.found for known in placed]
    for other in _without_camera(seen, lidar_used, radar_used, params):
        if not any(one_object(other, known, params.merge_m) for known in objects):
            objects.append(other)
    return to_boxes([found for found in objects if found.score > 0 and found.score >= params.min_score])


def _points(seen: Seen, camera: str) -> tuple[Points, Points]:
    eye = seen.rig.body_T_sensor(camera)[:3, 3]
    parts = []
    for view in (seen.lidar, seen.radar):
        uv, _ = project_body(seen.rig, camera, view.xyz)
        distance = np.hypot(view.xyz[:, 0] - eye[0], view.xyz[:, 1] - eye[1])
        parts.append(Points(view.xyz, uv, distance, view.cluster))
    return parts[0], parts[1]


def _nearest_first(seen: Seen, params: FusionParams) -> list[Sighting]:
    found = [
        sighting
        for name in sorted(seen.cameras)
        for sighting in sightings(seen.rig, name, seen.cameras[name], seen.lidar.plane, params)
    ]
    return sorted(found, key=lambda s: (s.near_m, s.camera, *s.xyxy_px.tolist()))


def _box(boxes: Boxes3D, evidence: Evidence | None) -> Boxes3D | None:
    if evidence is None or evidence.cluster < 0:
        return None
    return boxes[np.array([evidence.cluster])]


def _taken(evidence: Evidence | None, free: Bool, used: list[int]) -> Bool:
    if evidence is None:
        return free
    used.append(evidence.cluster)
    return free & ~evidence.rows


def _without_camera(seen: Seen, lidar_used: list[int], radar_used: list[int], params: FusionParams) -> list[Found]:
    """Objects of LiDAR and radar that no camera box took, by falling score; those of both are one."""
    from_lidar = [
        row(seen.lidar.boxes, at, params.lidar_weight, int(Source.L)) for at in _others(seen.lidar.boxes, lidar_used)
    ]
    from_radar = [
        row(seen.radar.boxes, at, radar_weight(seen.radar.boxes, at, params), int(Source.R))
        for at in _others(seen.radar.boxes, radar_used)
    ]
    merged: list[Found] = []
    for found in sorted(from_lidar + from_radar, key=lambda f: (-f.score, *f.center_m.tolist())):
        near = [i for i, known in enumerate(merged) if one_object(found, known, params.merge_m)]
        if not near:
            merged.append(found)
        elif merged[near[0]].sources != found.sources:
            merged[near[0]] = _both(merged[near[0]], found, params)
    grounded = [_grounded(found, seen.lidar.plane) for found in merged]
    return [replace(f, score=f.score * params.unseen_factor) if _in_view(seen, f) else f for f in grounded]


def _others(boxes: Boxes3D, used: list[int]) -> Int64:
    score = np.zeros(len(boxes)) if boxes.score is None else boxes.score
    return np.flatnonzero((score > 0) & ~np.isin(np.arange(len(boxes)), used))


def _both(a: Found, b: Found, params: FusionParams) -> Found:
    """Join two objects: velocity by radar, place and shape by the sensor that recognises the vehicle better."""
    lidar, radar = (a, b) if a.sources & Source.L else (b, a)
    shape = lidar if lidar.score * params.radar_weight >= radar.score * params.lidar_weight else radar
    score, sources = joined_score(a.score, b.score), a.sources | b.sources
    return replace(shape, velocity_mps=radar.velocity_mps, score=score, sources=sources)


def _grounded(found: Found, plane: Plane | None) -> Found:
    """Stand an object on the ground, where that is known; radar is poor at heights."""
    if plane is None or found.sources & Source.L:
        return found
    x, y, _ = found.center_m
    z = float(plane.z_m(found.center_m[None])[0]) + float(found.size_lwh_m[2]) / 2
    return replace(found, center_m=np.array([x, y, z]))


def _in_view(seen: Seen, found: Found) -> bool:
    """Tell whether a working camera looks at the middle of an object."""
    for name in sorted(seen.cameras):
        uv, _ = project_body(seen.rig, name, found.center_m[None])
        if in_image(seen.rig.cameras[name], uv)[0]:
            return True
    return False
