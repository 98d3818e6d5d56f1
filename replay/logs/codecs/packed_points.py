"""Packed fields of points: names and meanings, as drivers write them, and the sweeps and radar scans that they hold."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import DTypeLike

from fbench.replay.contracts.errors import DecodeError, PointsError
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.geometry.transforms import pose_matrix, transform
from fbench.replay.logs.codecs.codec import Origin

DOPPLER_FIELDS = (
    "velocity", "doppler", "doppler_velocity", "radial_velocity", "v_r", "vr", "radial_speed", "speed_radial",
    "v_radial", "v_rad", "vrad", "velocity_radial", "radial_vel", "vel_radial", "radialvelocity", "radialspeed",
    "doppler_speed", "doppler_vel", "dopplervelocity", "v_doppler", "range_rate", "rangerate", "doppler_mps",
    "v_doppler_mps", "radial_velocity_mps", "doppler_velocity_mps", "range_rate_mps", "v_rel", "vrel",
)  # fmt: skip
"""A cloud with one of these fields is a radar scan; their values count as positive when receding."""
VECTOR_FIELDS = ("vx", "vy")
"""Doppler as a vector along the ray, as nuScenes has it (its `vx_comp, vy_comp` are made free of the ego motion)."""
RCS_FIELDS = ("rcs", "power", "snr", "amplitude")
RANGE_FIELDS = ("range",)
AZIMUTH_FIELDS = ("azimuth", "azimuthangle")
ALTITUDE_FIELDS = ("altitude", "elevation", "elevationangle")
INTENSITY_FIELDS = ("intensity", "reflectivity", "i", "reflectance")
RING_FIELDS = ("ring", "channel", "line")


def is_radar(names: Iterable[str]) -> bool:
    """Tell whether points with these fields have a Doppler velocity."""
    lower = {name.lower() for name in names}
    return not lower.isdisjoint(DOPPLER_FIELDS) or lower.issuperset(VECTOR_FIELDS)


class PointField(NamedTuple):
    """One value of every point, of which only the first is used where there are several; eight bytes are an integer."""

    name: str
    offset: int
    code: int  # Number of its type
    num: int = 1  # How many values there are


@dataclass(frozen=True, eq=False)
class Columns:
    """The fields of points by name in lower case; the first one of a name counts."""

    fields: Sequence[PointField]
    types: Mapping[int, str]  # NumPy's name of each type, by its number
    data: memoryview  # Points in rows: a view, of which only what is asked for is copied
    shape: tuple[int, int]  # Rows, and points a row
    steps: tuple[int, int]  # Bytes from row to row, and from point to point
    order: str = "<"  # Of the bytes

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields, in their order."""
        return tuple(dict.fromkeys(field.name.lower() for field in self.fields))

    @cached_property
    def _by_name(self) -> Mapping[str, PointField]:
        return {field.name.lower(): field for field in reversed(self.fields)}

    def xyz(self) -> Float32:
        """Coordinates (N, 3) float32. Raises PointsError where x, y or z is missing or lies outside the points."""
        missing = [axis for axis in "xyz" if axis not in self._by_name]
        if missing:
            raise PointsError(f"points have no field {', '.join(missing)}")
        x, y, z = axes = [self._by_name[axis] for axis in "xyz"]
        is_float = all(self.types.get(field.code) == "f4" for field in axes)
        if is_float and (y.offset, z.offset) == (x.offset + 4, x.offset + 8):
            return self._copy(z, width=3)
        return np.stack([_cast(self._copy(field)[:, 0], "f4") for field in axes], axis=1)

    def get(self, names: Sequence[str], dtype: DTypeLike | None = None) -> Array | None:
        """The first of these fields that is there, (N,), converted to `dtype` if given; `None` where none is. Raises
        PointsError where the field has an unknown type or lies outside the points.
        """
        field = next((self._by_name[name] for name in names if name in self._by_name), None)
        if field is None:
            return None
        column = self._copy(field)[:, 0]
        return column if dtype is None else _cast(column, dtype)

    def _copy(self, field: PointField, width: int = 1) -> Array:
        """Copy (N, width) consecutive values of each point, those of `field` the last ones."""
        if field.code not in self.types:
            raise PointsError(f"field '{field.name}' has an unknown type {field.code}")
        name = self.types[field.code]
        dtype = np.dtype(self.order + ("u8" if name == "u1" and field.num == 8 else name))
        if 0 in self.shape:
            return np.zeros((0, width), dtype.newbyteorder("="))
        if field.offset + dtype.itemsize > self.steps[1]:
            raise PointsError(f"field '{field.name}' lies outside the points of {self.steps[1]} bytes")
        start = field.offset - (width - 1) * dtype.itemsize
        # One opaque item for all values of a point: two to three times faster than copying each by itself.
        view: Array = np.ndarray(self.shape, f"V{width * dtype.itemsize}", self.data, start, self.steps)
        values = np.array(view, order="C").reshape(-1, 1).view(dtype)
        return values.astype(dtype.newbyteorder("="), copy=False)


