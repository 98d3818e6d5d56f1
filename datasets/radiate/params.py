"""What can be chosen about an import of RADIATE."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from fbench.datasets.radiate.cfar import CfarParams
from fbench.replay.errors import ConfigError


@dataclass(frozen=True)
class RadiateParams:
    """Parameters of `Radiate`."""

    calibration: Path | None = None
    """File like the SDK's `config/default-calib.yaml`; else the `default-calib.yaml` in the sequence or beside it."""
    cfar: CfarParams = field(default_factory=CfarParams)
    """How the radar's images become points."""
    radar_height_m: float = 1.8
    """Height of the radar above the road, where boxes stand [m]: labels have none. The SDK's `sensors_height`; points
    of the LiDAR on the road agree within 5 cm."""
    right_camera: Literal["stereo", "own"] = "stereo"
    """Where `zed_right` is: as the stereo calibration says, from `zed_left`, or as its own position and angles say.
    The latter shift the image by 6 px against the former, and against LiDAR points seen in both images."""
    heading: Literal["course", "imu"] = "course"
    """Where the body of a pose points to: over ground as it moves, upright, or as the IMU's quaternion says, which is
    54 degrees off the course in the sequence that came with the SDK."""
    min_speed_mps: float = 1.0
    """Slower than that there is no course [m/s]: the last one stays, before the first one there is no pose."""
    gps_offset_s: float = 0.0
    """Added to the stamps of GPS and IMU [s]."""

    def __post_init__(self) -> None:
        for name, value in (("radar_height_m", self.radar_height_m), ("gps_offset_s", self.gps_offset_s)):
            if not (math.isfinite(value) and abs(value) < 1e9):
                raise ConfigError(f"{name}={value}: expected a finite number")
        if not 0 < self.min_speed_mps < math.inf:
            raise ConfigError(f"min_speed_mps={self.min_speed_mps}: expected a speed above 0")


DEFAULTS = RadiateParams()
