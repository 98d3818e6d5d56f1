"""plain2d: the thesis's algorithms in images, from which its configurations are made; see `thesis/`."""

from dataclasses import dataclass, field

import numpy as np

from fbench.pipelines.baseline import boxes
from fbench.pipelines.baseline.boxes import KINDS, Extents, PlainCloud, PlainSensors
from fbench.pipelines.baseline.params import RADAR_IMAGES, PlainImageSensorParams, PlainParams, PlainSensor, Strategy
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.tracking.params import Tracker2DParams
from fbench.pipelines.tracking.stage import Detected, TrackingPipeline
from fbench.pipelines.tracking.trackers import Tracker2D
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.boxes import Boxes2D, concatenate
from fbench.replay.data.frames import Frame
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.geometry.camera import in_image, project_body, require_projection


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
    radar: PlainImageSensorParams = RADAR_IMAGES  # Points of radars.
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
        self.missing, self.weights = self._sensors.cameras.missing, self._sensors.cameras.identity
        super().start(rig, log_info)

    def required_sensors(self) -> tuple[str, ...]:
        """The sensors that the parameters name, but cameras without weights."""
        return self._sensors.required

    def _detect(self, frame: Frame, clock: StageClock) -> Detected[Boxes2D]:
        seen = self._sensors.view(frame, clock)
        find = self._cluster_in_images if self._params.strategy == "early" else self._cluster_in_space
        parts: dict[str, list[Extents]] = {name: [] for name in self._images}
        for kind, points in seen.clouds.items():
            with clock.stage(f"detect.{kind}"):
                for name, part in find(points, getattr(self._params, kind)).items():
                    parts[name].append(part)
        with clock.stage("fuse"):
            merged = concatenate([self._merge(name, seen.cameras.get(name), parts[name]) for name in self._images])
        return Detected(merged, seen.faults, seen.missing)

    def _cluster_in_images(self, points: PlainCloud, params: PlainImageSensorParams) -> dict[str, Extents]:
        found = {}
        for name in self._images:
            uv, depth = project_body(self._rig, name, points.xyz)
            shown = in_image(self._rig.cameras[name], uv)
            uv, depth = uv[shown], depth[shown]
            cluster = boxes.cluster_pixels(uv, depth, params.image)
            found[name] = boxes.box_clusters(points[shown], cluster, uv, params.size)
        return found

    def _cluster_in_space(self, points: PlainCloud, params: PlainImageSensorParams) -> dict[str, Extents]:
        cluster = boxes.cluster_in_space(points, params.cluster)
        solids = boxes.box_clusters(points, cluster, points.xyz, params.size, oriented=self._params.oriented)
        return {name: boxes.project_extents(solids, self._rig, name)[0] for name in self._images}

    def _merge(self, camera: str, seen: CameraDetections | None, parts: list[Extents]) -> Boxes2D:
        first = boxes.no_extents(2) if seen is None else boxes.camera_extents(seen)
        found = boxes.merge_boxes([first, *parts], self._params.fusion.min_iou)
        return Boxes2D(
            camera=np.full(len(found), camera),
            xyxy_px=np.column_stack([found.low, found.high]),
            label=np.where(found.label == "", boxes.UNKNOWN, found.label) if self._sensors.with_camera else None,
            score=found.score,
            distance_m=found.distance_m,
            range_rate_mps=found.range_rate_mps,
            sources=found.sources,
        )
