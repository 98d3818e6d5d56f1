"""Navtech's polar images as radar scans, by constant false alarm rate (CFAR) detection.

The LOG/CFAR: a cell is a target where it exceeds the mean of the logarithmic power of the cells around it by a
constant, whatever that mean is: V. G. Hansen and H. R. Ward, "Detection Performance of the Cell Averaging LOG/CFAR
Receiver", IEEE Trans. Aerospace and Electronic Systems 8(5), 1972. Guard cells keep a target out of its own mean: M. A.
Richards, "Fundamentals of Radar Signal Processing", chapter on CFAR.
"""

import math
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from fbench.datasets.importing.files import read_image
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.arrays import Array, Float32, Int64
from fbench.replay.data.messages import RadarScan

RADAR = "navtech"
SIZE_WH = (400, 576)  # Azimuths and range cells of a polar image [px]
RANGE_STEP_M = 0.173611  # `range_res` of the SDK's configuration: 100 m / 576


@dataclass(frozen=True)
class CfarParams:
    """Parameters of the CFAR; the unit of power is that of the image, a gray value."""

    guard: int = 15
    """Cells left out on either side of the one under test; half a car's length, so that a car isn't its own clutter."""
    training: int = 20
    """Cells averaged on either side beyond the guard cells; fewer at the ends of the range."""
    threshold: float = 40.0
    """How far a target exceeds the mean of the training cells."""
    min_range_m: float = 4.0
    """Nearer cells show the own car."""
    peak_only: bool = True
    """Keep only cells above their nearer and not below their farther neighbor along range."""
    max_points: int = 10_000
    """Of more targets those that exceed the mean by most are kept."""

    def __post_init__(self) -> None:
        least = {"guard": 0, "training": 1, "max_points": 0}
        for name, low in least.items():
            if not low <= (value := getattr(self, name)) <= 100_000:
                raise ConfigError(f"cfar.{name}={value}: expected {low} to 100000")
        if not (np.isfinite(self.threshold) and 0 <= self.min_range_m < np.inf):
            values = f"cfar.threshold={self.threshold}, cfar.min_range_m={self.min_range_m}"
            raise ConfigError(f"{values}: expected finite numbers, and a range that isn't negative")


def detect(power: Array, range_step_m: float, params: CfarParams) -> tuple[Int64, Int64]:
    """Find targets in an image (R, A) of power: a row a range cell, row r at `range_step_m * r`, a column an azimuth.
    Returns their rows and columns (N,), by column, then row.
    """
    excess = power - clutter(power, params.guard, params.training)
    found = excess > params.threshold
    found[: int(np.ceil(params.min_range_m / range_step_m))] = False
    if params.peak_only:
        found[1:] &= power[1:] > power[:-1]
        found[:-1] &= power[:-1] >= power[1:]
    columns, rows = np.nonzero(found.T)
    if len(rows) > params.max_points:
        strongest = np.sort(np.argsort(-excess[rows, columns], kind="stable")[: params.max_points])
        rows, columns = rows[strongest], columns[strongest]
    return rows, columns


def clutter(power: Array, guard: int, training: int) -> Float32:
    """Mean power (R, A) of the training cells of each cell; infinite where it has none."""
    import cv2

    def sum_around(cells: Array, reach: int) -> Float32:  # So many on either side and the cell itself, along range
        size = (1, 2 * min(reach, len(cells)) + 1)
        return np.asarray(cv2.boxFilter(cells, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_CONSTANT))

    # Sums are exact, since gray values of a column sum to less than 2^24.
    each = power, np.ones((len(power), 1), power.dtype)
    sums, cells = (sum_around(of, guard + training) - sum_around(of, guard) for of in each)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean: Float32 = sums / cells
    mean[cells[:, 0] == 0] = np.inf
    return mean


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


def read_polar(path: Path) -> Array:
    """Read a polar image (576, 400) uint8 of gray values: range grows with rows, columns go clockwise from ahead.

    That row r is at r range steps and column c at c + 1/2 azimuth steps was found by laying polar images over the
    Cartesian ones of the same frames: the best fit is within 0.45 of a range step and a tenth of an azimuth step.
    Raises LogError where it isn't a whole grayscale image of 400 x 576 px.
    """
    import cv2

    image = read_image(path, RADAR, 0)
    if image.size_wh != SIZE_WH:
        width, height = image.size_wh
        raise LogError(f"{path}: {width}x{height} px, expected a polar image of {SIZE_WH[0]}x{SIZE_WH[1]}")
    power = None
    with suppress(cv2.error):
        power = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_UNCHANGED)
    if power is None:
        raise LogError(f"{path}: can't be decoded, is it damaged?")
    if power.ndim != 2 or power.dtype != np.uint8:
        raise LogError(f"{path}: expected grey values of 8 bits, got {power.dtype} {power.shape}")
    return np.asarray(power)


def scan_of(power: Array, stamp_ns: int, params: CfarParams) -> RadarScan:
    """Return the targets of a polar image, at z = 0; there is no Doppler, and `rcs_dbsm` is the gray value."""
    rows, columns = detect(power, RANGE_STEP_M, params)
    range_m = rows * RANGE_STEP_M
    clockwise_rad = (columns + 0.5) * (2 * np.pi / SIZE_WH[0])
    azimuth_rad = np.where(clockwise_rad <= np.pi, -clockwise_rad, 2 * np.pi - clockwise_rad)
    xyz = np.stack([range_m * np.cos(azimuth_rad), range_m * np.sin(azimuth_rad), np.zeros(len(rows))], axis=1)
    rcs, range_m, azimuth = (a.astype(np.float32) for a in (power[rows, columns], range_m, azimuth_rad))
    xyz = xyz.astype(np.float32)
    return RadarScan(RADAR, stamp_ns, stamp_ns, xyz, rcs_dbsm=rcs, range_m=range_m, azimuth_rad=azimuth)
