"""Light of sun, sky and air from the weather, and the look of the sky with its value noise.

Light is linear; the unit of luminance is white in clear daylight, a perfect diffuser under 50,000 lx.
"""

import math
from math import cos, exp, floor, pi, radians, sin, sqrt
from typing import NamedTuple, TypeAlias

import numpy as np

from fbench.replay.conditions.weather import Weather, extinction_per_m
from fbench.replay.data.arrays import Float32
from fbench.replay.geometry.kernels import kernel_part

_SIDE, _LAST = 128, 127  # After so many values smooth noise repeats itself; sums of octaves hide it


def _values() -> Float32:
    """Whole numbers turned into others that look random, as in `hash_noise`: from -1 to 1."""
    h = np.arange(1, _SIDE * _SIDE + 1, dtype=np.int64) * 73856093 & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 2246822519) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 3266489917) & 0xFFFFFFFF
    return np.asarray(((h ^ (h >> 16)) & 0xFFFFFF) * (2.0 / 0xFFFFFF) - 1.0, np.float32)


_VALUES = _values()


@kernel_part
def hash_noise(x: int, y: int, salt: int) -> float:
    """Return a number from -1 to 1 that belongs to two whole numbers and a salt."""
    h = (x * 73856093) ^ (y * 19349663) ^ (salt * 83492791)
    h = ((h ^ (h >> 15)) * 2246822519) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 3266489917) & 0xFFFFFFFF
    h ^= h >> 16
    return (h & 0xFFFFFF) * (2.0 / 0xFFFFFF) - 1.0


@kernel_part
def value_noise(u: float, v: float, salt: int) -> float:
    """Return smooth noise from -1 to 1 with one value a unit square."""
    x, y = floor(u), floor(v)
    a, b = u - x, v - y
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    i, j = int(x) + salt * 37, int(y) + salt * 59
    left, right = i & _LAST, (i + 1) & _LAST
    lower, upper = (j & _LAST) * _SIDE, ((j + 1) & _LAST) * _SIDE
    low = _VALUES[lower + left] * (1 - a) + _VALUES[lower + right] * a
    high = _VALUES[upper + left] * (1 - a) + _VALUES[upper + right] * a
    return float(low * (1 - b) + high * b)


@kernel_part
def fractal_noise(u: float, v: float, octaves: int, salt: int) -> float:
    """Return noise with details: every octave is twice as fine and half as strong; within -2 to 2."""
    total, weight = 0.0, 1.0
    for octave in range(octaves):
        total += weight * value_noise(u, v, salt + octave)
        u, v, weight = 2.03 * u + 7.1, 2.03 * v - 3.7, 0.5 * weight
    return total


Rgb: TypeAlias = tuple[float, float, float]
DAYLIGHT_LUX = 50_000.0
_LIT_STREET_LUX = 12.0  # Illuminance of a lit street by night; EN 13201-2 asks 7.5 to 15 lx of residential roads
_GLIMMER = 0.6 / DAYLIGHT_LUX  # What the lamps of a city make air and clouds shine with, by night
_DISC = 0.99996  # Cosine of the sun's radius, half a degree
_DARK_LUX, _DIM_LUX = 500.0, 2_000.0  # Below, street lamps shine; and vehicles have their lights on


class Light(NamedTuple):
    """The light of one weather; colors are linear red, green, blue."""

    sun: tuple[float, float, float]  # Unit vector towards the sun, in the world
    direct: Rgb  # Illuminance by the sun of a plane that faces it, in units of 50,000 lx; 0 where it doesn't shine
    ambient: Rgb  # Illuminance by the sky of a horizontal plane
    zenith: Rgb
    horizon: Rgb  # Luminances of the sky
    glow: Rgb  # Luminance that the sky has more of around the sun
    airlight: Rgb  # Luminance of the horizon through endless air (Koschmieder)
    extinction_per_m: float
    clouds: float  # Share of the sky that they cover; 1: overcast
    wet: float  # How wet the ground is, 0 to 1
    is_dark: bool  # Whether street lamps shine and windows are lit
    is_dim: bool  # Whether vehicles have their lights on
    exposure: float  # Factor from luminance to the image, where 1 is white
    noise_gain: float  # Factor on the variance of noise against that in daylight


