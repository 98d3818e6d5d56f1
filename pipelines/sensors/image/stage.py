"""Detection by all LiDARs, and by all radars, in all images of a rig, timed; with cameras' boxes in one form."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fbench.pipelines.fusion.sizes import LONG_M, SIZES
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.image.objects import Cloud, Spots, of_lidar, of_radar, spots
from fbench.pipelines.sensors.image.params import (
    LidarImageParams,
    RadarImageParams,
    resolve_grouping,
    resolve_min_echoes,
)
from fbench.pipelines.sensors.lidar.clusters import LidarParams, LidarView
from fbench.pipelines.sensors.lidar.stage import LidarStage, RejectedClusters
from fbench.pipelines.sensors.odds import log_odds
from fbench.pipelines.sensors.points.grid import lexicographic_order
from fbench.pipelines.sensors.points.merged import viewpoint
from fbench.pipelines.sensors.radar.stage import Compensated, RadarParams, RadarStage, RadarView
from fbench.pipelines.sensors.rows import Rows
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.arrays import Array, Bool, Float64, Text
from fbench.replay.data.boxes import VEHICLES, Boxes2D, Boxes3D, Source, concatenate
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import CameraModel, LogInfo, Rig
from fbench.replay.geometry.camera import in_image, not_projectable, project_body, project_boxes
from fbench.replay.geometry.iou import corners

SURE = 0.5  # A camera alone reports what it believes so far
_GUESS_STD = 0.25
_EDGE_PX = 3.0
_MEASURED_STD, _MEASURED_STD_M = 0.04, 1.2  # Error of measured depths, as a share of the depth and [m]


@dataclass(frozen=True, eq=False)
class ImageObservations(Rows):
    """N boxes in one image, of one or several kinds of sensors."""

    source: Array  # (N,) uint8, one bit of `Source`
    xyxy_px: Float64  # (N, 4) left, top, right, bottom [px]
    score: Float64
    """(N,) 0 to 1: by cameras how likely each is, from `SURE` on those that a camera alone reports; by others how much
    it looks like a vehicle.
    """
    label: Text  # (N,)
    depth_m: Float64  # (N,) of the near side along the optical axis [m]; NaN where unknown
    depth_std: Float64  # (N,) relative error of the depth
    distance_m: Float64  # (N,) from the body's origin to the middle [m]; NaN where unknown
    rate_mps: Float64  # (N,) change of the distance [m/s], positive when receding; NaN where unknown
    upright: Bool  # (N,) whether its upper and lower edge are known; sparse radars don't tell heights
    exactness: Float64  # (N,) 0 to 1: how much its score counts against an exact one's; 1 but for stereo

    @property
    def weak(self) -> Bool:
        """(N,) boxes of cameras that count only where another sensor confirms them."""
        return np.asarray((self.source == int(Source.C)) & (self.score < SURE), np.bool_)

    @classmethod
    def of(
        cls, source: int, xyxy_px: Float64, score: Float64, label: Text, depth_m: Float64, std: Float64, **known: Array
    ) -> "ImageObservations":
        """Boxes (N) of one kind of sensor, of which no more is known than is given."""
        num = len(score)
        columns: dict[str, Array] = dict.fromkeys(("distance_m", "rate_mps"), np.full(num, np.nan))
        columns |= {"upright": np.ones(num, np.bool_), "exactness": np.ones(num), **known}
        return cls(np.full(num, source, np.uint8), xyxy_px, score, label, depth_m, std, **columns)

    @classmethod
    def none(cls) -> "ImageObservations":
        """Return no boxes."""
        none = np.zeros(0)
        return cls.of(0, np.zeros((0, 4)), none, none.astype("U1"), none, none)

    @classmethod
    def join(cls, parts: Sequence["ImageObservations"]) -> "ImageObservations":
        """Put several into one, by source, falling score, then place, so that the order of the parts never matters."""
        every = super().join([*parts, cls.none()])
        return every[np.lexsort((*every.xyxy_px.T[::-1], -every.score, every.source))]


def by_camera(found: CameraDetections, camera: CameraModel) -> ImageObservations:
    """What a camera sees, and at which depth an object with its label would be as tall as its box; NaN for boxes that
    the upper or lower border cuts off. Scores become probabilities, `SURE` at that from which on it reports them.
    """
    _, top, _, bottom = found.xyxy_px.T
    whole = (top > _EDGE_PX) & (bottom < camera.size_wh[1] - 1 - _EDGE_PX)
    typical = [SIZES.get(label) for label in found.label.tolist()]
    height = np.array([np.nan if size is None else size.image_height_m for size in typical], np.float64)
    depth = np.where(whole, camera.K[1, 1] * height / np.maximum(bottom - top, 1.0), np.nan)
    # Detectors mean different things by a score. The ratio of odds to those of `min_score`, which weights bring with
    # them, is taken to mean the same for all.
    score = np.asarray(1 / (1 + np.exp(log_odds(found.min_score) - log_odds(found.score))), np.float64)
    std = np.full(len(found), _GUESS_STD)
    return ImageObservations.of(Source.C, found.xyxy_px, score, found.label, depth, std)


def by_points(spots: Spots, source: Source) -> ImageObservations:
    """What LiDARs, radars or a stereo pair see in the image."""
    rows = np.flatnonzero(np.isfinite(spots.xyxy_px).all(axis=1) & (spots.score > 0))
    spots = spots[rows]
    label = np.where(spots.size_lwh_m[:, 0] > LONG_M, "truck", "car")
    known = {"distance_m": spots.distance_m, "rate_mps": spots.rate_mps}
    std = _compute_std(spots.depth_m)
    return ImageObservations.of(source, spots.xyxy_px, spots.score, label, spots.depth_m, std, **known)


def by_boxes(rig: Rig, camera: str, boxes: Boxes3D, rate_mps: Float64, source: Source) -> ImageObservations:
    """What boxes in space (N), with their changes of distance (N,) [m/s], look like in the image."""
    score = np.zeros(len(boxes)) if boxes.score is None else boxes.score
    outline, seen = project_boxes(rig, camera, boxes)
    rows = np.flatnonzero(seen & (score > 0))
    boxes, num = boxes[rows], len(rows)
    depths = project_body(rig, camera, corners(boxes).reshape(-1, 3))[1].reshape(-1, 8)
    depth = np.maximum(depths.min(axis=1, initial=np.inf), 0.5) if num else np.zeros(0)
    label = np.where(boxes.size_lwh_m[:, 0] > LONG_M, "truck", "car") if boxes.label is None else boxes.label
    known = {"distance_m": np.sqrt((boxes.center_m**2).sum(axis=1)), "rate_mps": rate_mps[rows]}
    known |= {"upright": np.full(num, source != Source.R)}
    return ImageObservations.of(source, outline[rows], score[rows], label, depth, _compute_std(depth), **known)


def _compute_std(depth_m: Float64) -> Float64:
    return np.asarray(_MEASURED_STD + _MEASURED_STD_M / np.maximum(depth_m, 1.0), np.float64)


def projectable(pipeline: str, rig: Rig, log_info: LogInfo) -> tuple[str, ...]:
    """Names of cameras that can be projected into; images aren't needed. Raises LogError saying why there is none."""
    names = rig.sensors("camera")
    if not names:
        raise LogError(f"log '{log_info.name}': {pipeline} works in images, and the rig has no camera", "CFG001")
    absent = dict.fromkeys(rig.bare, "no transform places it on the body")
    why = {
        name: not_projectable(rig.cameras[name]) if name in rig.cameras
        else f"{absent.get(name, 'the log has no intrinsics of it')}; add it with --rig"
        for name in names
    }  # fmt: skip
    good = tuple(name for name in names if why[name] is None)
    if not good:
        raise LogError(f"log '{log_info.name}': {pipeline} can't project into camera '{names[0]}': {why[names[0]]}",
                       "CAL001")  # fmt: skip
    return good


