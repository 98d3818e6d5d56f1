"""Lens distortion: from directions to normalized image coordinates (f = 1, center 0) and back.

Formulas are those of OpenCV (calib3d, "Camera Calibration and 3D Reconstruction" and "Fisheye camera model"). All of
them fold back beyond some angle, where a fit says nothing any more: a lens sees nothing from there on.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar, TypeAlias

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.rig import CameraModel

_FARTHEST = 1e4  # Directions are recovered up to this tangent of the angle to the axis
_BORDER_RAYS = 128
_INSIDE = 1 - 1e-6


@dataclass(frozen=True)
class _Polynomial:
    """Brown and Conrady's lens, with a denominator where it is rational: r (1 + k1 r2 + k2 r4 + k3 r6) / (1 + k4 r2 +
    k5 r4 + k6 r6) and tangential p1, p2, for r = tan(angle to the axis).
    """

    top: tuple[float, float, float]  # k1, k2, k3
    tangential: tuple[float, float]  # p1, p2
    bottom: tuple[float, float, float] = (0.0, 0.0, 0.0)  # k4, k5, k6
    is_wide: ClassVar[bool] = False
    """Whether a lens may see what is beside and behind the image plane, so that depth is distance."""

    @cached_property
    def max_r2(self) -> float:
        """Where the radial part stops to grow: the first root of its derivative, or of the denominator."""
        n, d = [1.0, *self.top], [1.0, *self.bottom]
        polynomial = np.polynomial.polynomial  # imported on first use
        cross = polynomial.polysub(
            polynomial.polymul(polynomial.polyder(n), d), polynomial.polymul(n, polynomial.polyder(d))
        )
        slope = polynomial.polyadd(polynomial.polymul(n, d), polynomial.polymul([0.0, 2.0], cross))
        return min(_first_root(slope), _first_root(np.array(d)))

    @property
    def border(self) -> Float64:
        """Directions (M, 3) all around, on the border of what a lens sees; none where that is the image plane."""
        if not np.isfinite(self.max_r2):
            return np.zeros((0, 3))
        around = _around() * np.sqrt(self.max_r2) * _INSIDE
        return np.column_stack([around, np.ones(len(around))])

    def bend(self, xyz: Float64) -> Float64:
        """Image coordinates (N, 2) of directions (N, 3), NaN where a lens doesn't see them."""
        z = np.where(xyz[:, 2] > 0, xyz[:, 2], np.nan)
        x, y = xyz[:, 0] / z, xyz[:, 1] / z
        r2 = x * x + y * y
        r2[~(r2 < self.max_r2)] = np.nan
        scale, (p1, p2) = self._scale(r2), self.tangential
        xy2 = 2 * x * y
        u = x * scale + p1 * xy2 + p2 * (r2 + 2 * x * x)
        v = y * scale + p1 * (r2 + 2 * y * y) + p2 * xy2
        return np.stack([u, v], axis=1)

    def undistort(self, xy: Float64) -> Float64:
        """Unit directions (N, 3) that image coordinates (N, 2) come from, NaN where there are none."""
        limit = min(np.sqrt(self.max_r2), _FARTHEST)
        far = np.hypot(xy[:, 0], xy[:, 1])
        r = _invert(self._radius, self._slope, far, limit)
        if self.tangential == (0.0, 0.0):
            guess = xy * _share(r, far)
        else:  # just beyond the radial limit the tangential part may still reach
            reach = self._radius(np.array([limit * _INSIDE]))
            r = np.where(np.isnan(r) & (far < 2 * reach), limit * 0.999, r)
            with np.errstate(all="ignore"):  # steps may lead anywhere
                guess = self._refine(xy * _share(r, far), xy)
        rays = np.column_stack([guess, np.ones(len(guess))])
        return np.asarray(rays / np.sqrt((rays * rays).sum(axis=1))[:, None], np.float64)

    def _scale(self, r2: Float64) -> Float64:
        (a, b, c), (d, e, f) = self.top, self.bottom
        top = 1 + r2 * (a + r2 * (b + r2 * c))
        return top if self.bottom == (0.0, 0.0, 0.0) else np.asarray(top / (1 + r2 * (d + r2 * (e + r2 * f))))

    def _scale_slope(self, r2: Float64) -> Float64:
        """Derivative of `_scale` by r2."""
        (a, b, c), (d, e, f) = self.top, self.bottom
        low = 1 + r2 * (d + r2 * (e + r2 * f))
        high, dhigh = 1 + r2 * (a + r2 * (b + r2 * c)), a + r2 * (2 * b + 3 * r2 * c)
        return np.asarray((dhigh * low - high * (d + r2 * (2 * e + 3 * r2 * f))) / (low * low), np.float64)

    def _radius(self, r: Float64) -> Float64:
        return r * self._scale(r * r)

    def _slope(self, r: Float64) -> Float64:
        return self._scale(r * r) + 2 * r * r * self._scale_slope(r * r)

    def _refine(self, guess: Float64, wanted: Float64) -> Float64:
        """Newton's method in two dimensions; NaN where it doesn't arrive."""
        p1, p2 = self.tangential
        for _ in range(30):
            x, y = guess[:, 0], guess[:, 1]
            scale, slope = self._scale(x * x + y * y), 2 * self._scale_slope(x * x + y * y)
            du, dv = (self.bend(np.column_stack([guess, np.ones(len(guess))])) - wanted).T
            xx = scale + slope * x * x + 2 * p1 * y + 6 * p2 * x
            yy = scale + slope * y * y + 6 * p1 * y + 2 * p2 * x
            xy = slope * x * y + 2 * p1 * x + 2 * p2 * y
            step = np.stack([yy * du - xy * dv, xx * dv - xy * du], axis=1) / (xx * yy - xy * xy)[:, None]
            guess = guess - step
            if not np.nanmax(np.abs(step), initial=0.0) > 1e-14:
                break
        missed = np.abs(self.bend(np.column_stack([guess, np.ones(len(guess))])) - wanted).max(axis=1, initial=0.0)
        guess[~(missed < 1e-9 * (1 + np.abs(wanted).max(axis=1, initial=0.0)))] = np.nan
        return guess


