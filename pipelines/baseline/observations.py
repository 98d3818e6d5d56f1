"""Observations that the baseline works on, timed: camera detections and the points of all sensors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.baseline.boxes import Cloud, cloud, cropped, one_cloud
from fbench.pipelines.baseline.params import PlainCropParams, PlainParams, PlainSensor
from fbench.pipelines.params import StageClock
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.camera.stage import CameraStage
from fbench.pipelines.sensors.points.merged import lidar_points, radar_scans
from fbench.pipelines.sensors.stereo.stage import NOISE, StereoParams, StereoStage
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Source
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import Kind, LogInfo, Rig

KINDS: tuple[Kind, ...] = ("lidar", "radar")
"""Sensors that measure points; stereo, which makes them of images, comes on top."""


@dataclass(frozen=True)
class Crops:
    """Which points of each kind of sensor take part."""

    lidar: PlainCropParams
    radar: PlainCropParams
    stereo: PlainCropParams


class PointSensors:
    """Gathers the points of LiDARs, radars and one stereo pair.

    Args:
        uses: Which kinds.
        crops: Which points take part.
        stereo: How stereo gives depth.

    Raises:
        LogError: where stereo is used and the rig has no pair.
    """

    def __init__(
        self, rig: Rig, log_info: LogInfo, uses: Sequence[PlainSensor], crops: Crops, stereo: StereoParams
    ) -> None:
        self._rig, self._uses, self._crops = rig, uses, crops
        self._ranges_m = dict.fromkeys(rig.sensors("lidar"), (0.0, np.inf))
        self._stereo = StereoStage(rig, log_info.name, stereo) if "stereo" in uses else None

    def clouds(
        self, frame: Frame, clock: StageClock, faults: list[Fault], missing: dict[str, str]
    ) -> dict[PlainSensor, Cloud]:
        """Return what each kind sees, in the order LiDAR, radar, stereo; nothing where it didn't deliver.

        Appends corrupt images to `faults`; where depth is noise the pair is put into `missing`, with the reason.
        """
        found = dict[PlainSensor, Cloud]()
        with clock.stage("calibrate"):
            if "lidar" in self._uses:
                found["lidar"] = self._lidar(frame)
            if "radar" in self._uses:
                found["radar"] = self._radar(frame)
        if self._stereo is not None:
            view = self._stereo.view(frame, clock, faults)
            found["stereo"] = cloud(view.xyz, Source.S)
            missing |= dict.fromkeys((self._stereo.pair.left, self._stereo.pair.right), NOISE) if view.is_off else {}
        with clock.stage("preprocess"):
            return {kind: cropped(points, getattr(self._crops, kind)) for kind, points in found.items()}

    def _lidar(self, frame: Frame) -> Cloud:
        points = lidar_points(self._rig, frame, self._ranges_m)
        return cloud(np.zeros((0, 3)) if points is None else points, Source.L)

    def _radar(self, frame: Frame) -> Cloud:
        scans = radar_scans(self._rig, frame, {})
        return one_cloud([cloud(scan.xyz, Source.R, scan.radial_velocity_mps) for scan in scans or ()])


@dataclass(frozen=True, eq=False)
class PlainSeen:
    """What the sensors of one frame gave."""

    cameras: Mapping[str, CameraDetections]
    """By camera name; a camera that failed isn't in it."""
    clouds: Mapping[PlainSensor, Cloud]
    """By kind of sensor, in the order LiDAR, radar, stereo."""
    faults: tuple[Fault, ...]
    missing: Mapping[str, str]
    """Cameras whose depth is noise."""


class PlainSensors:
    """The sensors that the parameters name.

    Raises:
        ConfigError: where the file with the camera's weights is missing.
        ModelError: where these weights can't be used.
    """

    def __init__(self, params: PlainParams) -> None:
        self._params, self.cameras = params, CameraStage(params.camera)
        self.with_camera = "camera" in params.uses
        """Whether boxes have labels."""

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take the sensors of the rig.

        Raises:
            ConfigError: where a setting by sensor isn't one of a camera.
            LogError: where stereo is used and the rig has no pair.
        """
        params, settings = self._params, SensorSettings(self._params, rig)
        for kind in KINDS:  # whose points have common parameters
            settings.own(kind, getattr(params, kind), ())
        if self.with_camera:
            self.cameras.start(rig, log_info, settings)
        crops = Crops(params.lidar.crop, params.radar.crop, params.stereo.crop)
        self._points = PointSensors(rig, log_info, params.uses, crops, params.depth)

    def view(self, frame: Frame, clock: StageClock) -> PlainSeen:
        """Return what is seen in one frame; what a missing sensor would have given isn't there."""
        faults, missing = list[Fault](), dict[str, str]()
        cameras = self.cameras.view(frame, clock, faults)
        clouds = self._points.clouds(frame, clock, faults, missing)
        return PlainSeen(cameras, clouds, tuple(faults), missing)
