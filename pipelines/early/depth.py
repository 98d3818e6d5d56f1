"""What LiDARs and a stereo pair see stand on the ground, timed: from a frame to points for the cloud."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fbench.pipelines.points.ground import Plane
from fbench.pipelines.points.lidar import LidarParams, Obstacles, obstacles
from fbench.pipelines.points.lidar_stage import LidarStage
from fbench.pipelines.points.merged import lidar_position
from fbench.pipelines.stages import StageClock
from fbench.pipelines.stereo.objects import ObjectParams
from fbench.pipelines.stereo.params import StereoParams
from fbench.pipelines.stereo.stage import StereoStage
from fbench.replay.arrays import Float64
from fbench.replay.data import Fault, Frame, LogInfo, Rig
from fbench.replay.errors import LogError
from fbench.replay.geometry.stereo_pairs import pairs
from fbench.replay.sensor_settings import SensorSettings

Choice = Literal["auto", "on", "off"]


@dataclass(frozen=True, eq=False)
class Standing:
    """What stands on the ground in one frame."""

    lidar: Obstacles
    stereo: Obstacles
    plane: Plane | None
    """The ground, as LiDAR sees it, else stereo, else as it was seen last; `None` where it never was."""
    noisy: tuple[str, ...] = ()
    """Cameras whose depth is taken for noise."""


def nothing() -> Obstacles:
    """Return what a sensor sees that delivers nothing."""
    return Obstacles(None, np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))


def stereo_stage(rig: Rig, log_name: str, choice: Choice, params: StereoParams) -> StereoStage | None:
    """Return the stage of the pair that is to be used, if any: with `auto`, where the rig has one and no LiDAR.

    Raises:
        ConfigError: where a camera that is named isn't there.
        LogError: where a pair is to be used and the rig has none, or what it has can't be rectified.
    """
    is_wanted = choice == "on" or (choice == "auto" and not rig.sensors("lidar") and bool(pairs(rig)))
    return StereoStage(rig, log_name, params) if is_wanted else None


def require_depth(rig: Rig, log_name: str, stereo: StereoStage | None) -> None:
    """Refuse a rig without anything that sees depth.

    Raises:
        LogError: naming the log and the sensors that are there.
    """
    if rig.sensors("lidar", "radar") or stereo is not None:
        return
    present = ", ".join(f"{rig.mounts[name].kind} {name}" for name in sorted(rig.mounts)) or "no sensors"
    wanted = "early3d needs a LiDAR, a radar or a stereo pair of cameras"
    raise LogError(f"log '{log_name}': {wanted}; the log has: {present}", "CFG001")


class DepthStage:
    """Remembers how the ground lies, for frames in which nothing tells."""

    def __init__(
        self,
        rig: Rig,
        log_info: LogInfo,
        params: LidarParams,
        settings: SensorSettings,
        stereo: StereoStage | None,
    ) -> None:
        self._lidar = LidarStage(rig, log_info, params, settings)
        self._stereo, self._params = stereo, ObjectParams()
        self.eye_m = _eye(rig, stereo)
        """(2,) from where the cloud is seen [m]."""
        self.judged = replace(params, judge=params.judge or "model")
        """How shapes are judged: those of stereo by rules."""
        if not rig.sensors("lidar"):
            self.judged = replace(params, judge="rules", shape=self._params.shape)
        self.reset()

    def reset(self) -> None:
        """Forget how the ground lies."""
        self._plane: Plane | None = None
        self._lidar.reset()

    def view(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> Standing:
        """Take the ground away from the points of one frame; a corrupt image is a fault and counts as missing."""
        points = self._lidar.points(frame, clock)
        lidar = nothing() if points is None else self._lidar.obstacles(points, clock)
        stereo, noisy = self._by_stereo(frame, clock, faults)
        self._plane = lidar.plane or stereo.plane or self._plane
        return Standing(lidar, stereo, self._plane, noisy)

    def _by_stereo(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> tuple[Obstacles, tuple[str, ...]]:
        if self._stereo is None:
            return nothing(), ()
        view, pair = self._stereo.view(frame, clock, faults), self._stereo.pair
        with clock.stage("preprocess"):
            found = obstacles(view.xyz, self._params.as_lidar) if len(view.xyz) else nothing()
        return found, (pair.left, pair.right) if view.is_off else ()


def _eye(rig: Rig, stereo: StereoStage | None) -> Float64:
    if rig.sensors("lidar"):
        return lidar_position(rig)
    if stereo is not None:
        return np.asarray(stereo.eye_m, np.float64)
    return np.asarray(np.mean([rig.body_T_sensor(name)[:2, 3] for name in rig.sensors("radar")], axis=0), np.float64)