def light_of(weather: Weather) -> Light:
    """Return the light of a weather."""
    extinction = extinction_per_m(weather)
    clear = _clearness(weather, extinction)
    elevation = radians(weather.sun_elevation_deg)
    total = weather.lux / DAYLIGHT_LUX
    share = 0.8 * clear * (1 - exp(-max(weather.sun_elevation_deg, 0.0) / 10)) if elevation > 0 else 0.0
    direct = total * share / max(sin(elevation), 0.05)
    diffuse = total * (1 - share)
    azimuth, warm = radians(weather.sun_azimuth_deg), exp(-max(weather.sun_elevation_deg + 2, 0.0) / 9)
    tint = _mix((1.0, 1.0, 1.0), (0.80, 0.98, 1.25), clear)
    # To bring the illuminance of the scene, and of its street lamps by night, to about the same level in the image: a
    # little less in little light, as cameras do. A function of the weather alone, so that stereo pairs agree.
    illuminance = diffuse + 0.5 * direct * (0.4 + sin(max(elevation, 0.0)))
    exposure = (1 - 0.62 * math.exp(-(math.log10(max(weather.lux, 1e-3) / 150) ** 2))) * (
        1.15 * math.pow(illuminance + _LIT_STREET_LUX / DAYLIGHT_LUX, -0.90)
    )
    return Light(
        sun=(cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation)),
        direct=_times(_mix((1.04, 1.0, 0.93), (1.45, 0.92, 0.45), warm), direct),
        ambient=_times(tint, diffuse),
        zenith=_times(_mix((0.85, 0.88, 0.93), (0.35, 0.75, 1.5), clear), diffuse * (1.0 + 0.7 * clear)),
        horizon=_times(_mix((1.05, 1.06, 1.08), (1.6, 1.85, 2.1), clear), diffuse),
        glow=_times((1.5, 0.85, 0.35), diffuse * (0.25 + 1.2 * warm) * (0.15 + clear) + 0.05 * direct),
        airlight=_times(_mix((0.70, 0.72, 0.74), (1.1, 1.25, 1.45), clear), diffuse + 0.3 * direct * clear + _GLIMMER),
        extinction_per_m=extinction,
        clouds=1 - 0.6 * clear,
        wet=min(1.0, weather.rain_mm_h / 5),
        is_dark=weather.lux < _DARK_LUX,
        is_dim=weather.lux < _DIM_LUX or weather.rain_mm_h > 0 or weather.visibility_m < 500,
        exposure=exposure,
        noise_gain=max(1.0, exposure / 80),
    )


def _clearness(weather: Weather, extinction: float) -> float:
    """How clear the sky is, 0 to 1, by how much light comes through: some 50,000 lx at 45 degrees, less when low."""
    height = max(sin(radians(weather.sun_elevation_deg)), 0.0) / sin(pi / 4)
    cloudless = max(DAYLIGHT_LUX * height**0.85, 100.0)
    share = min(1.0, max(0.0, (weather.lux / cloudless - 0.25) / 0.5))
    below = weather.sun_elevation_deg <= 0
    return (0.7 if below else share) * exp(-300 * max(0.0, extinction - 5e-4)) * (0.0 if weather.rain_mm_h > 0 else 1.0)


def _mix(a: Rgb, b: Rgb, share: float) -> Rgb:
    return (a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share)


def _times(color: Rgb, factor: float) -> Rgb:
    return (color[0] * factor, color[1] * factor, color[2] * factor)


@kernel_part
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


@kernel_part
def sky(light: Light, x: float, y: float, z: float, salt: int) -> Rgb:
    """Return the luminance of the sky in a direction (unit vector); clouds are those of a salt."""
    red, green, blue = plain_sky(light, x, y, z)
    if z > 0.01:  # clouds
        u, v = 1.1 * x / (z + 0.12), 1.1 * y / (z + 0.12)
        density = 0.5 + 0.5 * fractal_noise(u, v, 5, salt) - (1 - light.clouds)
        cover = min(1.0, max(0.0, density / 0.45)) * min(1.0, z * 12)
        cover = cover * cover * (3 - 2 * cover) * (0.35 + 0.5 * sqrt(light.clouds))
        shade = 1.0 - 0.28 * min(1.0, max(0.0, density))
        white = 0.55 * light.direct[1] + 1.05 * light.ambient[1] + 0.3 * light.horizon[1]
        warm = light.direct[0] / light.direct[1] if light.direct[1] > 0 else 1.0
        cool = light.direct[2] / light.direct[1] if light.direct[1] > 0 else 1.0
        red += cover * (white * shade * warm - red)
        green += cover * (white * shade - green)
        blue += cover * (white * shade * cool - blue)
    haze = exp(-max(z, 0.0) * (6.0 + 0.01 / light.extinction_per_m)) if light.extinction_per_m < 0.005 else 1.0
    red += (light.airlight[0] - red) * haze
    green += (light.airlight[1] - green) * haze
    blue += (light.airlight[2] - blue) * haze
    toward = x * light.sun[0] + y * light.sun[1] + z * light.sun[2]
    if toward > _DISC and light.direct[1] > 0:
        red, green, blue = red + 90 * light.direct[0], green + 90 * light.direct[1], blue + 90 * light.direct[2]
    return red, green, blue
