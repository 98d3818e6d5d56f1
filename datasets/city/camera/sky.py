"""The sky: brightness by height and sun, haze, clouds, and the sun itself."""

from math import exp, sqrt

from fbench.datasets.city.camera.light import Light, Rgb
from fbench.datasets.city.camera.noise import fractal_noise
from fbench.replay.kernels import kernel

_DISC = 0.99996
"""Cosine of the sun's radius, half a degree."""


@kernel
def plain_sky(light: Light, x: float, y: float, z: float) -> Rgb:
    """Return the luminance of a cloudless sky in a direction, without the sun's disc: what smooth surfaces mirror."""
    height = max(z, 0.0)
    low = exp(-6.0 * height)
    near_sun = max(0.0, x * light.sun[0] + y * light.sun[1] + z * light.sun[2])
    glow = 0.6 * near_sun**8 * (0.25 + 0.75 * low) + 1.2 * near_sun**64
    red = light.zenith[0] + (light.horizon[0] - light.zenith[0]) * low + light.glow[0] * glow
    green = light.zenith[1] + (light.horizon[1] - light.zenith[1]) * low + light.glow[1] * glow
    blue = light.zenith[2] + (light.horizon[2] - light.zenith[2]) * low + light.glow[2] * glow
    return red, green, blue


@kernel
def sky(light: Light, x: float, y: float, z: float, salt: int) -> Rgb:
    """Return the luminance of the sky in a direction (unit vector); clouds are those of a salt."""
    red, green, blue = plain_sky(light, x, y, z)
    if z > 0.01:
        red, green, blue = _clouded(light, red, green, blue, x, y, z, salt)
    haze = exp(-max(z, 0.0) * (6.0 + 0.01 / light.extinction_per_m)) if light.extinction_per_m < 0.005 else 1.0
    red += (light.airlight[0] - red) * haze
    green += (light.airlight[1] - green) * haze
    blue += (light.airlight[2] - blue) * haze
    toward = x * light.sun[0] + y * light.sun[1] + z * light.sun[2]
    if toward > _DISC and light.direct[1] > 0:
        red, green, blue = red + 90 * light.direct[0], green + 90 * light.direct[1], blue + 90 * light.direct[2]
    return red, green, blue


@kernel
def _clouded(light: Light, red: float, green: float, blue: float, x: float, y: float, z: float, salt: int) -> Rgb:
    u, v = 1.1 * x / (z + 0.12), 1.1 * y / (z + 0.12)
    density = 0.5 + 0.5 * fractal_noise(u, v, 5, salt) - (1 - light.clouds)
    cover = min(1.0, max(0.0, density / 0.45)) * min(1.0, z * 12)
    cover = cover * cover * (3 - 2 * cover) * (0.35 + 0.5 * sqrt(light.clouds))
    shade = 1.0 - 0.28 * min(1.0, max(0.0, density))
    white = 0.55 * light.direct[1] + 1.05 * light.ambient[1] + 0.3 * light.horizon[1]
    warm = light.direct[0] / light.direct[1] if light.direct[1] > 0 else 1.0
    cool = light.direct[2] / light.direct[1] if light.direct[1] > 0 else 1.0
    return (
        red + cover * (white * shade * warm - red),
        green + cover * (white * shade - green),
        blue + cover * (white * shade * cool - blue),
    )
