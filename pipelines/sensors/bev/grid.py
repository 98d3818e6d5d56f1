"""Points of LiDARs and radars as an image from above, which is what the bird's-eye network sees."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.data.arrays import Bool, Float32, Float64
from fbench.replay.geometry.kernels import kernel

REACH_M, CELL_M = 52.0, 0.25  # The image reaches so far from the body's origin to each side; edge of its cells
SIDE = round(2 * REACH_M / CELL_M)
PER_M = np.float32(1 / CELL_M)
SLICES_M = (-0.4, 0.2, 0.5, 0.8, 1.1, 1.5, 2.0, 2.6, 3.4, 5.0)  # Borders of the slices of height above ground
STANDING_M = (0.25, 3.0)  # Echoes between these heights count apart from those of road and roofs
NUM_SLICES = len(SLICES_M) - 1
COUNT, TOP = NUM_SLICES, NUM_SLICES + 1  # Channels after the slices
ECHOES, OTHER_ECHOES, RECEDING, APPROACHING, RANGE = range(NUM_SLICES + 2, NUM_SLICES + 7)
NUM_CHANNELS = NUM_SLICES + 7
FULL_COUNT, FULL_TOP_M, FULL_MPS = 4.0, 3.0, 10.0  # What becomes 1 in the channels of counts (log), tops and speeds


@dataclass(frozen=True, eq=False)
class BevPoints:
    """What LiDARs and radars measured in one frame, in body coordinates; without a sensor there are no rows."""

    lidar: Float32  # (N, 3) x, y and height above ground [m]
    radar: Float32  # (M, 4) x, y, height above ground [m], range rate over ground [m/s], 0 where it isn't known


NO_LIDAR, NO_RADAR = np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32)


def lidar_rows(xyz: Float64, height_m: Float64) -> Float32:
    """Rows of `BevPoints.lidar` from points (N, 3) in body coordinates and their heights (N,) above ground [m]."""
    return np.column_stack([xyz[:, :2], height_m]).astype(np.float32)


def radar_rows(xyz: Float64, height_m: Float64, range_rate_mps: Float64) -> Float32:
    """Rows of `BevPoints.radar` from echoes (M, 3) in body coordinates, their heights (M,) above ground [m], and range
    rates (M,) over ground [m/s], NaN where they aren't known.
    """
    return np.column_stack([xyz[:, :2], height_m, np.nan_to_num(range_rate_mps)]).astype(np.float32)


def in_reach(center_m: Float64) -> Bool:
    """Which places (N, 2 or more) [m] in body coordinates the image shows."""
    return np.asarray((np.abs(center_m[:, :2]) < REACH_M).all(axis=1), np.bool_)


@kernel
def _fill(lidar: Float32, radar: Float32, borders: Float32, image: Float32) -> None:
    reach, per_m, side = np.float32(REACH_M), PER_M, image.shape[1]
    for i in range(len(lidar)):
        x, y, height = np.floor((lidar[i, 0] + reach) * per_m), np.floor((lidar[i, 1] + reach) * per_m), lidar[i, 2]
        if not (0 <= x < side and 0 <= y < side and borders[0] <= height < borders[-1]):
            continue
        row, column, part = int(x), int(y), 0
        while height >= borders[part + 1]:
            part += 1
        image[part, row, column] = 1.0
        image[COUNT, row, column] += 1.0
        image[TOP, row, column] = max(image[TOP, row, column], height)
    for i in range(len(radar)):
        x, y, height = np.floor((radar[i, 0] + reach) * per_m), np.floor((radar[i, 1] + reach) * per_m), radar[i, 2]
        if not (0 <= x < side and 0 <= y < side):
            continue
        row, column, rate = int(x), int(y), radar[i, 3]
        stands = STANDING_M[0] <= height < STANDING_M[1]
        image[ECHOES if stands else OTHER_ECHOES, row, column] += 1.0
        image[RECEDING, row, column] = max(image[RECEDING, row, column], rate)
        image[APPROACHING, row, column] = max(image[APPROACHING, row, column], -rate)


def rasterize(points: BevPoints) -> Float32:
    """Draw points into an image (C, `SIDE`, `SIDE`); rows run along x, columns along y.

    Channels: whether a slice of height holds LiDAR points; log(1 + their number) / 4; the highest of them / 3 m; the
    same of standing and of other echoes; the fastest receding and approaching echo / 10 m/s; the distance / `REACH_M`.
    """
    image = np.zeros((NUM_CHANNELS, SIDE, SIDE), np.float32)
    _fill(points.lidar, points.radar, np.array(SLICES_M, np.float32), image)
    for channel in (COUNT, ECHOES, OTHER_ECHOES):
        image[channel] = np.log1p(image[channel]) / np.float32(FULL_COUNT)
    image[TOP] /= np.float32(FULL_TOP_M)
    image[RECEDING : APPROACHING + 1] /= np.float32(FULL_MPS)
    image[RANGE] = ranges()
    return image


def ranges() -> Float32:
    """Distance (`SIDE`, `SIDE`) of the cells from the body's origin, over `REACH_M`."""
    middle = (np.arange(SIDE) + 0.5) * CELL_M - REACH_M
    return np.asarray(np.hypot(middle[:, None], middle[None, :]) / REACH_M, np.float32)
