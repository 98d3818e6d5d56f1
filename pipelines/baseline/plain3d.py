"""plain3d: the thesis's algorithms in space, from which its configurations are made; see `thesis/`."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fbench.pipelines.baseline import boxes
from fbench.pipelines.baseline import params as plain
from fbench.pipelines.baseline.boxes import KINDS, Extents, PlainCloud, PlainSensors
from fbench.pipelines.baseline.params import PlainParams, PlainSensor, Strategy
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.tracking.params import Tracker3DParams
from fbench.pipelines.tracking.stage import Detected, TrackingPipeline
from fbench.pipelines.tracking.trackers import Tracker3D
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True)
class Plain3DParams(PlainParams):
    """Parameters of `plain3d`."""

    uses: tuple[PlainSensor, ...] = ("camera", "lidar", "radar")
    """Kinds of sensors: camera, lidar, radar, stereo. Cameras only name what the others place."""
    strategy: Strategy = "late"
    """`early`: the points of all are clustered together; `late`: those of each kind, and overlapping boxes are merged
    in the order LiDAR, radar, stereo.
    """
    cluster: plain.PlainClusterParams = field(default_factory=plain.PlainClusterParams)
    """With `early`: how the points of all are grouped; those of single kinds mean nothing then."""
    size: plain.PlainSizeParams = plain.RADAR.size  # With `early`: which clusters are dropped.
    tracking: Tracker3DParams = field(default_factory=Tracker3DParams)  # The tracker.

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.uses == ("camera",):
            raise ConfigError("uses: a camera alone places nothing in space; name lidar, radar or stereo too")


class Plain3D(TrackingPipeline[Boxes3D]):
    """Boxes in space, from clusters of points; labeled where cameras are used."""

    def __init__(self, params: Plain3DParams = Plain3DParams()) -> None:
        super().__init__(Tracker3D(params.tracking), params.detect_every)
        self._params, self._sensors = params, PlainSensors(params)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take the sensors. Raises LogError where there are none but cameras, or a used one has no projection."""
        uses = self._params.uses
        if "stereo" not in uses:
            require("plain3d", tuple(kind for kind in KINDS if kind in uses), rig, log_info)
        self._sensors.start(rig, log_info)
        self._sensors.cameras.require_projections()
        self.missing, self.weights = self._sensors.cameras.missing, self._sensors.cameras.identity
        super().start(rig, log_info)

    def required_sensors(self) -> tuple[str, ...]:
        """The sensors that the parameters name, but cameras without weights."""
        return self._sensors.required

    def _detect(self, frame: Frame, clock: StageClock) -> Detected[Boxes3D]:
        seen = self._sensors.view(frame, clock)
        find = self._early if self._params.strategy == "early" else self._late
        found = find(seen.clouds, seen.cameras, clock)
        result = replace(
            boxes.to_solid(found),
            label=np.where(found.label == "", boxes.UNKNOWN, found.label) if self._sensors.with_camera else None,
            score=found.score,
            sources=found.sources,
            velocity_mps=np.full((len(found), 3), np.nan),
        )
        return Detected(result, seen.faults, seen.missing)

    def _early(
        self, clouds: Mapping[PlainSensor, PlainCloud], cameras: Mapping[str, CameraDetections], clock: StageClock
    ) -> Extents:
        params, points = self._params, boxes.join_clouds(list(clouds.values()))
        with clock.stage("fuse"):
            cluster = boxes.cluster_in_space(points, params.cluster)
            names = boxes.label_points(points.xyz, self._rig, cameras)
            label = boxes.cluster_labels(cluster, names, params.fusion.label_share)
            found = boxes.box_clusters(points, cluster, points.xyz, params.size, label, oriented=params.oriented)
            return replace(found, sources=boxes.add_camera(found.sources, found.label))

    def _late(
        self, clouds: Mapping[PlainSensor, PlainCloud], cameras: Mapping[str, CameraDetections], clock: StageClock
    ) -> Extents:
        parts = [boxes.no_extents(3)]
        for kind, points in clouds.items():
            own = getattr(self._params, kind)
            with clock.stage(f"detect.{kind}"):
                cluster = boxes.cluster_in_space(points, own.cluster)
                oriented = self._params.oriented
                parts.append(boxes.box_clusters(points, cluster, points.xyz, own.size, oriented=oriented))
        with clock.stage("fuse"):
            min_iou = self._params.fusion.min_iou
            return boxes.label_boxes(boxes.merge_boxes(parts, min_iou), self._rig, cameras, min_iou)