def _cast(column: Array, dtype: DTypeLike) -> Array:
    """Convert, values out of range as NumPy does it: foreign logs store rings as floats, intensities as integers."""
    with np.errstate(over="ignore", invalid="ignore"):
        return column.astype(dtype, copy=False)


def lidar_sweep(columns: Columns, stamp_ns: int, origin: Origin, offsets: Array | None = None) -> PointCloud:
    """Make a sweep with the times `offsets` (N,) int32 [ns]. Raises PointsError where fields don't fit."""
    return PointCloud(
        origin.sensor, stamp_ns, origin.log_ns, columns.xyz(), columns.get(INTENSITY_FIELDS, "f4"),
        _ring_numbers(columns.get(RING_FIELDS)), offsets, origin.frame_number,
    )  # fmt: skip


def radar_scan(columns: Columns, stamp_ns: int, origin: Origin) -> RadarScan:
    """Make a radar scan; Doppler of a vector is NaN on the sensor's axis. Raises PointsError as `lidar_sweep` does."""
    names = (DOPPLER_FIELDS, RCS_FIELDS, RANGE_FIELDS, AZIMUTH_FIELDS, ALTITUDE_FIELDS)
    xyz, (velocity, rcs, distance, azimuth, altitude) = columns.xyz(), (columns.get(name, "f4") for name in names)
    if velocity is None:
        vx, vy = (columns.get((name,), "f8") for name in VECTOR_FIELDS)
        if vx is not None and vy is not None:  # (x vx + y vy) / hypot(x, y) in the sensor's coordinates
            x, y = xyz[:, 0].astype(np.float64), xyz[:, 1].astype(np.float64)
            with np.errstate(all="ignore"):  # what isn't finite is dealt with where it matters
                velocity = np.asarray((x * vx + y * vy) / np.hypot(x, y), np.float32)
    return RadarScan(
        origin.sensor, stamp_ns, origin.log_ns, xyz, velocity, rcs, distance, azimuth, altitude, origin.frame_number
    )


def _ring_numbers(column: Array | None) -> Array | None:
    """Numbers of the lasers (N,) uint16; `None` where they aren't such numbers."""
    if column is None or column.dtype == np.uint16:
        return column
    if not np.all((column >= 0) & (column <= np.iinfo(np.uint16).max) & (column == np.trunc(column))):
        return None
    return column.astype(np.uint16)


C = TypeVar("C", bound=PointCloud | RadarScan)


def only_finite(cloud: C) -> C:
    """Return a cloud without the points of which a coordinate isn't finite."""
    finite = np.asarray(np.isfinite(cloud.xyz).all(axis=1))
    return cloud if finite.all() else take_points(cloud, finite)


def take_points(cloud: C, rows: Bool | Int64) -> C:
    """Return a cloud of some of its points, by mask or index."""
    arrays = ((f.name, v) for f in fields(cloud) if isinstance(v := getattr(cloud, f.name), np.ndarray))
    points: dict[str, Any] = {name: array[rows] for name, array in arrays}
    return replace(cloud, **points)


def place(points: C, translation: Float64, rotation_xyzw: Float64) -> C:
    """Move points by the pose (3,), (4,) that their message gives them; zeros for a rotation are none. Raises
    DecodeError where it isn't a pose.
    """
    if not translation.any() and not rotation_xyzw[:3].any() and rotation_xyzw[3] in (0, 1):
        return points
    try:
        matrix = pose_matrix(translation, rotation_xyzw)
    except ValueError as error:
        raise DecodeError(f"pose of the points isn't one ({error})") from error
    with np.errstate(over="ignore", invalid="ignore"):  # what isn't finite is dealt with where it matters
        return replace(points, xyz=transform(matrix, points.xyz).astype(np.float32))
