"""Numbers, poses and intrinsics of calibration files, checked; errors begin with the place."""

import re
from collections.abc import Mapping, Sequence
from math import inf

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import MAX_MAGNITUDE
from fbench.replay.data.rig import CameraModel
from fbench.replay.geometry.transforms import quaternion
from fbench.replay.logs.coordinate_frames import Edge

MALFORMED = "CFG003"
INVALID = "CAL001"
MODELS = {
    "equidistant": "fisheye", "kannala_brandt": "fisheye", "radtan": "plumb_bob", "radial-tangential": "plumb_bob",
    "none": "",
}  # fmt: skip
"""What fbench calls a distortion model that others call otherwise."""
_COEFFICIENTS = {"": (0,), "plumb_bob": (4, 5), "rational_polynomial": (8,), "fisheye": (4,)}
_TOLERANCE = 1e-3  # By which a rotation matrix may differ from an orthonormal one: files round to few digits
_MAX_PX = 1_000_000
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_MAX_DIGITS = 100


def number(where: str, value: object) -> float:
    """Return a finite number, also where a file gives it as text. Raises ConfigError where it isn't one."""
    if isinstance(value, str) and len(value) <= _MAX_DIGITS and _NUMBER.fullmatch(value.strip()):
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < inf:
        raise ConfigError(f"{where}: expected a finite number, got {format_value(value)}", MALFORMED)
    if abs(value) >= MAX_MAGNITUDE:
        raise ConfigError(f"{where}: expected a number below {MAX_MAGNITUDE:g}, got {format_value(value)}", MALFORMED)
    return float(value)


def natural(where: str, value: object) -> int:
    """Return a positive whole number that can be a number of pixels. Raises ConfigError where it isn't one."""
    if isinstance(value, str) and re.fullmatch("[0-9]{1,9}", value.strip()):
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 < value <= _MAX_PX:
        raise ConfigError(f"{where}: expected a whole number from 1 to {_MAX_PX}, got {format_value(value)}", MALFORMED)
    return value


def numbers(where: str, values: object, count: int | None = None) -> list[float]:
    """Return a list of numbers, `count` of them. Raises ConfigError where they aren't that."""
    if not isinstance(values, list | tuple):
        raise ConfigError(f"{where}: expected a list of numbers, got {format_value(values)}", MALFORMED)
    if count is not None and len(values) != count:
        raise ConfigError(f"{where}: expected {count} numbers, got {len(values)}", MALFORMED)
    return [number(f"{where}[{i}]", value) for i, value in enumerate(values)]


def matrix(where: str, rows: object, *shapes: tuple[int, int]) -> Float64:
    """Return a matrix of one of these shapes, given as a list of rows. Raises ConfigError where it isn't one."""
    if not isinstance(rows, list | tuple):
        raise ConfigError(f"{where}: expected a list of rows, got {format_value(rows)}", MALFORMED)
    widths = [len(row) if isinstance(row, list | tuple) else 0 for row in rows]
    for num_rows, width in shapes:
        if widths == [width] * num_rows:
            return np.array([numbers(f"{where}[{i}]", row) for i, row in enumerate(rows)], np.float64)
    wanted = " or ".join(f"{num_rows}x{width}" for num_rows, width in shapes)
    raise ConfigError(f"{where}: expected {wanted} numbers, got rows of {format_value(widths)}", MALFORMED)


def rigid(where: str, dst_T_src: Float64) -> tuple[Float64, Float64]:
    """Return translation (3,) [m] and quaternion (4,) of a matrix (4, 4) or (3, 4), whose rotation is made orthonormal.
    Raises ConfigError where the rotation isn't orthonormal within 1e-3 or mirrors, or the last row isn't 0 0 0 1.
    """
    rotation = dst_T_src[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if not off <= _TOLERANCE:
        raise ConfigError(f"{where}: its rotation isn't orthonormal (R^T R differs from I by {off:.3g})", INVALID)
    if np.linalg.det(rotation) < 0:
        raise ConfigError(f"{where}: mirrors (determinant -1), which no pose does; is an axis swapped?", INVALID)
    if len(dst_T_src) == 4 and not np.array_equal(dst_T_src[3], [0, 0, 0, 1]):
        raise ConfigError(f"{where}: expected the last row 0 0 0 1; is the matrix transposed?", INVALID)
    return dst_T_src[:3, 3].copy(), quaternion(rotation)


def camera_model(
    where: str, K: Float64, size_wh: tuple[int, int], model: str, distortion: Sequence[float]
) -> CameraModel:
    """Return intrinsics with fbench's name of the model. ConfigError: K of another form, a wrong coefficient count."""
    if not K.any():
        raise ConfigError(f"{where}: the camera isn't calibrated (K is zero)", INVALID)
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise ConfigError(f"{where}: expected positive focal lengths, got {K[0, 0]:g} and {K[1, 1]:g}", INVALID)
    if K[1, 0] != 0 or not np.array_equal(K[2], [0, 0, 1]):
        raise ConfigError(f"{where}: expected K = [fx s cx; 0 fy cy; 0 0 1]; is it transposed?", INVALID)
    name = MODELS.get(model, model)
    wanted = _COEFFICIENTS.get(name)
    if wanted is not None and len(distortion) not in (0, *wanted):
        counts = " or ".join(map(str, wanted))
        raise ConfigError(f"{where}: '{model}' has {counts} coefficients, got {len(distortion)}", INVALID)
    return CameraModel(K, size_wh, name, np.array(distortion, np.float64))


def require_model(where: str, model: str) -> str:
    """Return a distortion model. Raises ConfigError naming one that fbench hasn't."""
    if MODELS.get(model, model) not in _COEFFICIENTS:
        known = ", ".join(name for name in _COEFFICIENTS if name)
        raise ConfigError(f"{where}: '{model}' isn't supported; there are: {known}", INVALID)
    return model


def require_tree(place: str, edges: Mapping[str, Edge]) -> None:
    """Refuse edges that form a loop. Raises ConfigError naming them."""
    safe: set[str] = set()
    for child in edges:
        path, frame = dict.fromkeys([child]), child
        while frame in edges and frame not in safe:
            frame = edges[frame].parent
            if frame in path:
                names = list(path)
                loop = " → ".join([*names[names.index(frame) :], frame])
                loop = loop if len(loop) <= 200 else f"{loop[:200]}..."
                raise ConfigError(f"{place}: transforms form a loop: {loop}", INVALID)
            path[frame] = None
        safe.update(path)


def format_value(value: object) -> str:
    """A value as part of an error, shortened."""
    return text if len(text := repr(value)) <= 60 else f"{text[:60]}..."