def drop_labels(seen: Mapping[str, ImageObservations], min_score: float) -> Boxes2D:
    """Boxes by camera with at least `min_score`, of each the highest first; the same fields in every frame."""
    parts = [_boxes(name, one[one.score >= min_score]) for name, one in sorted(seen.items())]
    return concatenate([*parts, _boxes("", ImageObservations.none())])


def _boxes(camera: str, seen: ImageObservations) -> Boxes2D:
    return Boxes2D(
        camera=np.full(len(seen), camera),
        xyxy_px=seen.xyxy_px,
        score=seen.score,
        distance_m=seen.distance_m,
        range_rate_mps=seen.rate_mps,
        sources=seen.source,
    )


_BEHIND_M, _BEFORE_M = 4.0, 2.0
"""Rays that end so far [m] behind the near side of an object went through it; so far before it, they count as on it."""
_GATE = 2.5  # An object may be so many standard deviations nearer or farther than its depth says
_LEAST_RAYS = 4
_INSET = 0.15  # This share of a box is left out on each side, since a box is wider than what it shows


@dataclass(frozen=True, eq=False)
class Rays:
    """All points of one kind of sensor in an image, those on the ground too; sorted by depth."""

    uv_px: Float64  # (N, 2) [px]
    depth_m: Float64  # (N,) along the optical axis [m]

    @classmethod
    def of(cls, rig: Rig, camera: str, xyz: Float64 | None) -> "Rays":
        """Project points (N, 3) in body coordinates; `None`: no sensor delivered."""
        if xyz is None:
            return cls(np.zeros((0, 2)), np.zeros(0))
        uv, depth = project_body(rig, camera, xyz)
        seen = np.flatnonzero(in_image(rig.cameras[camera], uv))
        uv, depth = uv.take(seen, axis=0), depth.take(seen)
        order = lexicographic_order(depth, *uv.T[::-1])
        return cls(uv.take(order, axis=0), depth.take(order))

    def depths(self, xyxy_px: Float64) -> Float64:
        """Depths of the points in the middle of a box (4,), ascending."""
        left, top, right, bottom = xyxy_px
        x, y = _INSET * (right - left), _INSET * (bottom - top)
        u, v = self.uv_px.T
        inside = (u > left + x) & (u < right - x) & (v > top + y) & (v < bottom - y)
        return np.asarray(self.depth_m[inside], np.float64)

    def go_through(self, xyxy_px: Float64, depth_m: float, std: float, share: float) -> bool:
        """Whether more than this share of the rays in a box (4,) [px] goes on behind the object with its near side at
        this depth [m], so that it isn't there; `std` is the relative error of that. Not where the depth is unknown.
        """
        depths, reach = self.depths(xyxy_px), float(np.exp(_GATE * std))
        if not depth_m > 0 or len(depths) < _LEAST_RAYS:
            return False
        return share_beyond(depths, depth_m / reach - _BEFORE_M, depth_m * reach + _BEHIND_M) > share


