"""Observations that the baseline works on, timed: camera detections and the points of all sensors."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.baseline.boxes import PlainCloud, crop, join_clouds, make_cloud
from fbench.pipelines.baseline.params import PlainParams, PlainSensor
from fbench.pipelines.sensors.camera.detector import CameraDetections, CameraStage
from fbench.pipelines.sensors.points.merged import lidar_points, radar_scans
from fbench.pipelines.sensors.stereo.stage import NOISE, StereoStage
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Source
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import Kind, LogInfo, Rig

KINDS: tuple[Kind, ...] = ("lidar", "radar")
"""Sensors that measure points; stereo, which makes them of images, comes on top."""


@dataclass(frozen=True, eq=False)
class PlainObservations:
    """Observations of the sensors of one frame."""

    cameras: Mapping[str, CameraDetections]  # By camera name; a camera that failed isn't in it
    clouds: Mapping[PlainSensor, PlainCloud]
    """By kind of sensor, in the order LiDAR, radar, stereo; empty where it didn't deliver."""
    faults: tuple[Fault, ...]
    missing: Mapping[str, str]  # Cameras whose depth is noise


class PlainSensors:
    """The sensors that parameters name. Raises ConfigError or ModelError where weights are missing or unusable."""

    def __init__(self, params: PlainParams) -> None:
        self._params, self.cameras = params, CameraStage(params.camera)
        self.with_camera = "camera" in params.uses  # Whether boxes have labels

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take the sensors. Raises ConfigError where a setting is no camera's, LogError without a stereo pair."""
        params, settings = self._params, SensorSettings(self._params, rig)
        for kind in KINDS:  # whose points have common parameters
            settings.own(kind, getattr(params, kind), ())
        if self.with_camera:
            self.cameras.start(rig, log_info, settings)
        self._rig, self._ranges_m = rig, dict.fromkeys(rig.sensors("lidar"), (0.0, np.inf))
        self._stereo = StereoStage(rig, log_info.name, params.depth) if "stereo" in params.uses else None

    def view(self, frame: Frame, clock: StageClock) -> PlainObservations:
        """Return what is seen in one frame; what a missing sensor would have given isn't there."""
        params, faults, missing = self._params, list[Fault](), dict[str, str]()
        cameras = self.cameras.view(frame, clock, faults)
        found = dict[PlainSensor, PlainCloud]()
        with clock.stage("calibrate"):
            if "lidar" in params.uses:
                points = lidar_points(self._rig, frame, self._ranges_m)
                found["lidar"] = make_cloud(np.zeros((0, 3)) if points is None else points, Source.L)
            if "radar" in params.uses:
                scans = radar_scans(self._rig, frame, {}) or ()
                found["radar"] = join_clouds([make_cloud(s.xyz, Source.R, s.radial_velocity_mps) for s in scans])
        if self._stereo is not None:
            view, pair = self._stereo.view(frame, clock, faults), self._stereo.pair
            found["stereo"] = make_cloud(view.xyz, Source.S)
            missing |= dict.fromkeys((pair.left, pair.right), NOISE) if view.is_off else {}
        with clock.stage("preprocess"):
            clouds = {kind: crop(cloud, getattr(params, kind).crop) for kind, cloud in found.items()}
        return PlainObservations(cameras, clouds, tuple(faults), missing)
