"""Rain drops that fall close to the camera: streaks."""

import math

import numpy as np

from fbench.datasets.city.camera.light import Light
from fbench.datasets.city.instant import Instant
from fbench.datasets.city.motion import EGO, BodyStates
from fbench.replay.arrays import Float32, Float64
from fbench.replay.data import CameraModel
from fbench.replay.draws import generator
from fbench.replay.kernels import kernel

_REACH_M, _NEAREST_M = 4.0, 0.3
"""Farther drops are too faint to be told apart: they are part of the air's extinction."""
_SMALLEST_MM = 1.2
_EXPOSED_S = 0.004
_PER_M3_MM = 8_000.0
"""Marshall and Palmer (1948): N(D) = 8000 exp(-4.1 R^-0.21 D) drops a cubic metre and millimetre of diameter."""
_LIGHT = 0.95
"""A drop shows nearly all that is in front of it, most of it sky (Garg and Nayar 2007)."""


def add_streaks(linear: Float32, now: Instant, model: CameraModel, light: Light) -> None:
    """Draw the drops of an instant over the light (H, W, 3) of an image, in place.

    Drops belong to the instant, not to the camera: both of a stereo pair show the same ones.
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
    drift = _drift_mps(now.states)
    bright = _LIGHT * np.array(light.horizon) * light.exposure
    center = now.body_T_sensor[:3, 3]
    rotation, K = np.ascontiguousarray(now.body_T_sensor[:3, :3]), model.K
    place = center + (place - center + _REACH_M) % (2 * _REACH_M) - _REACH_M  # the same rain around every camera
    _draw(linear, place - center, diameter_mm, drift, rotation, K[0, 0], K[0, 2], K[1, 2], bright)


def _drift_mps(states: BodyStates) -> Float64:
    """How fast still air passes the ego vehicle (2,), in its axes x and y."""
    cos, sin = math.cos(states.yaw_rad[EGO]), math.sin(states.yaw_rad[EGO])
    vx, vy = states.velocity_mps[EGO, :2]
    return np.array([-(cos * vx + sin * vy), -(cos * vy - sin * vx)])


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


@kernel
def _pixel(p: Float64, rotation: Float64, f: float, cx: float, cy: float) -> tuple[float, float, float]:
    x = rotation[0, 0] * p[0] + rotation[1, 0] * p[1] + rotation[2, 0] * p[2]
    y = rotation[0, 1] * p[0] + rotation[1, 1] * p[1] + rotation[2, 1] * p[2]
    z = rotation[0, 2] * p[0] + rotation[1, 2] * p[1] + rotation[2, 2] * p[2]
    z_or_one = z if z >= _NEAREST_M else 1.0
    return cx + f * x / z_or_one, cy + f * y / z_or_one, z


@kernel
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
