"""plain3d: the thesis's algorithms in space, from which its configurations are made; see `thesis/`."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fbench.pipelines.camera.cameras_stage import CameraStage
from fbench.pipelines.camera.detector import CameraDetections, CameraParams
from fbench.pipelines.plain.clusters import Cloud, boxes, one_cloud, space_clusters
from fbench.pipelines.plain.extents import Extents, no_extents
from fbench.pipelines.plain.labels import UNKNOWN, cluster_labels, named, painted, solid, with_camera
from fbench.pipelines.plain.merge import merged
from fbench.pipelines.plain.params import (
    MORE_POINTS,
    RADAR,
    PlainClusterParams,
    PlainFusionParams,
    PlainSensor,
    PlainSensorParams,
    PlainSizeParams,
    Strategy,
    require_uses,
)
from fbench.pipelines.plain.sensors import KINDS, Crops, PointSensors
from fbench.pipelines.points.merged import require, world_T_body
from fbench.pipelines.rhythm import Rhythm, predicted
from fbench.pipelines.stages import StageClock
from fbench.pipelines.stereo.params import StereoParams
from fbench.pipelines.tracking.tracker3d import Tracker3D, Tracker3DParams
from fbench.pipelines.weights.named import resolve_settings
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Fault, Frame, LogInfo, Output, Rig
from fbench.replay.errors import ConfigError
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True)
class Plain3DParams:
    """Parameters of `plain3d`."""

    uses: tuple[PlainSensor, ...] = ("camera", "lidar", "radar")
    """Kinds of sensors: camera, lidar, radar, stereo. Cameras only name what the others place."""
    strategy: Strategy = "late"
    """`early`: the points of all are clustered together; `late`: those of each kind, and overlapping boxes are merged
    in the order LiDAR, radar, stereo.
    """
    camera: CameraParams = field(default_factory=CameraParams)
    """Detection by camera."""
    lidar: PlainSensorParams = field(default_factory=PlainSensorParams)
    """Points of LiDARs."""
    radar: PlainSensorParams = field(default_factory=lambda: PlainSensorParams(cluster=RADAR, size=MORE_POINTS))
    """Points of radars."""
    stereo: PlainSensorParams = field(default_factory=PlainSensorParams)
    """Points of stereo."""
    depth: StereoParams = field(default_factory=StereoParams)
    """How stereo gives depth."""
    cluster: PlainClusterParams = field(default_factory=PlainClusterParams)
    """With `early`: how the points of all are grouped."""
    size: PlainSizeParams = field(default_factory=lambda: MORE_POINTS)
    """With `early`: which clusters are dropped."""
    fusion: PlainFusionParams = field(default_factory=PlainFusionParams)
    """How boxes of several sensors become one."""
    tracking: Tracker3DParams = field(default_factory=Tracker3DParams)
    """The tracker."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one camera, by its name: `--set front_left.min_score=0.3` goes before `camera.min_score`."""

    def __post_init__(self) -> None:
        require_uses(self.uses, self.detect_every)
        if self.uses == ("camera",):
            raise ConfigError("uses: a camera alone places nothing in space; name lidar, radar or stereo too")
        object.__setattr__(self, "by_sensor", resolve_settings(self.by_sensor))


class Plain3D:
    """Boxes along the axes in space, from clusters of points; labelled where cameras are used."""

    def __init__(self, params: Plain3DParams = Plain3DParams()) -> None:
        self._params, self._with_camera = params, "camera" in params.uses
        self._cameras = CameraStage(params.camera)
        self._tracker, self._rhythm = Tracker3D(params.tracking), Rhythm(params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take the sensors of the rig that are used.

        Raises:
            LogError: where it has none but cameras, or a camera that is to be used can't be projected into.
        """
        params = self._params
        if "stereo" not in params.uses:
            require("plain3d", tuple(kind for kind in KINDS if kind in params.uses), rig, log_info)
        self._rig = rig
        settings = SensorSettings(params, rig)
        for kind in KINDS:  # whose points have common parameters
            settings.own(kind, getattr(params, kind), ())
        if self._with_camera:
            self._cameras.start(rig, log_info, settings)
            self._cameras.require_projections()
        crops = Crops(params.lidar.crop, params.radar.crop, params.stereo.crop)
        self._sensors = PointSensors(rig, log_info, params.uses, crops, params.depth)
        self.reset("start")

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._cameras.identity

    def reset(self, reason: str) -> None:
        """Forget all tracks."""
        self._tracker.reset()
        self._rhythm.reset()

    def step(self, frame: Frame) -> Output:
        """Detect, merge and track; what a missing sensor would have given isn't there."""
        pose, missing = world_T_body(self._rig, frame), dict(self._cameras.missing)
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns, pose), missing)
        clock, faults = StageClock(), list[Fault]()
        cameras = self._cameras.view(frame, clock, faults)
        clouds = self._sensors.clouds(frame, clock, faults, missing)
        found = (self._early if self._params.strategy == "early" else self._late)(clouds, cameras, clock)
        detections = self._reported(found)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns, pose)
        return Output(detections, tracks, clock.stage_ns, tuple(faults), missing)

    def _early(
        self, clouds: Mapping[PlainSensor, Cloud], cameras: Mapping[str, CameraDetections], clock: StageClock
    ) -> Extents:
        params, points = self._params, one_cloud(list(clouds.values()))
        with clock.stage("fuse"):
            cluster = space_clusters(points, params.cluster)
            label = cluster_labels(cluster, painted(points.xyz, self._rig, cameras), params.fusion.label_share)
            found = boxes(points, cluster, points.xyz, params.size, label)
            return replace(found, sources=with_camera(found.sources, found.label))

    def _late(
        self, clouds: Mapping[PlainSensor, Cloud], cameras: Mapping[str, CameraDetections], clock: StageClock
    ) -> Extents:
        parts = [no_extents(3)]
        for kind, points in clouds.items():
            own = getattr(self._params, kind)
            with clock.stage(f"detect.{kind}"):
                parts.append(boxes(points, space_clusters(points, own.cluster), points.xyz, own.size))
        with clock.stage("fuse"):
            min_iou = self._params.fusion.min_iou
            return named(merged(parts, min_iou), self._rig, cameras, min_iou)

    def _reported(self, found: Extents) -> Boxes3D:
        label = np.where(found.label == "", UNKNOWN, found.label) if self._with_camera else None
        return replace(
            solid(found), label=label, score=found.score, sources=found.sources,
            velocity_mps=np.full((len(found), 3), np.nan),
        )  # fmt: skip
