"""Detection by all LiDARs of a rig, timed, with long vehicles put together again."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fbench.pipelines.sensors.lidar.lidar import OWN, LidarParams, LidarView, Obstacles, judging
from fbench.pipelines.sensors.lidar.lidar import detect as lidar_detect
from fbench.pipelines.sensors.lidar.lidar import obstacles as lidar_obstacles
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.points.merged import Deskew, Outline, lidar_points, viewpoint
from fbench.pipelines.sensors.points.vehicle import NEAR_M, complete_known, fit_rectangles
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.rig import LogInfo, Rig

_LABEL = "truck"
_LEAST_SCORE = 0.2  # What is less likely a road user doesn't take other clusters
_GAP_M = 1.8  # Stripes of one side are at most this far apart
_COLUMN_RAD = np.radians(1.3)
"""Columns of points are at most this far apart, seen from the LiDAR: farther ahead, or from nearly behind, such columns
hit a side many meters apart. There a vehicle ends where it was last seen to be as high as a truck, or right behind."""
_OFF_SIDE_M = 0.5  # Such columns lie at most this far off the side that is seen
_HIGH_M = 2.0  # No car is as high above the ground
_ASIDE_M = 0.3  # Points of a vehicle lie at most this far beside the box that what is seen of it was completed to
_LONGEST_M = 18.0  # No vehicle is longer
_MOST = 0.8  # A cluster of which at least this share lies where the vehicle goes on is a part of it
_SOLID = ("car", "van", "truck")  # What doesn't look like a column of points, as people and two-wheelers do
_ROUNDS = 3  # The more of a side is known, the better its heading, and the more of it is found
_TURN_RAD = np.radians(np.arange(-10.0, 10.5, 1.0))


class _Box(NamedTuple):
    center_m: Float64  # (2,) [m]
    size_lw_m: Float64  # (2,) [m]
    yaw_rad: float


def with_whole_trucks(view: LidarView, viewpoint: Float64) -> LidarView:
    """Let trucks and buses take what continues them away from the viewer at `viewpoint` (2,), the likeliest first.

    Beams that graze a side hit it farther and farther apart, until each column of them is a cluster of its own. A
    cluster is taken if nearly all of it lies in line with the vehicle and no gap is wider than such columns are apart,
    unless it looks more like a vehicle itself. Boxes get as long as what they took.
    """
    boxes = view.boxes
    if boxes.label is None or boxes.score is None:
        return view
    score, owner = boxes.score, np.arange(len(boxes))
    center, size, yaw = boxes.center_m.copy(), boxes.size_lwh_m.copy(), boxes.yaw_rad.copy()
    rows = np.flatnonzero((boxes.label == _LABEL) & (score >= _LEAST_SCORE))
    if not len(rows):
        return view
    high = np.zeros(len(view.xyz), np.bool_)  # points (N,) of something as high as a truck
    if view.plane is not None:
        height, top = view.xyz[:, 2] - view.plane.z_m(view.xyz[:, :2]), np.zeros(len(boxes) + 1)
        np.maximum.at(top, view.cluster, np.where(view.cluster >= 0, height, 0.0))
        high = top[view.cluster] > _HIGH_M
    for at in rows[np.lexsort((rows, -score[rows]))].tolist():
        box = _Box(center[at, :2], size[at, :2], float(yaw[at]))
        for _ in range(_ROUNDS if owner[at] == at else 0):
            taken = _take_points(view, owner, at, _strip(view, high, view.cluster == at, box, viewpoint))
            if not taken.any():
                break
            owner[taken[owner]] = at
            # Around all its points, turned at most a little and at least as large as before.
            xy = np.ascontiguousarray(view.xyz[(view.cluster >= 0) & (owner[view.cluster] == at), :2])
            rectangle = fit_rectangles(xy, np.array([0, len(xy)]), box.yaw_rad + _TURN_RAD, NEAR_M)
            whole = complete_known(rectangle, np.ones(1, np.bool_), viewpoint, box.size_lw_m)
            box = _Box(whole.center_m[0], whole.size_lw_m[0], float(whole.yaw_rad[0]))
        center[at, :2], size[at, :2], yaw[at] = box
    # Clusters are numbered anew without those that were taken; points stay sorted by cluster.
    kept = np.flatnonzero(owner == np.arange(len(owner)))
    cluster, clustered = np.full(len(view.cluster), -1), view.cluster >= 0
    cluster[clustered] = np.searchsorted(kept, owner)[view.cluster[clustered]]
    order = np.argsort(cluster, kind="stable")
    whole_boxes = replace(boxes, center_m=center, size_lwh_m=size, yaw_rad=yaw)
    return LidarView(view.plane, view.xyz[order], cluster[order], whole_boxes[kept])


def _strip(view: LidarView, high: Bool, own: Bool, box: _Box, viewpoint: Float64) -> Bool:
    """Tell which points (N,) lie where a vehicle is or goes on; `own` are its to begin with, `high` what may be a
    truck's.
    """
    axis = np.array([np.cos(box.yaw_rad), np.sin(box.yaw_rad)])
    if (box.center_m - viewpoint) @ axis < 0:
        axis = -axis
    left = np.array([-axis[1], axis[0]])
    along, across = (view.xyz[:, :2] - viewpoint) @ axis, (view.xyz[:, :2] - viewpoint) @ left
    near, far = float(along[own].min()), float(along[own].max())
    beside = np.abs(across - (box.center_m - viewpoint) @ left) < box.size_lw_m[1] / 2 + _ASIDE_M
    rows = np.flatnonzero(beside & (along > far) & (along < near + _LONGEST_M))
    side = across[own][np.argmin(np.abs(across[own]))] * float((across[own] > 0).all() or (across[own] < 0).all())
    on_side = (np.abs(across[rows] - side) < _OFF_SIDE_M) & (side != 0)
    order = np.lexsort((~high[rows], ~on_side, along[rows]))
    end = _end(along[rows][order], on_side[order], high[rows][order], far, float(side))
    return np.asarray(beside & (along >= near) & (along <= end), np.bool_)


def _end(along: Float64, on_side: Bool, high: Bool, far: float, side: float) -> float:
    """Where a vehicle that was seen up to `far` ends [m], by points (N,) from there on.

    It goes on over gaps up to `_GAP_M`, or along its side over those between neighboring columns. Behind the first of
    these it ends that near to the last point that is high. What is seen through it doesn't matter.
    """
    last = end = last_high = far
    has_jumped = False
    for at, is_side, is_high in zip(along.tolist(), on_side.tolist(), high.tolist(), strict=True):
        turn = abs(np.arctan2(side, last) - np.arctan2(side, at))
        if at - last <= _GAP_M or (is_side and turn <= _COLUMN_RAD):
            has_jumped |= at - last > _GAP_M
            last, last_high = at, at if is_high else last_high
            end = at if is_high or at - (last_high if has_jumped else end) <= _GAP_M else end
        elif is_side:
            break
    return end


def _take_points(view: LidarView, owner: Int64, at: int, inside: Bool) -> Bool:
    """Tell which clusters (K,) belong to a vehicle."""
    boxes, num = view.boxes, len(view.boxes)
    clustered = view.cluster >= 0
    total = np.bincount(view.cluster[clustered], minlength=num)
    share = np.bincount(view.cluster[clustered & inside], minlength=num) / np.maximum(total, 1)
    free = (owner == np.arange(num)) & (np.arange(num) != at)
    if boxes.label is None or boxes.score is None:
        return np.zeros(num, np.bool_)
    itself = np.isin(boxes.label, _SOLID) & (boxes.score > boxes.score[at])
    return np.asarray((share >= _MOST) & free & ~itself, np.bool_)


class LidarStage:
    """Remembers how the ground lies, for frames in which no LiDAR tells, and how the body moves."""

    def __init__(self, rig: Rig, log_info: LogInfo, params: LidarParams, settings: SensorSettings) -> None:
        self._rig, self._params = rig, judging(params, log_info)
        self.labeled = self._params.judge == "model"  # Whether boxes have labels
        own = settings.own("lidar", params, OWN)
        self._ranges_m = {name: (p.min_range_m, p.max_range_m or np.inf) for name, p in own.items()}
        self._own = Outline(params.ego_front_m, params.ego_rear_m, params.ego_side_m)
        self._deskew = Deskew(log_info) if params.deskew else None
        self._viewpoint = viewpoint(rig, "lidar")
        self.reset()

    def reset(self) -> None:
        """Forget how the ground lies, and how the body moves."""
        self._plane: Plane | None = None
        if self._deskew is not None:
            self._deskew.reset()

    def view(self, frame: Frame, clock: StageClock) -> LidarView:
        """Detect in the points of one frame; without points nothing is seen but the remembered ground."""
        points = self.points(frame, clock)
        if points is None:
            return LidarView(self._plane, np.zeros((0, 3)), np.zeros(0, np.int64), Boxes3D.empty())
        return self.detect(points, clock)

    def detect(self, points: Float64, clock: StageClock) -> LidarView:
        """Detect in points as `points` gives them."""
        found = self.obstacles(points, clock)
        with clock.stage("detect.lidar"):
            seen = lidar_detect(found, self._viewpoint, self._params)
            return replace(with_whole_trucks(seen, self._viewpoint), plane=self._plane)

    def points(self, frame: Frame, clock: StageClock) -> Float64 | None:
        """Points (N, 3) [m] of all LiDARs in body coordinates at the frame's instant that don't lie on the own vehicle,
        in lexicographic order; `None` where no LiDAR delivered.
        """
        with clock.stage("calibrate"):
            return lidar_points(self._rig, frame, self._ranges_m, self._own, self._deskew)

    def obstacles(self, points: Float64, clock: StageClock) -> Obstacles:
        """Take the ground away from points as `points` gives them, and remember it."""
        with clock.stage("preprocess"):
            found = lidar_obstacles(points, self._params)
        self._plane = found.plane or self._plane
        return found
