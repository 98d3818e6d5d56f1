"""plain2d: the thesis's algorithms in images, from which its configurations are made; see `thesis/`."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.pipelines.baseline.boxes import (
    UNKNOWN,
    Extents,
    PlainCloud,
    box_clusters,
    camera_extents,
    cluster_in_space,
    cluster_pixels,
    merge_boxes,
    no_extents,
    project_extents,
)
from fbench.pipelines.baseline.observations import KINDS, PlainSensors
from fbench.pipelines.baseline.params import (
    MORE_POINTS,
    RADAR,
    RADAR_IMAGE,
    PlainImageSensorParams,
    PlainParams,
    PlainSensor,
    Strategy,
)
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.tracking.params import Tracker2DParams
from fbench.pipelines.tracking.stage import Detected, TrackingPipeline
from fbench.pipelines.tracking.tracker2d import Tracker2D
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.boxes import Boxes2D, concatenate
from fbench.replay.data.frames import Frame
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.geometry.camera import in_image, project_body, require_projection


def _radar_params() -> PlainImageSensorParams:
    return PlainImageSensorParams(cluster=RADAR, size=MORE_POINTS, image=RADAR_IMAGE)


@dataclass(frozen=True)
class Plain2DParams(PlainParams):
    """Parameters of `plain2d`."""

    uses: tuple[PlainSensor, ...] = ("camera", "lidar", "radar")
    """Kinds of sensors: camera, lidar, radar, stereo. Points are projected into all cameras, used or not."""
    strategy: Strategy = "late"
    """`early`: points are clustered in the image; `late`: in space, and their boxes are projected. Overlapping boxes
    are merged in the order camera, LiDAR, radar, stereo.
    """
    lidar: PlainImageSensorParams = field(default_factory=PlainImageSensorParams)  # Points of LiDARs.
    radar: PlainImageSensorParams = field(default_factory=_radar_params)  # Points of radars.
    stereo: PlainImageSensorParams = field(default_factory=PlainImageSensorParams)  # Points of stereo.
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)  # The tracker, one per camera.


class Plain2D(TrackingPipeline[Boxes2D]):
    """Boxes in the images of all cameras; labeled where cameras are used."""

    def __init__(self, params: Plain2DParams = Plain2DParams()) -> None:
        super().__init__(Tracker2D(params.tracking), params.detect_every)
        self._params, self._sensors = params, PlainSensors(params)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all cameras of the rig, and the other sensors that are used. Raises ConfigError where cameras are all
        that is used, and none has weights. Raises LogError where it lacks a camera, or other sensors that are used, or
        a camera can't be projected into.
        """
        params, with_points = self._params, self._params.uses != ("camera",)
        require("plain2d", ("camera",), rig, log_info)
        if not {"camera", "stereo"} & set(params.uses):
            require("plain2d", tuple(kind for kind in KINDS if kind in params.uses), rig, log_info)
        self._images = rig.sensors("camera")
        self._sensors.start(rig, log_info)
        if not with_points and not self._sensors.cameras.used:
            raise ConfigError(
                "no detector for this log's cameras: --set camera.weights=FILE, or a name of fbench weights list"
            )
        for name in self._images if with_points else ():
            require_projection(rig, name)
        self.missing = self._sensors.cameras.missing
        super().start(rig, log_info)

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._sensors.cameras.identity

    def _detect(self, frame: Frame, clock: StageClock) -> Detected[Boxes2D]:
        seen = self._sensors.view(frame, clock)
        parts = (self._early if self._params.strategy == "early" else self._late)(seen.clouds, clock)
        with clock.stage("fuse"):
            found = concatenate([self._merge(name, seen.cameras.get(name), parts[name]) for name in self._images])
        return Detected(found, seen.faults, seen.missing)

    def _early(self, clouds: Mapping[PlainSensor, PlainCloud], clock: StageClock) -> dict[str, list[Extents]]:
        """Boxes of each kind of sensor, clustered in the image, by camera."""
        found: dict[str, list[Extents]] = {name: [] for name in self._images}
        for kind, points in clouds.items():
            own: PlainImageSensorParams = getattr(self._params, kind)
            with clock.stage(f"detect.{kind}"):
                for name, parts in found.items():
                    uv, depth = project_body(self._rig, name, points.xyz)
                    shown = in_image(self._rig.cameras[name], uv)
                    uv, depth = uv[shown], depth[shown]
                    parts.append(box_clusters(points[shown], cluster_pixels(uv, depth, own.image), uv, own.size))
        return found

    def _late(self, clouds: Mapping[PlainSensor, PlainCloud], clock: StageClock) -> dict[str, list[Extents]]:
        """Boxes of each kind of sensor, clustered in space and projected, by camera."""
        found: dict[str, list[Extents]] = {name: [] for name in self._images}
        for kind, points in clouds.items():
            own: PlainImageSensorParams = getattr(self._params, kind)
            with clock.stage(f"detect.{kind}"):
                solids = box_clusters(points, cluster_in_space(points, own.cluster), points.xyz, own.size)
                for name, parts in found.items():
                    parts.append(project_extents(solids, self._rig, name)[0])
        return found

    def _merge(self, camera: str, seen: CameraDetections | None, parts: list[Extents]) -> Boxes2D:
        first = no_extents(2) if seen is None else camera_extents(seen)
        found = merge_boxes([first, *parts], self._params.fusion.min_iou)
        return Boxes2D(
            camera=np.full(len(found), camera),
            xyxy_px=np.column_stack([found.low, found.high]),
            label=np.where(found.label == "", UNKNOWN, found.label) if self._sensors.with_camera else None,
            score=found.score,
            distance_m=found.distance_m,
            range_rate_mps=found.range_rate_mps,
            sources=found.sources,
        )
