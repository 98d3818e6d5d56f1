"""The sensors of the ego vehicle and their properties: the thesis's rig."""

from typing import Annotated, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.spatial.transform import Rotation

from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.geometry.transforms import quaternion
from fbench.replay.logs.coordinate_frames import BODIES, WORLDS

Number = Annotated[float, Field(ge=-1000, le=1000)]
Altitude = Annotated[float, Field(ge=-90, le=90)]
Rate = Annotated[float, Field(ge=0.1, le=1000)]
Reach = Annotated[float, Field(gt=0, le=1000)]
NotNegative = Annotated[float, Field(ge=0, le=1000)]
Late = Annotated[float, Field(ge=0, le=60_000)]
Share = Annotated[float, Field(ge=0, le=1)]
Three = Annotated[tuple[Number, Number, Number], Field(strict=False)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]  # Of a sensor
POSE = "pose"  # Name of the stream of poses, which no sensor may have
WEATHER = "weather"  # What `--set` calls the weather, and so no sensor
_OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Columns: the camera's x right, y down, z forward in axes x forward, y left, z up."""
MAX_RAYS = 5_000_000  # Of one message of a LiDAR or radar: more take more memory than a small computer has
MAX_PIXELS = 16_000_000


class SensorSpec(BaseModel):
    """What all sensors have: a mount, a clock and a way to the recorder."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    translation_m: Three  # In body coordinates; the origin lies on the ground in the middle of the vehicle
    yaw_pitch_roll_deg: Three = (0.0, 0.0, 0.0)
    """R = Rz(yaw) Ry(pitch) Rx(roll) of axes x forward, y left, z up: a positive pitch looks down."""
    rate_hz: Rate
    phase_ms: Late = 0.0  # When the first message is measured
    latency_ms: Late  # From stamp to arrival, at least
    jitter_ms: Late = 0.0  # Arrival is later by up to so much, evenly distributed
    loss: Share = 0.0  # How often a message never arrives

    @model_validator(mode="after")
    def _starts_in_time(self) -> Self:
        if self.phase_ms >= 1000 / self.rate_hz:
            raise ValueError(f"phase_ms must be below the period of {1000 / self.rate_hz:g} ms")
        return self

    def mount_rotation(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        """Rotation (3, 3) from axes x forward, y left, z up of the sensor to the body."""
        return np.asarray(Rotation.from_euler("ZYX", self.yaw_pitch_roll_deg, degrees=True).as_matrix(), np.float64)


class CameraSpec(SensorSpec):
    """A pinhole camera."""

    rate_hz: Rate = 10.0
    latency_ms: Late = 15.0
    jitter_ms: Late = 2.0
    size_wh: Annotated[tuple[int, int], Field(strict=False)] = (800, 600)
    fov_deg: Annotated[float, Field(gt=1, lt=170)] = 90.0  # Horizontal field of view
    noise: Share = 0.006
    """Standard deviation of the sensor's noise at mid-gray in good light, as a share of white; more in little light."""
    vignetting: Share = 0.15  # How much darker the corners are
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 92

    @model_validator(mode="after")
    def _has_pixels(self) -> Self:
        if not all(16 <= pixels <= 8192 for pixels in self.size_wh):
            raise ValueError("size_wh must be 16 to 8192 px each")
        if self.size_wh[0] * self.size_wh[1] > MAX_PIXELS:
            raise ValueError(f"size_wh must be at most {MAX_PIXELS} px in all")
        return self

    def model(self) -> CameraModel:
        """Intrinsics: f = width / (2 tan(FOV / 2)), c = ((width - 1) / 2, (height - 1) / 2) (thesis, Calibration)."""
        width, height = self.size_wh
        f = width / (2 * np.tan(np.radians(self.fov_deg) / 2))
        return CameraModel(np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1.0]]), self.size_wh)


class LidarSpec(SensorSpec):
    """A spinning LiDAR: one beam after the other, channel by channel, all around."""

    rate_hz: Annotated[float, Field(ge=0.5, le=1000)] = 20.0
    """A turn takes at most 2 s, so that times in it fit into `PointCloud.offset_ns`."""
    latency_ms: Late = 10.0
    jitter_ms: Late = 2.0
    channels: Annotated[int, Field(ge=1, le=1024)] = 128
    points_per_s: Annotated[int, Field(ge=1, le=20_000_000)] = 1_000_000  # Shots, whether anything comes back or not
    range_m: Reach = 100.0
    upper_deg: Altitude = 30.0
    lower_deg: Altitude = -20.0
    noise_m: NotNegative = 0.01  # Standard deviation of the range
    dropout: Share = 0.0  # Share of returns that are lost for no reason
    motion: bool = False
    """Whether the vehicle and all others move while it turns; else everything stands still at the stamp."""

    @model_validator(mode="after")
    def _has_channels_and_not_too_many_shots(self) -> Self:
        if self.lower_deg > self.upper_deg:
            raise ValueError("lower_deg must not be above upper_deg")
        _require_rays(self.points_per_s / self.rate_hz)
        return self


