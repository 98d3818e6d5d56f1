"""Late fusion in 3D: objects that sensors detect separately, merged in body coordinates."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from fbench.pipelines.fusion import observations
from fbench.pipelines.fusion.kernels import count_near
from fbench.pipelines.fusion.late.association import Association, associate
from fbench.pipelines.fusion.late.existence import Evidence, FusionParams, believe_lidar, probabilities
from fbench.pipelines.fusion.late.place import FusedObject, Observations, place
from fbench.pipelines.fusion.observations import CameraObservation, are_one
from fbench.pipelines.fusion.reliability import SensorReliability
from fbench.pipelines.sensors.bev.grid import in_reach
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.lidar.clusters import LidarView
from fbench.pipelines.sensors.points.merged import viewpoint
from fbench.pipelines.sensors.radar.stage import RadarView
from fbench.pipelines.sensors.rows import suppress
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import project_body
from fbench.replay.geometry.iou import iou_bev

_PART = 0.5  # Up to this share of a box may lie in a surer one without consequence: objects hide each other
_LEAST = 0.01  # Left of the score of a box that lies in a surer one as a whole
_SURE, _NEARLY = 0.5, 0.9  # A camera alone reports a box whose score is still this high, or this share of what it was
_IN_FRONT_PX = 1.0  # A box whose lower edge is by more than this lower in the image stands in front of the other
_MARGIN_M = 0.5
_FEWEST = 4
_DEPTH_M = 3.0
_GATE = 2.5
_COVERED = 0.15
"""Solid things don't share their place: where a footprint covers more of another than this share, one is wrong."""
_TWICE = 0.25  # Distances whose logarithms differ by less may be guesses of one


@dataclass(frozen=True, eq=False)
class SensorViews:
    """Detections of the sensors that worked in one frame."""

    rig: Rig
    cameras: Mapping[str, CameraDetections]  # By camera name; a camera that failed isn't in it
    lidar: LidarView  # Empty where no LiDAR delivered
    radar: RadarView  # Empty where no radar delivered


class LateFusion:
    """Merges what sensors detect, frame by frame, and remembers how well each of them works."""

    def __init__(self, params: FusionParams) -> None:
        self._params = params
        self._reliability = SensorReliability(params.agreement)

    def reset(self) -> None:
        """Forget how well the sensors work."""
        self._reliability.reset()

    def step(self, views: SensorViews) -> Boxes3D:
        """Merge all that was seen into labeled boxes with score, sources and, where radar measured it, velocity.

        Observations of all sensors are associated at once, each object is placed, and its probability to exist follows
        from the sensors that see it and those that should. Of objects in one place the most probable stays. They come
        by falling score, equal scores by place.
        """
        params = self._params
        seen = observe(views, params)
        groups = associate(seen.rig, seen.cameras, seen.lidar, seen.radar, seen.radar_eye_m, params.association)
        groups = [group for group in groups if self._may_exist(group, seen)]
        objects = [place(group, seen, params.association) for group in groups]
        targets = to_boxes(objects)
        if not objects:
            return targets
        # Echoes of no moving cluster about each object; a handful says nothing.
        reach = np.hypot(targets.size_lwh_m[:, 0], targets.size_lwh_m[:, 1]) / 2 + _MARGIN_M
        xy = np.ascontiguousarray(seen.radar.loose[:, :2]), np.ascontiguousarray(targets.center_m[:, :2])
        num = count_near(*xy, reach).astype(np.float64)
        standing = np.where(num >= _FEWEST, num, 0.0)
        probability = probabilities(Evidence(seen, groups, targets, standing), self._reliability, params)
        of_lidar = seen.lidar.boxes.sources  # Those of a network may be by echoes
        of_lidar = np.append(np.full(len(seen.lidar.boxes), int(Source.L)) if of_lidar is None else of_lidar, 0)
        sources = [
            (Source.C if group.cameras else 0)
            | int(of_lidar[group.lidar])
            | (Source.R if group.radar >= 0 or num_echoes > 0 else 0)
            for group, num_echoes in zip(groups, standing.tolist(), strict=True)
        ]
        moves = np.array([np.isfinite(found.velocity_mps).any() for found in objects])
        by_camera = np.array([group.lidar < 0 for group in groups]) & ~moves
        kept = np.flatnonzero((probability > 0) & (probability >= params.min_score))
        kept = kept[np.lexsort((*targets.center_m[kept].T[::-1], -probability[kept]))]
        kept = kept[suppress(_share_places(targets[kept], by_camera[kept]))]
        return replace(targets, score=probability, sources=np.array(sources, np.uint8))[kept]

    def _may_exist(self, group: Association, seen: Observations) -> bool:
        """Leave out what only cameras see that aren't sure of it, echoes that a network took for nothing, and most of
        what only LiDAR sees: a street is full of clusters that look like no road user.
        """
        if group.lidar < 0 and (group.radar < 0 or _is_ignored(group.radar, seen)):
            return any(seen.cameras[i].is_sure for i in group.cameras)
        if group.cameras or group.radar >= 0:
            return True
        return float(believe_lidar(seen.lidar, self._params)[group.lidar]) >= self._params.min_score / 2


