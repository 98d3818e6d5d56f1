"""What a preview is drawn from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.data import Frame, Image, Kind, LogInfo, PointCloud, RadarScan, Rig, Truth
from fbench.replay.errors import DecodeError
from fbench.replay.geometry.transforms import transform
from fbench.replay.images import Pixels, decode
from fbench.reports.preview.depth_edges import depth_edges


@dataclass(frozen=True, eq=False)
class Points:
    """Points of one LiDAR or radar."""

    sensor: str
    kind: Kind
    xyz: Float64
    """(N, 3) in body coordinates [m], or in the sensor's own where its place isn't known."""
    speed_mps: Float64
    """(N,) radial velocity, positive receding; NaN where it isn't measured."""
    is_placed: bool = True


@dataclass(frozen=True, eq=False)
class Sample:
    """One frame that is drawn."""

    frame: Frame
    rig: Rig
    """Sensors whose place is known, and cameras that are calibrated."""
    truth: Truth | None = None
    ego_mps: float | None = None
    """How fast the poses of the log say that the body drives forward [m/s]; negative: backwards."""

    @cached_property
    def cameras(self) -> Sequence[str]:
        """Cameras whose image can be decoded, sorted."""
        images = [n for n, m in sorted(self.frame.messages.items()) if isinstance(m, Image)]
        return [name for name in images if self._decoded(name) is not None]

    def image(self, camera: str) -> Pixels:
        """Image (H, W, 3) BGR of one of the `cameras`; decoded anew, since all would take much memory.

        Raises:
            DecodeError: where it isn't there.
        """
        pixels = self._decoded(camera)
        if pixels is None:
            raise DecodeError(f"frame {self.frame.index} has no image of '{camera}'")
        return pixels

    def _decoded(self, camera: str) -> Pixels | None:
        message = self.frame.messages.get(camera)
        return decode(message) if isinstance(message, Image) else None

    @cached_property
    def points(self) -> Sequence[Points]:
        """Points of all LiDARs and radars, by name of the sensor."""
        found = [m for _, m in sorted(self.frame.messages.items()) if isinstance(m, PointCloud | RadarScan)]
        return [self._points(message) for message in found]

    @cached_property
    def depth_edges_m(self) -> Float64:
        """Near sides (N, 3) of jumps in depth of all placed LiDARs, in body coordinates [m]."""
        found = [np.zeros((0, 3))]
        for points in self.placed("lidar"):
            seen = points.xyz - self.rig.body_T_sensor(points.sensor)[:3, 3]
            found.append(points.xyz[depth_edges(transform(self._turned(points.sensor), seen))])
        return np.concatenate(found)

    def _turned(self, sensor: str) -> Float64:
        """Matrix (4, 4) that turns body axes into those of a sensor: jumps are sought along its rings."""
        turn = np.eye(4)
        turn[:3, :3] = self.rig.body_T_sensor(sensor)[:3, :3].T
        return turn

    def placed(self, kind: Kind) -> list[Points]:
        """Points in body coordinates of the sensors of one kind."""
        return [points for points in self.points if points.kind == kind and points.is_placed]

    def with_truth(self, truth: Truth | None) -> "Sample":
        """Return the frame with what is known to be there."""
        return replace(self, truth=truth)

    def age_ms(self, sensor: str) -> float | None:
        """How much later than the frame's instant a sensor measured [ms]; `None` where it is missing."""
        message = self.frame.messages.get(sensor)
        return None if message is None else (message.stamp_ns - self.frame.stamp_ns) / 1e6

    def _points(self, message: PointCloud | RadarScan) -> Points:
        is_placed = message.sensor in self.rig.mounts
        xyz = np.asarray(message.xyz, np.float64)
        if is_placed:
            xyz = transform(self.rig.body_T_sensor(message.sensor), xyz)
        measured = message.radial_velocity_mps if isinstance(message, RadarScan) else None
        speed = np.full(len(xyz), np.nan) if measured is None else np.asarray(measured, np.float64)
        return Points(message.sensor, "lidar" if isinstance(message, PointCloud) else "radar", xyz, speed, is_placed)


@dataclass(frozen=True)
class Arrival:
    """When one message was measured, and when it was recorded."""

    stamp_ns: int
    log_ns: int


@dataclass(frozen=True)
class Instant:
    """The stamps of what is in one frame."""

    index: int
    stamp_ns: int
    stamps_ns: Mapping[str, int]
    """By sensor; missing ones aren't there."""


@dataclass(frozen=True, eq=False)
class Material:
    """What was read of a log."""

    info: LogInfo
    kinds: Mapping[str, Kind]
    """All sensors, by name."""
    rig: Rig
    """As the log begins, without sensors whose place isn't known."""
    problems: Mapping[str, str]
    """What is unknown of the calibration of a sensor, by its name."""
    reference: str
    samples: Sequence[Sample]
    """Frames that are drawn."""
    kept: Sequence[Sample]
    """These and more frames, which are measured but not drawn."""
    num_frames: int
    num_labelled: int
    instants: Sequence[Instant]
    """Of frames evenly spread over the log."""
    arrivals: Mapping[str, Sequence[Arrival]]
    """Of messages evenly spread over the log, by sensor or stream of poses."""
    num_messages: Mapping[str, int]
    """Read of each sensor or stream of poses."""
    missing: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """In how many frames a sensor is missing, by its name and the reason."""
    periods_mps: Mapping[str, float] = field(default_factory=dict)
    """With what period radial velocities alias, by radar, where the log says so [m/s]."""
