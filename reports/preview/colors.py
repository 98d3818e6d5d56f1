"""Colours, in OpenCV's order blue, green, red."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from fbench.replay.arrays import Float64

Color: TypeAlias = tuple[int, int, int]
Colors: TypeAlias = NDArray[np.uint8]

BACKGROUND: Color = (20, 16, 13)
PANEL: Color = (42, 36, 32)
GRID: Color = (66, 58, 52)
INK: Color = (240, 236, 232)
QUIET: Color = (176, 168, 160)
TRUTH: Color = (90, 255, 90)
TRUTH_2D: Color = (255, 230, 60)
CURVE: Color = (60, 210, 255)
WARN: Color = (70, 90, 255)
NEAR_M, FAR_M = 2.0, 80.0
MAX_SPEED_MPS = 10.0
_CYCLE: tuple[Color, ...] = (
    (235, 206, 135), (80, 175, 250), (140, 220, 120), (220, 130, 230), (90, 235, 235), (150, 150, 250), (230, 170, 90),
    (190, 220, 190), (120, 120, 220), (210, 210, 90), (170, 110, 250), (110, 190, 170),
)  # fmt: skip


def of_sensor(index: int) -> Color:
    """Colour of the sensor with this number in the order of names."""
    return _CYCLE[index % len(_CYCLE)]


def of_depth(depth_m: Float64) -> Colors:
    """Colours (N, 3) of depths (N,) [m], by their logarithm: red at 2 m, over green, to blue from 80 m on."""
    import cv2

    if not len(depth_m):
        return np.zeros((0, 3), np.uint8)
    safe = np.clip(np.nan_to_num(depth_m, nan=FAR_M), NEAR_M, FAR_M)
    share = np.log(safe / NEAR_M) / np.log(FAR_M / NEAR_M)
    levels = np.round(235 - 215 * share).astype(np.uint8).reshape(-1, 1)
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO), np.uint8).reshape(-1, 3)


def of_speed(speed_mps: Float64) -> Colors:
    """Colours (N, 3) of radial velocities (N,) [m/s]: white where equal, red receding and blue approaching, full from
    10 m/s on (thesis); grey where it isn't measured.
    """
    share = np.clip(np.nan_to_num(speed_mps) / MAX_SPEED_MPS, -1, 1)
    fade = np.round(255 * (1 - np.abs(share)))
    full = np.full_like(fade, 255)
    colors = np.stack([np.where(share > 0, fade, full), fade, np.where(share < 0, fade, full)], axis=1)
    colors[np.isnan(speed_mps)] = 150
    return colors.astype(np.uint8)
