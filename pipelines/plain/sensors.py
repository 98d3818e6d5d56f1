"""The points of all sensors that a plain pipeline uses, timed: from a frame to one cloud for each kind."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.plain.clusters import Cloud, cloud, cropped, one_cloud
from fbench.pipelines.plain.params import PlainCropParams, PlainSensor
from fbench.pipelines.points.merged import lidar_points, radar_scans
from fbench.pipelines.stages import StageClock
from fbench.pipelines.stereo.params import StereoParams
from fbench.pipelines.stereo.stage import NOISE, StereoStage
from fbench.replay.data import Fault, Frame, Kind, LogInfo, Rig, Source

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
