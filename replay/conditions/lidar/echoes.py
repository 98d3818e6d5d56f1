"""Echoes of a LiDAR in fog, rain and snow: the weakened echo of the target, or that of fog or a particle before it.

Rasshofer et al. 2011 (Adv. Radio Sci. 9) and Hahner et al. 2021 (ICCV), for a pulse of sin^2 shape.

Goodin et al. 2019 and LISA (Kilic et al. 2021): every beam meets random drops or flakes, and the strongest echo counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import tan

import numpy as np

from fbench.replay.data.arrays import Array, Bool, Float64, freeze_fields

LIGHT_MPS = 299_792_458.0
PULSE_S = 20e-9  # Half-power width of the pulse, tau_H; it lasts twice as long
NEAR_M, FULL_M = 0.9, 1.0  # Where the receiver's view begins to cover the beam, and from where it covers all of it
TARGET = 1e-6 / np.pi  # Differential reflectivity beta_0 of the target that intensities refer to
BACKSCATTER = 0.046  # Backscatter coefficient of fog times its visibility
CONSTANT_FROM_M = 5.0  # From here on the strongest echo of the fog lies before any target
_STEP_M = 0.005


@dataclass(frozen=True, eq=False)
class FogReturn:
    """How strong the echoes of targets and of the fog before them are, at one density."""

    alpha_per_m: float  # Extinction of the air, all that is in it
    beta_per_m: float  # Backscatter of the fog, 0.046 / MOR
    integral_s: Float64  # J(r) at multiples of 5 mm from 0 to 5 m: the largest convolution of pulse and fog up to r

    def __post_init__(self) -> None:
        freeze_fields(self, integral_s=("f8", ("K",)))

    @cached_property
    def peak_m(self) -> float:
        """R_f of targets beyond 5 m: where the echo of the fog is strongest."""
        return float(np.argmax(self.integral_s)) * _STEP_M

    @cached_property
    def switch_m(self) -> float:
        """r*: the echo of the fog is stronger than that of every target farther away, whatever its reflectivity. Solves
        r^2 (beta / beta_0) J = exp(-2 alpha r) for r from 5 m on, which holds for any fog of 10 m and more.
        """
        from scipy.special import lambertw  # takes a while to import

        middle = np.sqrt(TARGET / (self.beta_per_m * self.integral_s[-1]))
        return float(lambertw(self.alpha_per_m * middle).real / self.alpha_per_m)

    def soft_range_m(self, range_m: Array) -> Array:
        """Return where the echo of the fog before targets at `range_m` (N,) is strongest."""
        return np.asarray(np.minimum(range_m, self.peak_m))

    def integral(self, range_m: Array) -> Array:
        """Return J (N,) [s] for targets at `range_m` (N,)."""
        grid = np.arange(len(self.integral_s)) * _STEP_M
        return np.asarray(np.interp(range_m, grid, self.integral_s))

    def soft_strength(self, range_m: Array) -> Array:
        """Return the echo of the fog, as a share of the intensity that the target at `range_m` (N,) has in vacuum."""
        return np.asarray(range_m * range_m * (self.beta_per_m / TARGET) * self.integral(range_m))

    def hard_strength(self, range_m: Array) -> Array:
        """Return the echo of the target in the same unit: exp(-2 alpha r)."""
        return np.asarray(np.exp(-2 * self.alpha_per_m * range_m))


@dataclass(frozen=True, eq=False)
class FogEchoes:
    """The stronger echo of each of N beams."""

    range_m: Float64
    strength: Float64  # As a share of the intensity that the target has in vacuum; may exceed 1, so sensors clip
    soft: Bool  # Whether it is the fog's


def fog_return(alpha_per_m: float, visibility_m: float) -> FogReturn:
    """Return the echoes in fog of a visibility, with `alpha_per_m` the extinction of all that is in the air."""
    return FogReturn(alpha_per_m, BACKSCATTER / visibility_m, np.maximum.accumulate(_convolution(alpha_per_m)))


def fog_echoes(fog: FogReturn, range_m: Array, rng: np.random.Generator) -> FogEchoes:
    """Return what beams to targets at `range_m` (N,) [m] receive; echoes of fog lie at R_f + 10 m Beta(2, 20). Hahner's
    bounded scatter; here never behind the target.
    """
    hard, soft = fog.hard_strength(range_m), fog.soft_strength(range_m)
    is_soft = soft > hard
    scatter = 10 * rng.beta(2, 20, int(is_soft.sum()))  # few: most targets are nearer than r*
    result = np.array(range_m, np.float64)
    result[is_soft] = np.minimum(fog.soft_range_m(result[is_soft]) + scatter, result[is_soft])
    return FogEchoes(result, np.where(is_soft, soft, hard), is_soft)


def _convolution(alpha_per_m: float) -> Float64:
    """Integrate sin^2(pi t / 2 tau) exp(-2 alpha x) / x^2 xi(x) over t, x = R - c t / 2, at every R of the grid. With
    sin^2 a = (1 - cos 2a) / 2 and the cosine of a difference it is made of three running sums; the pulse is longer than
    the grid, so that none of them ever loses its beginning.
    """
    x = np.arange(round(CONSTANT_FROM_M / _STEP_M) + 1) * _STEP_M
    fog = np.exp(-2 * alpha_per_m * x) * np.clip((x - NEAR_M) / (FULL_M - NEAR_M), 0, 1) / np.maximum(x, NEAR_M) ** 2
    turn = x * (2 * np.pi / (LIGHT_MPS * PULSE_S))
    cos, sin = np.cos(turn), np.sin(turn)
    shape = (np.cumsum(fog) - cos * np.cumsum(fog * cos) - sin * np.cumsum(fog * sin)) / 2
    return np.asarray(shape * (_STEP_M * 2 / LIGHT_MPS), np.float64)


LOST, SCATTERED, KEPT = 0, 1, 2  # Labels: no echo is strong enough; a particle's is the strongest; the target's is
SMALLEST_MM = 0.05
DIVERGENCE_RAD = 3e-3
NEAREST_M = 1.5  # Particles nearer than this aren't in the receiver's view
WEAKEST = 0.9  # Reflectivity of the target that is just seen at the range of the sensor
RANGE_M = 200.0
NOISE_M = 0.09
_ALONG_STEP_M = 0.01


@dataclass(frozen=True)
class Particles:
    """Drops or flakes in the air: N(D) = N0 exp(-Lambda D) of them per volume and diameter."""

    per_m3_mm: float
    """N0."""
    slope_per_mm: float
    """Lambda."""
    reflectance: float
    """Share of the light that they send back, ((n - 1) / (n + 1))^2 at normal incidence."""

    @property
    def extinction_per_m(self) -> float:
        """Their geometric cross-sections, each counted twice since they are large against the wavelength: the integral
        of N(D) 2 pi D^2 / 4, pi N0 / Lambda^3.
        """
        return float(np.pi * self.per_m3_mm / self.slope_per_mm**3 * 1e-6)


def rain_drops(rain_mm_h: float) -> Particles:
    """Return the drops of rain above 0 mm/h: N0 8000, Lambda 4.1 R^-0.21 (Marshall and Palmer 1948); n = 1.328 of water
    at 905 nm.
    """
    return Particles(8000.0, float(4.1 * rain_mm_h**-0.21), ((1.328 - 1) / (1.328 + 1)) ** 2)


def snow_flakes(snow_mm_h: float) -> Particles:
    """Return the flakes of snow above 0 mm/h of water: N0 7600 R^-0.87, Lambda 2.55 R^-0.48 (Gunn and Marshall 1958, as
    in LISA); ice has n = 1.3031.
    """
    slope = float(2.55 * snow_mm_h**-0.48)
    return Particles(float(7600 * snow_mm_h**-0.87), slope, ((1.3031 - 1) / (1.3031 + 1)) ** 2)


@dataclass(frozen=True, eq=False)
class ParticleEchoes:
    """The strongest echo of each of N beams."""

    range_m: Float64  # (N,) with the noise of the weak signal, infinite where the echo is lost
    power: Float64
    """(N,) reflectivity times exp(-2 alpha r) / r^2; times r^2 it is what sensors call intensity; 0 where lost."""
    label: Array  # (N,) uint8: `LOST`, `SCATTERED` or `KEPT`

    def __post_init__(self) -> None:
        one = ("f8", ("N",))
        freeze_fields(self, range_m=one, power=one, label=("u1", ("N",)))


def power_floor(sensor_range_m: float = RANGE_M) -> float:
    """Return the weakest power that counts: a target of 90 % at the range of the sensor in vacuum."""
    return WEAKEST / sensor_range_m**2


def particle_echoes(
    particles: Sequence[Particles], extinction_per_m: float, range_m: Array, reflectivity: Array,
    rng: np.random.Generator, sensor_range_m: float = RANGE_M,
) -> ParticleEchoes:  # fmt: skip
    """Return what beams to targets receive; one that meets no target has a reflectivity of 0 or an infinite range.

    The range noise is 0.09 m / sqrt(2 P / P_min). Exact, though only those particles are drawn whose echo is above the
    floor: the sizes of larger ones are exponential too. `extinction_per_m` is that of all in the air; `range_m` (N,)
    and `reflectivity` (N,), 0 to 1 with the cosine of incidence, are of the targets; `sensor_range_m` is how far a
    reflectivity of 90 % is seen in vacuum. Without particles echoes are only weakened, lost and noisy.
    """
    floor = power_floor(sensor_range_m)
    power = np.zeros(len(range_m))
    target = np.isfinite(range_m) & (reflectivity > 0)
    distance = np.asarray(range_m, np.float64)[target]
    power[target] = reflectivity[target] * np.exp(-2 * extinction_per_m * distance) / (distance * distance)
    result = np.array(range_m, np.float64)
    scattered = np.zeros(len(power), bool)
    for kind in particles:
        beam, particle_m, particle_power = _strongest(kind, extinction_per_m, floor, len(power), rng)
        wins = (particle_m < range_m[beam]) & (particle_power > power[beam])
        result[beam[wins]], power[beam[wins]], scattered[beam[wins]] = particle_m[wins], particle_power[wins], True
    lost = power < floor
    noise = rng.standard_normal(len(power)) * (NOISE_M / np.sqrt(2 * np.maximum(power, floor) / floor))
    label = np.where(lost, LOST, np.where(scattered, SCATTERED, KEPT)).astype(np.uint8)
    return ParticleEchoes(np.where(lost, np.inf, result + noise), np.where(lost, 0.0, power), label)


def _strongest(
    kind: Particles, extinction_per_m: float, floor: float, num_beams: int, rng: np.random.Generator
) -> tuple[Array, Float64, Float64]:
    """Draw all particles in beams of endless length whose echo is above the floor: a Poisson process along each beam.
    Returns the strongest of every beam that has one: the beam, how far away it is [m] and the power of its echo.
    """
    rate, reflectance = kind.slope_per_mm, kind.reflectance
    farthest_m = float(np.sqrt(reflectance / floor))  # where the echo of a full beam falls to the floor in clear air
    r = np.arange(NEAREST_M, max(farthest_m, NEAREST_M) + _ALONG_STEP_M, _ALONG_STEP_M)
    smallest = _smallest_mm(r, reflectance, extinction_per_m, floor)
    beam_m2 = np.pi * (r * tan(DIVERGENCE_RAD) / 2) ** 2
    per_m = np.where(np.isfinite(smallest), kind.per_m3_mm / rate * np.exp(-rate * smallest) * beam_m2, 0.0)
    expected = np.concatenate([[0.0], np.cumsum((per_m[1:] + per_m[:-1]) * (_ALONG_STEP_M / 2))])
    num = int(rng.poisson(expected[-1] * num_beams))
    beam = rng.integers(0, num_beams, num)
    distance = np.interp(rng.random(num) * expected[-1], expected, r)
    size = _smallest_mm(distance, reflectance, extinction_per_m, floor) + rng.exponential(1 / rate, num)
    # What the particle reflects, of the share of the beam that it fills.
    share = np.minimum((size / (1000 * tan(DIVERGENCE_RAD) * distance)) ** 2, 1)
    power = reflectance * np.exp(-2 * extinction_per_m * distance) * share / (distance * distance)
    order = np.lexsort((distance, -power, beam))
    ordered = beam[order]
    first = order[np.concatenate([[True], ordered[1:] != ordered[:-1]])[:num]]
    return beam[first], distance[first], power[first]


def _smallest_mm(distance_m: Float64, reflectance: float, extinction_per_m: float, floor: float) -> Float64:
    """Diameter above which a particle's echo is above the floor; infinite where even a full beam's isn't."""
    share = floor / (reflectance * np.exp(-2 * extinction_per_m * distance_m)) * distance_m * distance_m
    beam_mm = 1000 * tan(DIVERGENCE_RAD) * distance_m
    return np.asarray(np.where(share <= 1, np.maximum(beam_mm * np.sqrt(share), SMALLEST_MM), np.inf), np.float64)
