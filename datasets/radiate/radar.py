"""Navtech's polar images as radar scans."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fbench.datasets.radiate.cfar import CfarParams, detect
from fbench.replay.arrays import Array
from fbench.replay.data import RadarScan
from fbench.replay.errors import LogError
from fbench.replay.imports.files import read_image

SENSOR = "navtech"
SIZE_WH = (400, 576)
"""Azimuths and range cells of a polar image [px]."""
RANGE_STEP_M = 0.173611
"""`range_res` of the SDK's configuration: 100 m / 576."""


@dataclass(frozen=True, eq=False)
class Polar:
    """One polar image (576, 400) uint8, power in grey values; range grows with rows, columns go clockwise from ahead.

    That row r is at r range steps and column c at c + 1/2 azimuth steps was found by laying polar images over the
    Cartesian ones of the same frames: the best fit is within 0.45 of a range step and a tenth of an azimuth step.
    """

    power: Array


def read_polar(path: Path) -> Polar:
    """Read a polar image.

    Raises:
        LogError: where it isn't a whole greyscale image of 400 x 576 px.
    """
    import cv2

    image = read_image(path, SENSOR, 0)
    if image.size_wh != SIZE_WH:
        width, height = image.size_wh
        raise LogError(f"{path}: {width}x{height} px, expected a polar image of {SIZE_WH[0]}x{SIZE_WH[1]}")
    try:
        power = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        power = None
    if power is None:
        raise LogError(f"{path}: can't be decoded, is it damaged?")
    if power.ndim != 2 or power.dtype != np.uint8:
        raise LogError(f"{path}: expected grey values of 8 bits, got {power.dtype} {power.shape}")
    return Polar(power)


def scan_of(polar: Polar, stamp_ns: int, params: CfarParams) -> RadarScan:
    """Return the targets of a polar image, at z = 0; there is no Doppler, and `rcs_dbsm` is the grey value."""
    rows, columns = detect(polar.power, RANGE_STEP_M, params)
    range_m = rows * RANGE_STEP_M
    clockwise_rad = (columns + 0.5) * (2 * np.pi / SIZE_WH[0])
    azimuth_rad = np.where(clockwise_rad <= np.pi, -clockwise_rad, 2 * np.pi - clockwise_rad)
    xyz = np.stack([range_m * np.cos(azimuth_rad), range_m * np.sin(azimuth_rad), np.zeros(len(rows))], axis=1)
    return RadarScan(
        SENSOR, stamp_ns, stamp_ns, xyz.astype(np.float32),
        rcs_dbsm=polar.power[rows, columns].astype(np.float32),
        range_m=range_m.astype(np.float32), azimuth_rad=azimuth_rad.astype(np.float32),
    )  # fmt: skip