def share_beyond(depths_m: Float64, near_m: float, far_m: float) -> float:
    """Share of the rays reaching `near_m` [m] or beyond, given ascending depths (N,), that go on beyond `far_m`. NaN
    where no ray reaches that far: something hides the place, or the sensor sees nothing there.
    """
    begin, end = np.searchsorted(depths_m, [near_m, far_m])
    num = len(depths_m) - begin
    return float((len(depths_m) - end) / num) if num else np.nan


@dataclass(frozen=True, eq=False)
class InImages:
    """What one kind of sensor sees, by camera; nothing of it where no sensor delivered."""

    seen: Mapping[str, ImageObservations] = field(default_factory=dict)
    rays: Mapping[str, Rays] = field(default_factory=dict)  # All points, of LiDARs only
    in_space: LidarView | None = None  # What was projected, of LiDARs only
    is_sparse: bool | None = None  # Whether there were too few echoes for the image, of radars only
    noisy: tuple[str, ...] = ()  # Cameras whose depth is taken for noise, of a stereo pair only


class LidarInImages:
    """Clusters of LiDAR points in images, or in space, projected."""

    def __init__(
        self, rig: Rig, log_info: LogInfo, cameras: tuple[str, ...], lidar: LidarParams, image: LidarImageParams,
        settings: SensorSettings, rejected: RejectedClusters,
    ) -> None:  # fmt: skip
        lidar, self._params = resolve_grouping(lidar, image, log_info)
        self._rig, self._cameras, self._stage = rig, cameras, LidarStage(rig, log_info, lidar, settings, rejected)
        self._viewpoint, self.identity = viewpoint(rig, "lidar"), self._stage.identity

    def reset(self) -> None:
        """Forget how the ground lies, and how the body moves."""
        self._stage.reset()

    def note_pose(self, frame: Frame) -> None:
        """Take the pose of a frame whose points are looked at elsewhere."""
        self._stage.note_pose(frame)

    def remember(self, seen: InImages) -> None:
        """Count what was rejected; once for each frame."""
        if seen.in_space is not None:
            self._stage.remember(seen.in_space)

    def warnings(self) -> tuple[Fault, ...]:
        """Say where nearly all clusters in space were rejected."""
        return self._stage.warnings()

    def view(self, frame: Frame, clock: StageClock) -> InImages:
        """Detect in the points of one frame."""
        return self.detect(self.points(frame, clock), clock)

    def points(self, frame: Frame, clock: StageClock) -> Float64 | None:
        """All points (N, 3) of one frame in body coordinates [m]; `None` where no LiDAR delivered."""
        return self._stage.points(frame, clock)

    def detect(self, xyz: Float64 | None, clock: StageClock) -> InImages:
        """Detect in such points."""
        if xyz is None:
            return InImages()
        obstacles = self._stage.obstacles(xyz, clock)
        with clock.stage("detect.lidar"):
            if self._params.grouping == "space":
                found = self._project(self._stage.detect(obstacles))
            else:
                cloud = of_lidar(obstacles, self._viewpoint)
                found = _find_spots(self._rig, self._cameras, cloud, Source.L, self._params)
            return replace(found, rays={name: Rays.of(self._rig, name, xyz) for name in self._cameras})

    def _project(self, view: LidarView) -> InImages:
        """Project boxes of vehicles."""
        boxes, unknown = view.boxes, np.full(len(view.boxes), np.nan)
        if boxes.label is not None and boxes.score is not None:
            boxes = replace(boxes, score=np.where(np.isin(boxes.label, VEHICLES), boxes.score, 0.0))
        seen = {name: by_boxes(self._rig, name, boxes, unknown, Source.L) for name in self._cameras}
        return InImages(seen, in_space=view)