def _is_ignored(radar: int, seen: Observations) -> bool:
    """Whether a network got these echoes and took them for nothing."""
    return seen.with_echoes and bool(in_reach(seen.radar.boxes.center_m[[radar]])[0])


def fuse(views: SensorViews, params: FusionParams) -> Boxes3D:
    """Merge what was seen in a single frame; see `LateFusion.step`."""
    return LateFusion(params).step(views)


def observe(views: SensorViews, params: FusionParams) -> Observations:
    """Turn detections into observations, in an order that doesn't depend on how they are listed."""
    rig, lidar, radar = views.rig, views.lidar, views.radar
    cameras = list[CameraObservation]()
    for name in sorted(views.cameras):
        cameras += observations.observe_camera(rig, name, views.cameras[name], lidar.plane, params.association)
    cameras = lower_nested(cameras)
    cameras.sort(key=lambda s: (s.camera, *s.xyxy_px.tolist(), s.label, s.score))
    of_lidar = observations.sort_clusters(lidar.xyz, lidar.cluster, lidar.boxes)
    of_radar = observations.sort_clusters(radar.xyz, radar.cluster, radar.boxes)
    return Observations(
        rig=rig,
        working=tuple(sorted(views.cameras)),
        cameras=cameras,
        lidar=of_lidar,
        radar=of_radar,
        plane=lidar.plane,
        learned=lidar.learned,
        with_echoes=lidar.with_echoes,
        lidar_eye_m=viewpoint(rig, "lidar")[:2],
        radar_eye_m=viewpoint(rig, "radar")[:2],
        standing_m=_near_distances(rig, cameras, of_radar.loose, knows_height=False),
        obstacle_m=_near_distances(rig, cameras, of_lidar.measured_xyz, knows_height=True),
    )


def lower_nested(seen: Sequence[CameraObservation]) -> list[CameraObservation]:
    """Lower the scores of boxes of which more than half lies in a surer one of the same image, in proportion to it,
    unless they stand in front of that; those that aren't likelier there than not count only where others confirm them.

    The surest box goes first, and what it lowered counts as lowered. Of equal scores the first by its edges and its
    label is the surer, so that the order in which they were listed doesn't matter. Scores that aren't above 0 stay.
    """
    ordered = sorted(seen, key=lambda s: (s.camera, -s.score, *s.xyxy_px.tolist(), s.label))
    found = list[CameraObservation]()
    for _, group in groupby(ordered, key=lambda s: s.camera):
        own, scores = list(group), list[float]()
        # Share (N, N) of each box that another one, which it isn't in front of, covers.
        xyxy = np.array([s.xyxy_px for s in own])
        share = np.where(
            xyxy[:, None, 3] > xyxy[None, :, 3] + _IN_FRONT_PX, 0.0, observations.inside_shares(xyxy, xyxy)
        )
        for at, s in enumerate(own):
            surer = [k for k, other in enumerate(scores) if other >= s.score]
            factor = min(max((1.0 - float(share[at, surer].max(initial=0.0))) / (1.0 - _PART), _LEAST), 1.0)
            scores.append(s.score * factor if s.score > 0 else s.score)
        for s, score in zip(own, scores, strict=True):
            is_sure = s.is_sure and (score == s.score or score >= min(_SURE, _NEARLY * s.score))
            found.append(replace(s, score=score, is_sure=is_sure))
    return found


