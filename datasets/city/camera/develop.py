"""From light to an image: rain, lens, glare, sensor, tone curve, JPEG."""

import math

import numpy as np

from fbench.datasets.city.camera.sky import Light
from fbench.datasets.city.instant import EGO
from fbench.datasets.city.rays.caster import Instant
from fbench.datasets.city.rig import CameraSpec
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Array, Float32, Float64
from fbench.replay.data.rig import CameraModel
from fbench.replay.geometry.kernels import kernel, kernel_part

SHRINK = 4  # Glare is smooth: it is computed at a quarter of the image's width and height


def glare_of(image: Float32, radius_px: float) -> Float32:
    """Return what is brighter than white (1) in an image (H, W, 3), spread around: (H/4, W/4, 3), rounded up. A narrow
    halo holds most of it, a wide one the rest.
    """
    over, found = _excess(image)
    if not found:
        return over
    narrow = _spread(over, max(1, round(radius_px / SHRINK)))
    wide = _spread(narrow, max(2, round(4 * radius_px / SHRINK)))
    return np.asarray(np.float32(0.7) * narrow + np.float32(0.3) * wide, np.float32)


@kernel
def _excess(image: Array) -> tuple[Array, bool]:
    height, width = image.shape[:2]
    over = np.zeros(((height + SHRINK - 1) // SHRINK, (width + SHRINK - 1) // SHRINK, 3), np.float32)
    found = False
    for v in range(height):
        for u in range(width):
            for c in range(3):
                if image[v, u, c] > 1:
                    over[v // SHRINK, u // SHRINK, c] += (image[v, u, c] - 1) / (SHRINK * SHRINK)
                    found = True
    return over, found


@kernel
def _spread(image: Array, radius: int) -> Array:
    """Blur by three running means, almost a Gaussian."""
    for _ in range(3):
        image = mean_across(mean_across(image, radius), radius)
    return image


@kernel
def mean_across(image: Array, radius: int) -> Array:
    """Average over pixels side by side; the result is turned, so that the second time goes along the other axis."""
    height, width, channels = image.shape
    result = np.empty((width, height, channels), np.float32)
    for v in range(height):
        for c in range(channels):
            total = 0.0
            for u in range(-radius, width):
                if u + radius < width:
                    total += image[v, u + radius, c]
                if u - radius - 1 >= 0:
                    total -= image[v, u - radius - 1, c]
                if u >= 0:
                    result[u, v, c] = max(0.0, total) / (2 * radius + 1)
    return result


_KNEE = 0.75  # Up to here the image is linear; above, highlights are compressed and never quite white
_MID_GRAY = 0.18
_READ = 0.15  # Share of the noise's variance at mid-gray that doesn't come from light
_STEPS, _CURVE_END = 4096, 4.0
_SOFT = 0.04  # Share of a pixel's light that falls on each of its four neighbors
_GLARE = 0.035  # Share of what is brighter than white that lens and sensor spread around
_PER_BYTES = 1 / math.sqrt(4 * (256 * 256 - 1) / 12)  # One over the standard deviation of the sum of four random bytes


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


def develop(light_in: Float32, spec: CameraSpec, light: Light, rng: np.random.Generator) -> Array:
    """Return the image (H, W, 3) uint8 of linear light (H, W, 3)."""
    glare = glare_of(light_in, float(spec.model().K[0, 0]) / 60)
    noise = rng.integers(0, 0xFFFFFFFF, light_in.shape, np.uint32, endpoint=True)
    slope = (float(tone(np.array(_MID_GRAY + 1e-4))) - float(tone(np.array(_MID_GRAY - 1e-4)))) / 2e-4
    sigma = spec.noise / slope * light.noise_gain**0.5
    curve = (255 * tone(np.arange(_STEPS + 2) * (_CURVE_END / _STEPS))).astype(np.float32)
    return _expose(light_in, glare, noise, curve, sigma, spec.vignetting)


@kernel
def _expose(light_in: Array, glare: Array, noise: Array, curve: Array, sigma: float, vignetting: float) -> Array:
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
                level += sigma * math.sqrt(_READ + (1 - _READ) / _MID_GRAY * level) * _normal(noise[v, u, c])
                image[v, u, c] = _apply_curve(curve, level)
    return image


@kernel_part
def _normal(bits: int) -> float:
    """Return a number of (almost) the standard normal distribution, within 3.5, from 32 random bits: the sum of four
    evenly distributed ones.
    """
    return ((bits & 255) + ((bits >> 8) & 255) + ((bits >> 16) & 255) + (bits >> 24) - 510) * _PER_BYTES


@kernel_part
def _apply_curve(curve: Array, level: float) -> int:
    place = min(max(level, 0.0), _CURVE_END) * (_STEPS / _CURVE_END)
    step = int(place)
    return int(curve[step] + (curve[step + 1] - curve[step]) * (place - step) + 0.5)


@kernel_part
def _between(pixel: int, num: int) -> tuple[int, int, float]:
    """Return which two of `num` larger pixels lie around a pixel's middle, and how far on from the first it is."""
    place = max(0.0, (pixel + 0.5) / SHRINK - 0.5)
    first = int(place)
    return first, min(first + 1, num - 1), place - first


_REACH_M, _NEAREST_M = 4.0, 0.3  # Farther drops are too faint to be told apart: they are part of the air's extinction
_SMALLEST_MM = 1.2
_EXPOSED_S = 0.004
_PER_M3_MM = 8_000.0
"""Marshall and Palmer (1948): N(D) = 8000 exp(-4.1 R^-0.21 D) drops a cubic meter and millimetre of diameter."""
_LIGHT = 0.95  # A drop shows nearly all that is in front of it, most of it sky (Garg and Nayar 2007)


def add_streaks(linear: Float32, now: Instant, model: CameraModel, light: Light) -> None:
    """Draw the drops of an instant over the light (H, W, 3) of an image, in place. Drops belong to the instant, not to
    the camera: both of a stereo pair show the same ones.
    """
    rain_mm_h = now.weather.rain_mm_h
    if rain_mm_h <= 0:
        return
    rng = generator(now.seed, "camera", "rain", now.stamp_ns)
    slope_per_mm = 4.1 * rain_mm_h**-0.21
    expected = (2 * _REACH_M) ** 3 * _PER_M3_MM / slope_per_mm * math.exp(-slope_per_mm * _SMALLEST_MM)
    num = int(rng.poisson(expected))
    diameter_mm = np.minimum(_SMALLEST_MM + rng.exponential(1 / slope_per_mm, num), 5.0)
    place = rng.uniform(-_REACH_M, _REACH_M, (num, 3))
    cos, sin = math.cos(now.states.yaw_rad[EGO]), math.sin(now.states.yaw_rad[EGO])
    vx, vy = now.states.velocity_mps[EGO, :2]
    drift = np.array([-(cos * vx + sin * vy), -(cos * vy - sin * vx)])
    bright = _LIGHT * np.array(light.horizon) * light.exposure
    center = now.body_T_sensor[:3, 3]
    rotation, K = np.ascontiguousarray(now.body_T_sensor[:3, :3]), model.K
    place = center + (place - center + _REACH_M) % (2 * _REACH_M) - _REACH_M  # the same rain around every camera
    _draw(linear, place - center, diameter_mm, drift, rotation, K[0, 0], K[0, 2], K[1, 2], bright)


@kernel
def _draw(
    image: Float32, place: Float64, diameter_mm: Float64, drift: Float64, rotation: Float64, f: float, cx: float,
    cy: float, bright: Float64,
) -> None:  # fmt: skip
    end, p = np.empty(3), np.empty(3)
    for n in range(len(place)):
        speed = 9.65 - 10.3 * math.exp(-0.6 * diameter_mm[n])  # m/s, Atlas et al. (1973)
        p[:] = place[n]
        end[0] = p[0] + drift[0] * _EXPOSED_S
        end[1] = p[1] + drift[1] * _EXPOSED_S
        end[2] = p[2] - speed * _EXPOSED_S
        u, v, depth = _pixel(p, rotation, f, cx, cy)
        u_end, v_end, depth_end = _pixel(end, rotation, f, cx, cy)
        if depth < _NEAREST_M or depth_end < _NEAREST_M:
            continue
        length = max(1.0, math.sqrt((u_end - u) ** 2 + (v_end - v) ** 2))
        across = f * diameter_mm[n] / 1000 / depth
        # a drop covers each place of its streak for the time in which it falls by its own size
        cover = min(0.5, across / length) * min(1.0, across)
        _line(image, u, v, u_end, v_end, length, max(1.0, across), cover, bright)


@kernel_part
def _pixel(p: Float64, rotation: Float64, f: float, cx: float, cy: float) -> tuple[float, float, float]:
    x = rotation[0, 0] * p[0] + rotation[1, 0] * p[1] + rotation[2, 0] * p[2]
    y = rotation[0, 1] * p[0] + rotation[1, 1] * p[1] + rotation[2, 1] * p[2]
    z = rotation[0, 2] * p[0] + rotation[1, 2] * p[1] + rotation[2, 2] * p[2]
    z_or_one = z if z >= _NEAREST_M else 1.0
    return cx + f * x / z_or_one, cy + f * y / z_or_one, z


@kernel_part
def _line(
    image: Float32, u: float, v: float, u_end: float, v_end: float, length: float, wide: float, cover: float,
    bright: Float64,
) -> None:  # fmt: skip
    """Blend a streak in, in steps of a pixel, soft at its sides."""
    height, width = image.shape[:2]
    half = math.ceil(wide / 2 + 0.5)
    for step in range(int(length) + 1):
        x, y = u + (u_end - u) * step / length, v + (v_end - v) * step / length
        row = math.floor(y + 0.5)
        if not 0 <= row < height:
            continue
        middle = math.floor(x + 0.5)
        for column in range(middle - half, middle + half + 1):
            share = cover * min(1.0, max(0.0, wide / 2 + 0.5 - abs(column - x)))
            if share > 0 and 0 <= column < width:
                for c in range(3):
                    image[row, column, c] += share * (bright[c] - image[row, column, c])
