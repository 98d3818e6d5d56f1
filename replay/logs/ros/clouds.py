"""PointCloud2 as LiDAR sweep or radar scan, by the names that drivers give to its fields (in any case)."""

import numpy as np

from fbench.replay.arrays import Array, Float32
from fbench.replay.data import PointCloud, RadarScan
from fbench.replay.logs.codec import Origin
from fbench.replay.logs.ros.columns import Columns
from fbench.replay.logs.ros.point_times import TIME_FIELDS, offset_ns
from fbench.replay.logs.ros.sensor_messages import Cloud

DOPPLER_FIELDS = (
    "velocity", "doppler", "doppler_velocity", "radial_velocity", "v_r", "vr", "radial_speed", "speed_radial",
)  # fmt: skip
"""A cloud with one of these fields is a radar scan; their values count as positive when receding."""
VECTOR_FIELDS = ("vx", "vy")
"""Doppler as a vector along the ray, as nuScenes has it (its `vx_comp, vy_comp` are made free of the ego motion)."""
RCS_FIELDS = ("rcs", "power", "snr", "amplitude")
INTENSITY_FIELDS = ("intensity", "reflectivity", "i")
RING_FIELDS = ("ring", "channel", "line")


def is_radar(cloud: Cloud) -> bool:
    """Tell whether points have a Doppler velocity."""
    names = {field.name.lower() for field in cloud.fields}
    return not names.isdisjoint(DOPPLER_FIELDS) or names.issuperset(VECTOR_FIELDS)


def lidar(cloud: Cloud, stamp_ns: int, origin: Origin) -> PointCloud:
    """Return a sweep, row by row for organised clouds.

    Raises:
        PointsError: where sizes don't fit together, or x, y, z aren't there.
    """
    columns = Columns(cloud)
    name = columns.name(TIME_FIELDS)
    times = None if name is None else columns.get((name,))
    return PointCloud(
        origin.sensor, stamp_ns, origin.log_ns, columns.xyz(), columns.get(INTENSITY_FIELDS, "f4"), _ring(columns),
        None if times is None else offset_ns(times, stamp_ns), origin.frame_number,
    )  # fmt: skip


def _ring(columns: Columns) -> Array | None:
    """Numbers of the lasers (N,) uint16; `None` where they aren't such numbers."""
    column = columns.get(RING_FIELDS)
    if column is None or column.dtype == np.uint16:
        return column
    if not np.all((column >= 0) & (column <= np.iinfo(np.uint16).max) & (column == np.trunc(column))):
        return None
    return column.astype(np.uint16)


def radar(cloud: Cloud, stamp_ns: int, origin: Origin) -> RadarScan:
    """Return a radar scan; Doppler is NaN for a point on the sensor's axis where only a vector is given.

    Raises:
        PointsError: where sizes don't fit together, or x, y, z aren't there.
    """
    columns = Columns(cloud)
    xyz = columns.xyz()
    velocity = columns.get(DOPPLER_FIELDS, "f4")
    return RadarScan(
        origin.sensor, stamp_ns, origin.log_ns, xyz, _along_ray(columns, xyz) if velocity is None else velocity,
        columns.get(RCS_FIELDS, "f4"), columns.get(("range",), "f4"), columns.get(("azimuth",), "f4"),
        columns.get(("altitude", "elevation"), "f4"), origin.frame_number,
    )  # fmt: skip


def _along_ray(columns: Columns, xyz: Float32) -> Float32 | None:
    """Radial velocity (N,) from a vector: (x vx + y vy) / hypot(x, y)."""
    vx, vy = (columns.get((name,), "f8") for name in VECTOR_FIELDS)
    if vx is None or vy is None:
        return None
    x, y = xyz[:, 0].astype(np.float64), xyz[:, 1].astype(np.float64)
    radial: Float32 = ((x * vx + y * vy) / np.hypot(x, y)).astype(np.float32)
    return radial