@dataclass(frozen=True)
class _Fisheye:
    """Kannala and Brandt's lens: a (1 + k1 a2 + k2 a4 + k3 a6 + k4 a8) for the angle a to the axis [rad]."""

    k: tuple[float, float, float, float]
    is_wide: ClassVar[bool] = True

    @cached_property
    def max_rad(self) -> float:
        """Angle to the axis at which the mapping stops to grow."""
        slope = [1.0, *(k * power for k, power in zip(self.k, (3, 5, 7, 9), strict=True))]
        return float(min(np.sqrt(_first_root(np.array(slope))), np.pi))

    @property
    def border(self) -> Float64:
        angle = self.max_rad * _INSIDE
        return np.column_stack([_around() * np.sin(angle), np.full(_BORDER_RAYS, np.cos(angle))])

    def bend(self, xyz: Float64) -> Float64:
        beside = np.hypot(xyz[:, 0], xyz[:, 1])
        angle = np.arctan2(beside, xyz[:, 2])
        angle[~(angle < self.max_rad)] = np.nan
        share = _share(self._radius(angle), beside)
        share[np.isnan(angle)] = np.nan
        return xyz[:, :2] * share

    def undistort(self, xy: Float64) -> Float64:
        far = np.hypot(xy[:, 0], xy[:, 1])
        angle = _invert(self._radius, self._slope, far, self.max_rad)
        return np.column_stack([xy * _share(np.sin(angle), far), np.cos(angle)])

    def _radius(self, angle: Float64) -> Float64:
        (a, b, c, d), square = self.k, angle * angle
        return np.asarray(angle * (1 + square * (a + square * (b + square * (c + square * d)))))

    def _slope(self, angle: Float64) -> Float64:
        (a, b, c, d), square = self.k, angle * angle
        return np.asarray(1 + square * (3 * a + square * (5 * b + square * (7 * c + square * 9 * d))))


Lens: TypeAlias = _Polynomial | _Fisheye  # A lens that isn't a pinhole


