"""Detection by LiDARs, by clusters or by a network in their points; timed."""

from dataclasses import replace

import numpy as np

from fbench.pipelines.sensors.bev.detector import (
    Detector,
    describe_weights,
    is_of_other_world,
    open_detector,
    warn_of_other_world,
)
from fbench.pipelines.sensors.bev.grid import NO_RADAR, BevPoints, radar_rows
from fbench.pipelines.sensors.lidar.clusters import (
    OWN,
    LidarParams,
    LidarView,
    Obstacles,
    complete_trucks,
    detect,
    obstacles,
    resolve_judge,
)
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.points.merged import Deskew, Outline, body_pose, lidar_points, viewpoint
from fbench.pipelines.sensors.radar.stage import Compensated
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import LogInfo, Rig

_LARGE_M = ((1.3, 6.0), (0.5, 2.6), (0.9, 2.3))  # Length, width and top of what is as large as a car [m], from and to
_LOW_M = 0.8  # It begins at most so high above the ground [m]
_LEAST_POINTS, _LEAST_CLUSTERS = 30, 20  # Fewer say nothing
_ACCEPTED, _LEAST_ACCEPTED = 0.5, 0.1
"""Clusters with this score are accepted. Of those as large as a car a tenth at least is: on real recordings 14% and
more, whoever judges."""


class RejectedClusters:
    """Counts clusters of one log as large as a car, with enough points to tell, and those of them that are taken for
    none.
    """

    def __init__(self) -> None:
        self._log_info: LogInfo | None = None

    def begin(self, log_info: LogInfo) -> None:
        """Begin with a log, or go on with it where its rig changed."""
        if log_info != self._log_info:
            self._log_info, self._num, self._num_rejected = log_info, 0, 0

    def count(self, view: LidarView) -> None:
        """Take in the clusters of one frame."""
        if view.plane is None or view.boxes.score is None or not len(view.boxes):
            return
        first = np.searchsorted(view.cluster, np.arange(len(view.boxes) + 1))
        num, begin, points = np.diff(first), first[:-1] - first[0], view.xyz[first[0] :]
        yaw = np.repeat(view.boxes.yaw_rad, num)
        along = points[:, 0] * np.cos(yaw) + points[:, 1] * np.sin(yaw)
        across = points[:, 1] * np.cos(yaw) - points[:, 0] * np.sin(yaw)
        height = points[:, 2] - view.plane.z_m(points)
        low, high = (
            np.stack([reduce.reduceat(values, begin) for values in (along, across, height)])
            for reduce in (np.minimum, np.maximum)
        )
        extent = np.sort(high[:2] - low[:2], axis=0)[::-1]
        is_large = (num >= _LEAST_POINTS) & (low[2] < _LOW_M)
        for values, (least, most) in zip((*extent, high[2]), _LARGE_M, strict=True):
            is_large &= (values > least) & (values < most)
        self._num += int(np.count_nonzero(is_large))
        self._num_rejected += int(np.count_nonzero(is_large & (view.boxes.score < _ACCEPTED)))

    def warnings(self, judge: str | None) -> tuple[Fault, ...]:
        """One where nearly all were rejected."""
        accepted = self._num - self._num_rejected
        if self._num < _LEAST_CLUSTERS or accepted >= _LEAST_ACCEPTED * self._num:
            return ()
        text = (
            f"lidar: {self._num_rejected} of {self._num} car-sized clusters of at least {_LEAST_POINTS} points "
            f"were rejected; if they are vehicles, try --set lidar.judge={'both' if judge == 'model' else 'model'}"
        )
        return (Fault("PRD005", text),)


_IN_M = 0.2  # Points so far beside a box are still in it
_LATTICE = 0.3 * np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 1)])
"""Points in a box, as shares of its size from the middle: boxes of cameras hold some of them, even of what is hidden"""


def detect_learned(network: Detector, found: Obstacles, echoes: Compensated | None, least: float) -> LidarView:
    """Take what lies in the boxes of the network with at least the score `least` for clusters. Boxes in which neither
    points nor echoes lie are left out; the others say as sources which of both do.

    A box of echoes alone gets a few points inside it, so that it is where the network puts it: many radars measure no
    heights, and a handful of echoes shows no shape.
    """
    if found.plane is None:
        return LidarView(None, found.xyz, np.full(len(found.xyz), -1), Boxes3D.empty(), learned=True)
    radar, echo_xyz = NO_RADAR, np.zeros((0, 3))
    if echoes is not None:
        echo_xyz = echoes.xyz
        radar = radar_rows(echo_xyz, echo_xyz[:, 2] - found.plane.z_m(echo_xyz), echoes.range_rate_mps)
    boxes = network.detect(BevPoints(found.rows, radar), found.plane, least)
    inside = _boxes_around(found.xyz, boxes)
    has_points, has_echoes = (
        np.isin(np.arange(len(boxes)), numbers) for numbers in (inside, _boxes_around(echo_xyz, boxes))
    )
    by_echoes, kept = np.flatnonzero(has_echoes & ~has_points), np.flatnonzero(has_points | has_echoes)
    xyz = np.concatenate([found.xyz, _inner_points(boxes[by_echoes])])
    cluster = np.concatenate([inside, np.repeat(by_echoes, len(_LATTICE))])
    cluster[cluster >= 0] = np.searchsorted(kept, cluster[cluster >= 0])
    order = np.argsort(cluster, kind="stable")
    sources = (int(Source.L) * has_points + int(Source.R) * has_echoes).astype(np.uint8)
    boxes = replace(boxes[kept], velocity_mps=None, sources=sources[kept])
    return LidarView(found.plane, xyz[order], cluster[order], boxes, learned=True, with_echoes=echoes is not None)


