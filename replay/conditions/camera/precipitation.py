"""Rain and snow before a camera: layers of streaks and flakes, and the dull light that comes with rain."""

from math import cos, log, radians, sin

import cv2
import numpy as np

from fbench.replay.conditions.camera.blur import blur_along
from fbench.replay.conditions.camera.image_condition import hide
from fbench.replay.conditions.camera.kernels import draw_streaks
from fbench.replay.data.arrays import Array
from fbench.replay.data.images import Pixels

_RATES = (2.5, 10.0, 25.0, 50.0, 100.0)
_COVERED = (0.035, 0.08, 0.125, 0.175, 0.225)  # Share of the image behind streaks, at these rates
_SLANT_DEG, _STREAK = 15.0, 225.0  # Greatest slant, and the brightness of a drop: nearly that of the sky
_DULL, _DARKER, _DULLEST_MM_H = 0.3, 0.7, 50.0
_SNOW = {  # Rate [mm/h]: mean, sigma, zoom, threshold, radius and sigma of the blur [px], share that stays unwhitened
    0.05: (0.0, 0.3, 3.0, 1.0, 10.0, 4.0, 1.0),
    2.24: (0.1, 0.3, 3.0, 0.5, 10.0, 4.0, 0.8),
    4.82: (0.2, 0.3, 2.0, 0.5, 12.0, 4.0, 0.7),
    8.85: (0.55, 0.3, 4.0, 0.9, 12.0, 8.0, 0.7),
    34.97: (0.55, 0.3, 4.5, 0.85, 12.0, 8.0, 0.65),
    130.0: (0.55, 0.3, 2.5, 0.85, 12.0, 12.0, 0.55),
}  # fmt: skip


def add_rain(pixels: Pixels, rain_mm_h: float, rng: np.random.Generator) -> Pixels:
    """Return the image behind streaks of rain that cover a share of it (Dong et al., CVPR 2023, at the middles of their
    ranges). They slant together, by up to 15 degrees; drawn anew for every image.
    """
    height, width = pixels.shape[:2]
    covered = float(np.interp(log(max(rain_mm_h, 1e-3)), np.log((0.1, *_RATES)), (0.0, *_COVERED)))
    scale = width / 1600
    mean_px, wide_px = max(3.0, 45 * scale), max(1.0, 1.6 * scale)
    num = round(covered * width * height / (mean_px * wide_px))
    slant = radians(rng.uniform(-_SLANT_DEG, _SLANT_DEG))
    start = rng.random((num, 2)) * (width + 2 * mean_px, height + 2 * mean_px) - (mean_px, 2 * mean_px)
    length, wide = mean_px * rng.uniform(0.5, 1.5, num), wide_px * rng.uniform(0.6, 1.4, num)
    along = np.array([sin(slant), cos(slant)])
    layer = draw_streaks((width, height), start, along, length, wide, rng.uniform(0.1, 0.5, num))
    return hide(pixels, layer, (_STREAK, _STREAK, _STREAK))


def dull(pixels: Pixels, rain_mm_h: float) -> Pixels:
    """Return the image under the sky of rain: 0.3 of its colors become gray, and V of HSV falls to 0.7 (Dong et al.,
    CVPR 2023, at every level). Here it does so from 50 mm/h on, and less under less, with log(1 + R): else streaks and
    airlight would brighten what is darkest in drizzle.
    """
    share = min(1.0, log(1 + rain_mm_h) / log(1 + _DULLEST_MM_H))
    gray = cv2.cvtColor(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    bright = 1 - (1 - _DARKER) * share
    return np.asarray(cv2.addWeighted(pixels, (1 - _DULL * share) * bright, gray, _DULL * share * bright, 0), np.uint8)


def add_snow(pixels: Pixels, snow_mm_h: float, rng: np.random.Generator) -> Pixels:
    """Return the image in snow: whitened, and behind a layer of flakes and the same turned by 180 degrees. The layer is
    normal noise, enlarged, cut off below a threshold and blurred along its fall (Hendrycks and Dietterich, ICLR 2019).
    Their five levels are snowfalls of 2.24 to 130 mm/h; numbers between are interpolated in the logarithm.
    """
    rates = np.log(list(_SNOW))
    numbers = np.array(list(_SNOW.values()))
    mean, sigma, zoom, threshold, radius, spread, kept = (
        float(np.interp(log(max(snow_mm_h, 1e-3)), rates, column)) for column in numbers.T
    )
    height, width = pixels.shape[:2]
    small = (max(1, round(height / zoom)), max(1, round(width / zoom)))
    noise = rng.standard_normal(small, np.float32) * np.float32(sigma) + np.float32(mean)
    layer: Array = cv2.resize(noise, (width, height), interpolation=cv2.INTER_LINEAR)
    layer = np.clip(np.where(layer < threshold, 0, layer), 0, 1)
    layer = blur_along(np.asarray(255 * layer + 0.5, np.uint8), round(radius), spread, rng.uniform(-135, -45))
    layer = cv2.cvtColor(layer, cv2.COLOR_GRAY2BGR)
    white = np.minimum(np.arange(256) * 1.5 + 127.5, 255).astype(np.uint8)
    gray = cv2.cvtColor(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    whitened = cv2.addWeighted(pixels, kept, cv2.max(pixels, cv2.LUT(gray, white)), 1 - kept, 0)
    return np.asarray(cv2.add(cv2.add(whitened, layer), cv2.rotate(layer, cv2.ROTATE_180)), np.uint8)
