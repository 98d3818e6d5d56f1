"""What a LiDAR receives through the air: the echo of its target, that of fog or of a drop, or nothing."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Bool, Float64, freeze_fields
from fbench.replay.atmosphere.fog import FogReturn, fog_echoes
from fbench.replay.atmosphere.rain import SCATTERED, WEAKEST, rain_echoes
from fbench.replay.weather import CLEAR_MOR_M, Weather, extinction_per_m, fog_extinction_per_m, fog_of

JUST_SEEN = 0.1
"""Reflectivity of the target that is just seen at the sensor's range in clear air, at normal incidence."""
FAINTEST = 1 / 255
"""Intensity below which the fog's echo goes unnoticed (Hahner et al. 2021: one step of 8 bits)."""


@dataclass(frozen=True, eq=False)
class Echoes:
    """The strongest echo of each of N beams."""

    range_m: Float64
    """(N,) infinite where nothing comes back."""
    intensity: Float64
    """(N,) received power, corrected for range: reflectivity times exp(-2 extinction range); not clipped."""
    is_scattered: Bool
    """(N,) whether it is that of fog or of a drop before the target."""

    def __post_init__(self) -> None:
        one = ("f8", ("N",))
        freeze_fields(self, range_m=one, intensity=one, is_scattered=("?", ("N",)))


def power_floor(range_m: float) -> float:
    """Return the weakest power that is received, in units of reflectivity / m^2."""
    clear = fog_extinction_per_m(Weather(visibility_m=CLEAR_MOR_M))
    return float(JUST_SEEN * np.exp(-2 * clear * range_m) / range_m**2)


def echoes(
    range_m: Float64, reflectivity: Float64, weather: Weather, sensor_range_m: float, rng: np.random.Generator
) -> Echoes:
    """Return what beams to targets at `range_m` (N,) of `reflectivity` (N,) receive; both as for those without target:
    infinite and 0.

    Power is reflectivity exp(-2 extinction range) / range^2. Where fog answers more strongly than the target, which
    depends on the distance alone in Hahner's model, its echo is received instead. The model relates the fog's echo to
    the target's, so a beam without a target has none.
    """
    through_rain = _through_rain if weather.rain_mm_h > 0 else _through_dry_air
    hard = through_rain(range_m, reflectivity, weather, power_floor(sensor_range_m), rng)
    fog = fog_of(weather)
    drowned = np.isfinite(range_m) & (range_m > fog.switch_m) & ~hard.is_scattered
    return _with_fog(hard, np.flatnonzero(drowned), fog, range_m, reflectivity, rng) if drowned.any() else hard


def _through_dry_air(
    range_m: Float64, reflectivity: Float64, weather: Weather, floor: float, rng: np.random.Generator
) -> Echoes:
    intensity = reflectivity * np.exp(-2 * extinction_per_m(weather) * range_m)
    received = intensity >= floor * range_m * range_m
    return Echoes(np.where(received, range_m, np.inf), intensity * received, np.zeros(len(range_m), bool))


def _through_rain(
    range_m: Float64, reflectivity: Float64, weather: Weather, floor: float, rng: np.random.Generator
) -> Echoes:
    """Return what LISA's model lets through: echoes are lost, come from drops, and are noisy where they are weak."""
    equal_range_m = float(np.sqrt(WEAKEST / floor))
    rain = rain_echoes(weather.rain_mm_h, extinction_per_m(weather), range_m, reflectivity, rng, equal_range_m)
    received_m = np.where(np.isfinite(rain.range_m), rain.range_m, 0.0)
    return Echoes(rain.range_m, rain.power * received_m * received_m, rain.label == SCATTERED)


def _with_fog(
    hard: Echoes, drowned: np.ndarray[tuple[int, ...], np.dtype[np.int64]], fog: FogReturn, range_m: Float64,
    reflectivity: Float64, rng: np.random.Generator,
) -> Echoes:  # fmt: skip
    soft = fog_echoes(fog, range_m[drowned], rng)
    strength = reflectivity[drowned] * soft.strength
    noticed = strength >= FAINTEST
    at_m, intensity, is_scattered = hard.range_m.copy(), hard.intensity.copy(), hard.is_scattered.copy()
    at_m[drowned] = np.where(noticed, soft.range_m, np.inf)
    intensity[drowned] = strength * noticed
    is_scattered[drowned] = noticed
    return Echoes(at_m, intensity, is_scattered)