def _inner_points(boxes: Boxes3D) -> Float64:
    """Points (18 N, 3) [m] in boxes (N), box by box; see `_LATTICE`."""
    along, across, up = np.moveaxis(_LATTICE * boxes.size_lwh_m[:, None, :], 2, 0)
    cos, sin = np.cos(boxes.yaw_rad)[:, None], np.sin(boxes.yaw_rad)[:, None]
    offset = np.stack([along * cos - across * sin, along * sin + across * cos, up], axis=2)
    return np.asarray((boxes.center_m[:, None, :] + offset).reshape(-1, 3), np.float64)


def _boxes_around(xyz: Float64, boxes: Boxes3D) -> Int64:
    """Number (N,) of the first of `boxes` around each of points (N, 3), as seen from above; -1 outside all."""
    numbers = np.full(len(xyz), -1)
    half = boxes.size_lwh_m[:, :2] / 2 + _IN_M
    for number in range(len(boxes) - 1, -1, -1):  # the surest last, which then has them
        offset, yaw = xyz[:, :2] - boxes.center_m[number, :2], boxes.yaw_rad[number]
        along = np.abs(offset @ np.array([np.cos(yaw), np.sin(yaw)]))
        across = np.abs(offset @ np.array([-np.sin(yaw), np.cos(yaw)]))
        numbers[(along < half[number, 0]) & (across < half[number, 1])] = number
    return numbers


class LidarStage:
    """Remembers how the ground lies, for frames in which no LiDAR tells, and how the body moves; `rejected` what it
    counted before the rig changed.
    """

    def __init__(
        self, rig: Rig, log_info: LogInfo, params: LidarParams, settings: SensorSettings,
        rejected: RejectedClusters | None = None,
    ) -> None:  # fmt: skip
        self._rig, self._params = rig, resolve_judge(params, log_info)
        is_learned = params.detector == "learned"
        self._network = open_detector(params.network) if is_learned else None
        self.identity = describe_weights(params.network) if is_learned else {}
        """Which weights are used, where no parameter names them"""
        self._warned = warn_of_other_world(params.network, log_info) if is_learned else ()
        is_deaf = params.network.sensors is None and is_of_other_world(params.network, log_info)
        self.takes_echoes = self._network is not None and self._network.sensors == "both" and not is_deaf
        """Whether `view` can use echoes of radars"""
        self.judge = self._params.judge if self._network is None else "model"
        self.labeled = self.judge != "rules"  # Whether boxes have labels
        own = settings.own("lidar", params, OWN)
        self._ranges_m = {name: (p.min_range_m, p.max_range_m or np.inf) for name, p in own.items()}
        self._own = Outline(params.ego_front_m, params.ego_rear_m, params.ego_side_m)
        self._deskew = Deskew(log_info) if params.deskew else None
        self._viewpoint, self._rejected = viewpoint(rig, "lidar"), rejected or RejectedClusters()
        self._rejected.begin(log_info)
        self.reset()

    def reset(self) -> None:
        """Forget how the ground lies, and how the body moves."""
        self._plane: Plane | None = None
        if self._deskew is not None:
            self._deskew.reset()

    def note_pose(self, frame: Frame) -> None:
        """Take the pose of a frame whose points are looked at elsewhere."""
        if self._deskew is not None:
            self._deskew.note(body_pose(self._rig, frame), frame.stamp_ns)

    def view(self, frame: Frame, clock: StageClock, echoes: Compensated | None = None) -> LidarView:
        """Detect in the points of one frame, and in `echoes` of it, see `takes_echoes`; without points nothing is seen.
        See `remember`.
        """
        points = self.points(frame, clock)
        if points is None:
            return LidarView(None, np.zeros((0, 3)), np.zeros(0, np.int64), Boxes3D.empty())
        found = self.obstacles(points, clock)
        with clock.stage("detect.lidar"):
            return self.detect(found, echoes)

    def detect(self, found: Obstacles, echoes: Compensated | None = None) -> LidarView:
        """Detect in obstacles as `obstacles` gives them, and in echoes, see `takes_echoes`."""
        if self._network is not None:
            network = self._params.network
            view = detect_learned(self._network, found, echoes if self.takes_echoes else None, network.min_score)
            # What it doesn't report may be of a class that wasn't asked for.
            return replace(view, with_echoes=view.with_echoes and not network.classes)
        return complete_trucks(detect(found, self._viewpoint, self._params), self._viewpoint[:2])

    def remember(self, view: LidarView) -> LidarView:
        """Count what was rejected in a view, and return it with the ground that was seen last; once for each view, in
        the order of frames.
        """
        if self._network is None and view.plane is not None:
            self._rejected.count(view)
        self._plane = view.plane or self._plane
        return replace(view, plane=self._plane)

    def warnings(self) -> tuple[Fault, ...]:
        """Say where nearly all clusters since the start were rejected, or the network is of another world."""
        return self._warned or self._rejected.warnings(self.judge)

    def points(self, frame: Frame, clock: StageClock) -> Float64 | None:
        """Points (N, 3) [m] of all LiDARs but on the own vehicle, see `lidar_points`; `None` without any LiDAR."""
        with clock.stage("calibrate"):
            return lidar_points(self._rig, frame, self._ranges_m, self._own, self._deskew)

    def obstacles(self, points: Float64, clock: StageClock) -> Obstacles:
        """Take the ground away from points as `points` gives them."""
        with clock.stage("preprocess"):
            return obstacles(points, self._params)
