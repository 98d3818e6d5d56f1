"""Which lens a camera model means."""

from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np

from fbench.replay.data import CameraModel
from fbench.replay.errors import LogError
from fbench.replay.geometry.lenses import Fisheye, Lens, Polynomial

MODELS = ("plumb_bob", "rational_polynomial", "fisheye")
"""Names of the distortion models that can be projected with, as in ROS."""
_ALIASES = {
    "radtan": "plumb_bob", "rational": "rational_polynomial",
    "equidistant": "fisheye", "equi": "fisheye", "kannala_brandt": "fisheye", "kannala_brandt4": "fisheye",
}  # fmt: skip


def lens_of(camera: CameraModel) -> Lens | None:
    """Return the lens that bends a camera's rays; `None`: a pinhole.

    Coefficients that are all zero mean none, but not for a fisheye: it is equidistant then.

    Raises:
        LogError: where the model isn't known, or its coefficients don't fit it.
    """
    return _lens(camera.distortion_model, tuple(camera.distortion.tolist()))


@lru_cache(maxsize=256)
def _lens(model: str, coefficients: tuple[float, ...]) -> Lens | None:
    name = _ALIASES.get(model, model)
    if not coefficients or (name != "fisheye" and not any(coefficients)):
        return None
    if name not in _LENSES:
        raise LogError(f"distortion model '{model}' isn't supported, only {', '.join(MODELS)}", "CAL001")
    if not np.isfinite(coefficients).all():
        raise LogError(f"distortion model '{model}': coefficients aren't finite", "CAL001")
    return _LENSES[name](model, coefficients)


def _plumb_bob(model: str, coefficients: tuple[float, ...]) -> Lens:
    k1, k2, p1, p2, k3 = _required(model, coefficients, (4, 5))
    return Polynomial((k1, k2, k3), (p1, p2))


def _rational(model: str, coefficients: tuple[float, ...]) -> Lens:
    if len(coefficients) in (12, 14) and any(coefficients[8:]):
        raise LogError(f"distortion model '{model}' with thin prism or tilt isn't supported, only 8 values", "CAL001")
    k1, k2, p1, p2, k3, k4, k5, k6 = _required(model, coefficients, (8,))
    return Polynomial((k1, k2, k3), (p1, p2), (k4, k5, k6))


def _fisheye(model: str, coefficients: tuple[float, ...]) -> Lens:
    k1, k2, k3, k4 = _required(model, coefficients, (4,))
    return Fisheye((k1, k2, k3, k4))


_LENSES: Mapping[str, Callable[[str, tuple[float, ...]], Lens]] = {
    "plumb_bob": _plumb_bob, "rational_polynomial": _rational, "fisheye": _fisheye,
}  # fmt: skip


def _required(model: str, coefficients: tuple[float, ...], nums: tuple[int, ...]) -> tuple[float, ...]:
    """As many coefficients as the largest of `nums`; recorders append zeros at will."""
    num = max(nums)
    if len(coefficients) not in nums and (len(coefficients) < num or any(coefficients[num:])):
        expected = " or ".join(str(n) for n in nums)
        raise LogError(f"distortion model '{model}' has {len(coefficients)} coefficients, not {expected}", "CAL001")
    return (*coefficients, *[0.0] * num)[:num]
