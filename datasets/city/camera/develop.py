"""From light to an image: lens, sensor, tone curve, JPEG."""

import math

import cv2
import numpy as np

from fbench.datasets.city.camera.glare import SHRINK, glare_of
from fbench.datasets.city.camera.light import Light
from fbench.datasets.city.rig import CameraSpec
from fbench.replay.arrays import Array, Float32, Float64
from fbench.replay.kernels import kernel

_KNEE = 0.75
"""Up to here the image is linear; above, highlights are compressed and never quite white."""
_MID_GREY = 0.18
_READ = 0.15
"""Share of the noise's variance at mid-grey that doesn't come from light."""
_STEPS, _CURVE_END = 4096, 4.0
_SOFT = 0.04
"""Share of a pixel's light that falls on each of its four neighbours."""
_GLARE = 0.035
"""Share of what is brighter than white that lens and sensor spread around."""
_PER_BYTES = 1 / math.sqrt(4 * (256 * 256 - 1) / 12)
"""One over the standard deviation of the sum of four random bytes."""


def tone(linear: Array) -> Float64:
    """Return what an image shows, 0 to 1, of linear light (white: 1): a shoulder above 0.75, then the curve of sRGB
    (IEC 61966-2-1).
    """
    x = np.maximum(np.asarray(linear, np.float64), 0)
    x = np.where(x < _KNEE, x, _KNEE + (1 - _KNEE) * (1 - np.exp(-(np.maximum(x, _KNEE) - _KNEE) / (1 - _KNEE))))
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 1e-9), 1 / 2.4) - 0.055)


def linear(toned: Array) -> Float64:
    """Return the linear light that `tone` shows so: its inverse, below 1."""
    y = np.asarray(toned, np.float64)
    x = np.where(y <= 0.04045, y / 12.92, np.power((y + 0.055) / 1.055, 2.4))
    over = np.minimum(np.maximum(x - _KNEE, 0) / (1 - _KNEE), 1 - 1e-9)
    return np.where(x < _KNEE, x, _KNEE - (1 - _KNEE) * np.log1p(-over))


def averaged(first: Float32, more: Float32, pixels: Array) -> None:
    """Average further samples (n E, 3) of some pixels (E,) into the first ones, in place."""
    each = more.reshape(len(pixels), -1, 3)
    total = first[pixels]
    for k in range(each.shape[1]):
        total += each[:, k]
    first[pixels] = total / np.float32(1 + each.shape[1])


def developed(light_in: Float32, spec: CameraSpec, light: Light, rng: np.random.Generator) -> Array:
    """Return the image (H, W, 3) uint8 of linear light (H, W, 3)."""
    glare = glare_of(light_in, float(spec.model().K[0, 0]) / 60)
    noise = rng.integers(0, 0xFFFFFFFF, light_in.shape, np.uint32, endpoint=True)
    slope = (float(tone(np.array(_MID_GREY + 1e-4))) - float(tone(np.array(_MID_GREY - 1e-4)))) / 2e-4
    sigma = spec.noise / slope * light.noise_gain**0.5
    curve = (255 * tone(np.arange(_STEPS + 2) * (_CURVE_END / _STEPS))).astype(np.float32)
    return _exposed(light_in, glare, noise, curve, sigma, spec.vignetting)


def jpeg(rgb: Array, quality: int) -> bytes:
    """Encode an image (H, W, 3)."""
    _, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return bytes(data.tobytes())


@kernel
def _exposed(light_in: Array, glare: Array, noise: Array, curve: Array, sigma: float, vignetting: float) -> Array:
    """Soften a little, add glare, darken the corners, add noise, and apply the tone curve."""
    height, width = light_in.shape[:2]
    image = np.empty((height, width, 3), np.uint8)
    cu, cv = (width - 1) / 2, (height - 1) / 2
    darker = vignetting / (cu * cu + cv * cv)
    for v in range(height):
        above, below = max(v - 1, 0), min(v + 1, height - 1)
        i, lower, down = _between(v, glare.shape[0])
        for u in range(width):
            left, right = max(u - 1, 0), min(u + 1, width - 1)
            j, farther, along = _between(u, glare.shape[1])
            keep = 1 - darker * ((u - cu) * (u - cu) + (v - cv) * (v - cv))
            for c in range(3):
                around = light_in[above, u, c] + light_in[below, u, c] + light_in[v, left, c] + light_in[v, right, c]
                level = (1 - 4 * _SOFT) * light_in[v, u, c] + _SOFT * around
                upper = glare[i, j, c] + along * (glare[i, farther, c] - glare[i, j, c])
                under = glare[lower, j, c] + along * (glare[lower, farther, c] - glare[lower, j, c])
                level = keep * (level + _GLARE * (upper + down * (under - upper)))
                level += sigma * math.sqrt(_READ + (1 - _READ) / _MID_GREY * level) * _normal(noise[v, u, c])
                image[v, u, c] = _toned(curve, level)
    return image


@kernel
def _normal(bits: int) -> float:
    """Return a number of (almost) the standard normal distribution, within 3.5, from 32 random bits: the sum of four
    evenly distributed ones.
    """
    return ((bits & 255) + ((bits >> 8) & 255) + ((bits >> 16) & 255) + (bits >> 24) - 510) * _PER_BYTES


@kernel
def _toned(curve: Array, level: float) -> int:
    place = min(max(level, 0.0), _CURVE_END) * (_STEPS / _CURVE_END)
    step = int(place)
    return int(curve[step] + (curve[step + 1] - curve[step]) * (place - step) + 0.5)


@kernel
def _between(pixel: int, num: int) -> tuple[int, int, float]:
    """Return which two of `num` larger pixels lie around a pixel's middle, and how far on from the first it is."""
    place = max(0.0, (pixel + 0.5) / SHRINK - 0.5)
    first = int(place)
    return first, min(first + 1, num - 1), place - first