class SparseFrames:
    """Counts frames of one log, and those with too few echoes."""

    def __init__(self) -> None:
        self._log_info: LogInfo | None = None

    def begin(self, log_info: LogInfo) -> None:
        """Begin with a log, or go on with it where its rig changed."""
        if log_info != self._log_info:
            self._log_info, self.num, self.num_sparse = log_info, 0, 0

    def count(self, is_sparse: bool) -> None:
        """Take in a frame."""
        self.num, self.num_sparse = self.num + 1, self.num_sparse + is_sparse


class RadarInImages:
    """Clusters of radar echoes in images; of sparse radars what they see in space, projected."""

    def __init__(
        self, rig: Rig, log_info: LogInfo, cameras: tuple[str, ...], stage: RadarStage, params: RadarParams,
        image: RadarImageParams, sparse: SparseFrames,
    ) -> None:  # fmt: skip
        self._rig, self._cameras, self._stage, self._radar, self._image = rig, cameras, stage, params, image
        self._min_echoes = resolve_min_echoes(image.min_echoes, log_info)
        self._viewpoint, self._sparse = viewpoint(rig, "radar"), sparse
        sparse.begin(log_info)

    def remember(self, seen: InImages) -> None:
        """Count whether there were too few echoes; once for each frame."""
        if seen.is_sparse is not None:
            self._sparse.count(seen.is_sparse)

    def warnings(self) -> tuple[Fault, ...]:
        """Say where most frames since the start had too few echoes."""
        num, num_sparse = self._sparse.num, self._sparse.num_sparse
        if 2 * num_sparse <= num:
            return ()
        text = (
            f"radar: fewer than {self._min_echoes} echoes in {num_sparse} of {num} frames "
            "(radar_image.min_echoes); radar3d shows what it finds in space"
        )
        return (Fault("PRD006", text),)

    def view(self, frame: Frame, clock: StageClock) -> InImages:
        """Detect in the echoes of one frame."""
        echoes = self._stage.echoes(frame, clock)
        if echoes is None:
            return InImages()
        with clock.stage("preprocess"):
            enough = echoes if len(echoes.xyz) >= self._min_echoes else None
            cloud = of_radar(enough, self._viewpoint, self._radar.min_speed_mps, self._image)
        if cloud.plane is not None:
            with clock.stage("detect.radar"):
                return replace(_find_spots(self._rig, self._cameras, cloud, Source.R, self._image), is_sparse=False)
        view = self._stage.detect(echoes, clock)
        with clock.stage("detect.radar"):
            rate = relative_rates(view, echoes)
            seen = {name: by_boxes(self._rig, name, view.boxes, rate, Source.R) for name in self._cameras}
            return InImages(seen, is_sparse=True)


def _find_spots(
    rig: Rig, cameras: tuple[str, ...], cloud: Cloud, source: Source, params: LidarImageParams | RadarImageParams
) -> InImages:
    """Detect in a cloud over the ground."""
    return InImages({name: by_points(spots(rig, name, cloud, params), source) for name in cameras})


def relative_rates(view: RadarView, echoes: Compensated) -> Float64:
    """Change of the distance (M,) [m/s] of each of a view's boxes, positive when receding; NaN where unknown. That is
    its velocity along the line of sight over ground, less the radar's own.
    """
    result = np.full(len(view.boxes), np.nan)
    for at, velocity in enumerate([] if view.boxes.velocity_mps is None else view.boxes.velocity_mps):
        rows = view.cluster == at
        own = echoes.own_mps[rows]
        if np.isfinite(own).any():
            ray = np.nanmedian(view.xyz[rows], axis=0)[:2]
            along = velocity[:2] @ ray / max(float(np.hypot(*ray)), 1e-9)
            result[at] = along - np.nanmedian(own)
    return result