def _first_root(ascending: Array) -> float:
    """Smallest positive real root of a polynomial that is 1 at 0; infinite where there is none. Its inverse is the
    largest root of the polynomial with the coefficients in reverse, whose leading one is 1.
    """
    roots = np.polynomial.polynomial.polyroots(ascending[::-1])
    real = roots.real[(np.abs(roots.imag) <= 1e-7 * np.abs(roots)) & (roots.real > 1 / _FARTHEST**2)]
    return float(1 / real.max()) if len(real) else float(np.inf)


def _around() -> Float64:
    angle = np.arange(_BORDER_RAYS) * (2 * np.pi / _BORDER_RAYS)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _share(part: Float64, whole: Float64) -> Float64:
    """Column (N, 1) of `part` by `whole`; 0 where the latter is."""
    return np.divide(part, whole, out=np.zeros_like(whole), where=whole != 0)[:, None]


def _invert(
    value: Callable[[Float64], Float64], slope: Callable[[Float64], Float64], wanted: Float64, limit: float
) -> Float64:
    """Where a function that grows from 0 at 0 up to `limit` reaches the wanted values (N,); NaN where it doesn't.
    Newton's method, kept between bounds by halving.
    """
    low, high = np.zeros(len(wanted)), np.full(len(wanted), limit)
    at = np.minimum(wanted, limit / 2)
    for _ in range(100):
        off = value(at) - wanted
        low, high = np.where(off <= 0, at, low), np.where(off >= 0, at, high)
        rise = slope(at)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            better = at - off / rise
        better = np.where((better > low) & (better < high), better, (low + high) / 2)
        step, at = np.abs(better - at), better
        if not np.nanmax(step / (1 + at), initial=0.0) > 1e-14:
            break
    reached = value(np.array([limit * _INSIDE]))[0]
    return np.where(wanted <= reached, at, np.nan)


_COUNTS: Mapping[str, tuple[int, ...]] = {"plumb_bob": (4, 5), "rational_polynomial": (8,), "fisheye": (4,)}
"""How many coefficients each model has."""
MODELS = tuple(_COUNTS)  # Names of the distortion models that can be projected with, as in ROS
_ALIASES = {
    "radtan": "plumb_bob", "rational": "rational_polynomial",
    "equidistant": "fisheye", "equi": "fisheye", "kannala_brandt": "fisheye", "kannala_brandt4": "fisheye",
}  # fmt: skip


def lens_of(camera: CameraModel) -> Lens | None:
    """Return the lens that bends a camera's rays; `None`: a pinhole. Coefficients that are all zero mean none, but not
    for a fisheye: it is equidistant then. Raises LogError where the model isn't known, or its coefficients don't fit
    it.
    """
    return _lens(camera.distortion_model, tuple(camera.distortion.tolist()))


@lru_cache(maxsize=256)
def _lens(model: str, coefficients: tuple[float, ...]) -> Lens | None:
    name, given, about = _ALIASES.get(model, model), len(coefficients), f"distortion model '{model}'"
    if not coefficients or (name != "fisheye" and not any(coefficients)):
        return None
    if name not in _COUNTS:
        raise LogError(f"{about} isn't supported, only {', '.join(MODELS)}", "CAL001")
    if not np.isfinite(coefficients).all():
        raise LogError(f"{about}: coefficients aren't finite", "CAL001")
    if name == "rational_polynomial" and given in (12, 14) and any(coefficients[8:]):
        raise LogError(f"{about} with thin prism or tilt isn't supported, only 8 values", "CAL001")
    num = max(_COUNTS[name])
    if given not in _COUNTS[name] and (given < num or any(coefficients[num:])):  # recorders append zeros at will
        raise LogError(f"{about} has {given} coefficients, not {' or '.join(map(str, _COUNTS[name]))}", "CAL001")
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients[:num], *[0.0] * 8)[:8]
    if name == "fisheye":
        return _Fisheye((k1, k2, p1, p2))  # its k1 to k4
    return _Polynomial((k1, k2, k3), (p1, p2), (k4, k5, k6))