class RadarSpec(SensorSpec):
    """A radar of many echoes."""

    rate_hz: Rate = 20.0
    latency_ms: Late = 5.0
    jitter_ms: Late = 2.0
    horizontal_fov_deg: Annotated[float, Field(gt=0, le=180)] = 100.0
    vertical_fov_deg: Annotated[float, Field(gt=0, le=120)] = 50.0
    points_per_s: Annotated[int, Field(ge=1, le=20_000_000)] = 250_000  # Rays, whether an echo comes back or not
    range_m: Reach = 100.0
    range_resolution_m: NotNegative = 0.1
    azimuth_resolution_deg: NotNegative = 0.5
    altitude_resolution_deg: NotNegative = 0.5
    speed_resolution_mps: NotNegative = 0.1  # Values are given at multiples of these; 0: as they are
    range_noise_m: NotNegative = 0.05
    azimuth_noise_deg: NotNegative = 0.2
    altitude_noise_deg: NotNegative = 0.2
    speed_noise_mps: NotNegative = 0.05
    rcs_noise_db: NotNegative = 1.0  # Standard deviations
    merge_cells: bool = False  # Whether echoes that can't be told apart become one
    clutter: Annotated[float, Field(ge=0, le=100_000)] = 0.0  # False echoes a scan, on average
    multipath: Share = 0.0  # Share of strong echoes of road users that come a second time, by a detour

    @model_validator(mode="after")
    def _has_not_too_many_rays(self) -> Self:
        _require_rays(self.points_per_s / self.rate_hz)
        return self


def _require_rays(num: float) -> None:
    if num > MAX_RAYS:
        raise ValueError(f"points_per_s / rate_hz must be at most {MAX_RAYS}")


class RigSpec(BaseModel):
    """All sensors of the ego vehicle, by name."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    cameras: dict[Name, CameraSpec] = {}
    lidars: dict[Name, LidarSpec] = {}
    radars: dict[Name, RadarSpec] = {}
    pose_rate_hz: Rate = 100.0  # Of the poses of the ego vehicle, which arrive 1 ms after their stamps

    @property
    def specs(self) -> dict[str, CameraSpec | LidarSpec | RadarSpec]:
        """All sensors, sorted by name."""
        every: dict[str, CameraSpec | LidarSpec | RadarSpec] = {**self.cameras, **self.lidars, **self.radars}
        return {name: every[name] for name in sorted(every)}

    @property
    def names(self) -> tuple[str, ...]:
        """Of all sensors, sorted."""
        return tuple(self.specs)

    @property
    def reference(self) -> str:
        """Whose stamps are the instants of frames: the first camera, else the first LiDAR, else the first radar."""
        return next(iter([*sorted(self.cameras), *sorted(self.lidars), *sorted(self.radars)]))

    @model_validator(mode="after")
    def _names_tell_sensors_apart(self) -> Self:
        names = [POSE, *self.cameras, *self.lidars, *self.radars]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two streams are called '{twice[0]}'")
        for name in sorted(names):
            if name in (*BODIES, *WORLDS):
                raise ValueError(f"no sensor may be called '{name}', which is a coordinate frame; choose another name")
            if name == WEATHER:
                raise ValueError(f"no sensor may be called '{name}', which --set takes for the weather")
        return self

    def rig(self) -> Rig:
        """Mounts and camera models as a log holds them."""
        specs = sorted({**self.lidars, **self.radars}.items())
        mounts = {name: Mount("lidar" if name in self.lidars else "radar", np.array(spec.translation_m),
                              quaternion(spec.mount_rotation())) for name, spec in specs}  # fmt: skip
        for name, camera in sorted(self.cameras.items()):
            rotation = quaternion(camera.mount_rotation() @ _OPTICAL)
            mounts[name] = Mount("camera", np.array(camera.translation_m), rotation)
        return Rig(mounts, {name: camera.model() for name, camera in sorted(self.cameras.items())})


def thesis_rig() -> RigSpec:
    """Return the rig of the thesis (table of sensors), with rates, latencies and noise that it leaves open."""
    return RigSpec(
        cameras={
            "camera": CameraSpec(translation_m=(2.0, 0.0, 1.0)),
            "stereo_left": CameraSpec(translation_m=(2.0, 0.2, 1.0)),
            "stereo_right": CameraSpec(translation_m=(2.0, -0.2, 1.0)),
        },
        lidars={"lidar": LidarSpec(translation_m=(0.0, 0.0, 2.0))},
        radars={"radar": RadarSpec(translation_m=(2.0, 0.0, 1.0), yaw_pitch_roll_deg=(0.0, -5.0, 0.0))},
    )