def _near_distances(rig: Rig, seen: list[CameraObservation], xyz: Float64, knows_height: bool) -> list[float]:
    """Distance of the near side [m] of what each camera box shows, by points (M, 3) in its direction, or, of a sensor
    that knows heights, in the box; NaN where they say nothing: that at which most of them lie within some meters, by
    how likely the image makes it.
    """
    result = []
    for camera, group in groupby(seen, key=lambda s: s.camera):
        uv, _ = project_body(rig, camera, xyz)
        eye = rig.body_T_sensor(camera)[:2, 3]
        reach = np.hypot(xyz[:, 0] - eye[0], xyz[:, 1] - eye[1])
        for s in group:
            left, top, right, bottom = s.xyxy_px
            rows = np.flatnonzero((uv[:, 0] > left) & (uv[:, 0] < right))
            if knows_height:
                rows = rows[(uv[rows, 1] > top) & (uv[rows, 1] < bottom)]
            deviation = np.log(np.maximum(reach[rows], 0.1) / s.near_m) / s.std
            inside = np.abs(deviation) < _GATE
            rows, deviation = rows[inside], deviation[inside]
            order = np.argsort(reach[rows], kind="stable")
            distance, likelihood = reach[rows][order], np.exp(-(deviation[order] ** 2) / 2)
            num = begin = 0
            if len(rows) > _FEWEST:
                stop = np.searchsorted(distance, distance + _DEPTH_M)
                begin = int(np.argmax((stop - np.arange(len(distance))) * likelihood))
                num = int(stop[begin]) - begin
            result.append(float(distance[begin + num // 10]) if num > _FEWEST else float("nan"))
    return result


def to_boxes(objects: Sequence[FusedObject]) -> Boxes3D:
    """Boxes in the order given, of which score and sources aren't known; the same fields for any number of objects."""
    return Boxes3D(
        center_m=np.array([o.center_m for o in objects]).reshape(-1, 3),
        size_lwh_m=np.array([o.size_lwh_m for o in objects]).reshape(-1, 3),
        yaw_rad=np.array([o.yaw_rad for o in objects], np.float64),
        velocity_mps=np.array([o.velocity_mps for o in objects]).reshape(-1, 3),
        label=np.array([o.label for o in objects], np.str_),
        score=np.zeros(len(objects)),
        sources=np.zeros(len(objects), np.uint8),
    )


def _share_places(boxes: Boxes3D, by_camera: Bool) -> Bool:
    """Which boxes (N, N), by row, are in the place of another one, by column: nearer than the mean of both widths, say,
    or `by_camera` (N,), where a camera alone places what was seen twice: in its direction, about as far away.
    """
    iou, area, width = iou_bev(boxes, boxes), boxes.size_lwh_m[:, 0] * boxes.size_lwh_m[:, 1], boxes.size_lwh_m[:, 1]
    both = iou * (area[:, None] + area[None, :]) / (1 + iou)
    # Share of the smaller of two footprints that the other one covers.
    covered = both / np.maximum(np.minimum(area[:, None], area[None, :]), 1e-9)
    same = (covered > _COVERED) | are_one(boxes, (width[:, None] + width[None, :]) / 2)
    x, y = boxes.center_m[:, :2].T
    reach = np.maximum(np.hypot(x, y), 0.1)
    aside = np.abs(x[:, None] * y - y[:, None] * x) / reach
    ahead = x[:, None] * x + y[:, None] * y > 0
    near = np.abs(np.log(reach[:, None] / reach)) < _TWICE
    return np.asarray(same | (by_camera[:, None] & ahead & (aside < width / 2) & near), np.bool_)
