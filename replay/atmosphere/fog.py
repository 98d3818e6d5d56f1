"""What a LiDAR receives in fog: the weakened echo of the target, or a soft one of the fog itself.

Rasshofer et al. 2011 (Adv. Radio Sci. 9) and Hahner et al. 2021 (ICCV), for a pulse of sin^2 shape.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import lambertw

from fbench.replay.arrays import Array, Bool, Float64, freeze_fields

LIGHT_MPS = 299_792_458.0
PULSE_S = 20e-9
"""Half-power width of the pulse, tau_H; it lasts twice as long."""
NEAR_M, FULL_M = 0.9, 1.0
"""Where the receiver's view begins to cover the beam, and from where it covers all of it."""
TARGET = 1e-6 / np.pi
"""Differential reflectivity beta_0 of the target that intensities refer to."""
BACKSCATTER = 0.046
"""Backscatter coefficient of fog times its visibility."""
CONSTANT_FROM_M = 5.0
"""From here on the strongest echo of the fog lies before any target."""
_STEP_M = 0.005


@dataclass(frozen=True, eq=False)
class FogReturn:
    """How strong the echoes of targets and of the fog before them are, at one density."""

    alpha_per_m: float
    """Extinction of the air, all that is in it."""
    beta_per_m: float
    """Backscatter of the fog, 0.046 / MOR."""
    integral_s: Float64
    """J(r) at multiples of 5 mm from 0 to 5 m: the largest convolution of pulse and fog up to r."""

    def __post_init__(self) -> None:
        freeze_fields(self, integral_s=("f8", ("K",)))

    @cached_property
    def peak_m(self) -> float:
        """R_f of targets beyond 5 m: where the echo of the fog is strongest."""
        return float(np.argmax(self.integral_s)) * _STEP_M

    @cached_property
    def switch_m(self) -> float:
        """r*: the echo of the fog is stronger than that of every target farther away, whatever its reflectivity.

        Solves r^2 (beta / beta_0) J = exp(-2 alpha r) for r from 5 m on, which holds for any fog of 10 m and more.
        """
        middle = np.sqrt(TARGET / (self.beta_per_m * self.integral_s[-1]))
        return float(lambertw(self.alpha_per_m * middle).real / self.alpha_per_m)

    def soft_range_m(self, range_m: Array) -> Array:
        """Return where the echo of the fog before targets at `range_m` (N,) is strongest."""
        nearer: Array = np.minimum(range_m, self.peak_m)
        return nearer

    def integral(self, range_m: Array) -> Array:
        """Return J (N,) [s] for targets at `range_m` (N,)."""
        grid = np.arange(len(self.integral_s)) * _STEP_M
        value: Array = np.interp(range_m, grid, self.integral_s)
        return value

    def soft_strength(self, range_m: Array) -> Array:
        """Return the echo of the fog, as a share of the intensity that the target at `range_m` (N,) has in vacuum."""
        strength: Array = range_m * range_m * (self.beta_per_m / TARGET) * self.integral(range_m)
        return strength

    def hard_strength(self, range_m: Array) -> Array:
        """Return the echo of the target in the same unit: exp(-2 alpha r)."""
        strength: Array = np.exp(-2 * self.alpha_per_m * range_m)
        return strength


@dataclass(frozen=True, eq=False)
class FogEchoes:
    """The stronger echo of each of N beams."""

    range_m: Float64
    strength: Float64
    """As a share of the intensity that the target has in vacuum; may exceed 1, so sensors clip."""
    soft: Bool
    """Whether it is the fog's."""


def fog_return(alpha_per_m: float, visibility_m: float) -> FogReturn:
    """Return the echoes in fog of a visibility, with `alpha_per_m` the extinction of all that is in the air."""
    return FogReturn(alpha_per_m, BACKSCATTER / visibility_m, np.maximum.accumulate(_convolution(alpha_per_m)))


def fog_echoes(fog: FogReturn, range_m: Array, rng: np.random.Generator) -> FogEchoes:
    """Return what beams to targets at `range_m` (N,) [m] receive; echoes of fog lie at R_f + 10 m Beta(2, 20).

    Hahner's bounded scatter; here never behind the target.
    """
    hard, soft = fog.hard_strength(range_m), fog.soft_strength(range_m)
    is_soft = soft > hard
    scatter = 10 * rng.beta(2, 20, int(is_soft.sum()))  # few: most targets are nearer than r*
    result = np.array(range_m, np.float64)
    result[is_soft] = np.minimum(fog.soft_range_m(result[is_soft]) + scatter, result[is_soft])
    return FogEchoes(result, np.where(is_soft, soft, hard), is_soft)


def _convolution(alpha_per_m: float) -> Float64:
    """Integrate sin^2(pi t / 2 tau) exp(-2 alpha x) / x^2 xi(x) over t, x = R - c t / 2, at every R of the grid.

    With sin^2 a = (1 - cos 2a) / 2 and the cosine of a difference it is made of three running sums; the pulse is
    longer than the grid, so that none of them ever loses its beginning.
    """
    x = np.arange(round(CONSTANT_FROM_M / _STEP_M) + 1) * _STEP_M
    fog = np.exp(-2 * alpha_per_m * x) * np.clip((x - NEAR_M) / (FULL_M - NEAR_M), 0, 1) / np.maximum(x, NEAR_M) ** 2
    turn = x * (2 * np.pi / (LIGHT_MPS * PULSE_S))
    cos, sin = np.cos(turn), np.sin(turn)
    shape = (np.cumsum(fog) - cos * np.cumsum(fog * cos) - sin * np.cumsum(fog * sin)) / 2
    return np.asarray(shape * (_STEP_M * 2 / LIGHT_MPS), np.float64)
