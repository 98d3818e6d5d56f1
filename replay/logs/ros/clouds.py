"""PointCloud2 as LiDAR sweep or radar scan, by the names that drivers give to its fields (in any case)."""

from fbench.replay.arrays import Float32
from fbench.replay.data import PointCloud, RadarScan
from fbench.replay.finite import only_finite
from fbench.replay.logs import point_fields
from fbench.replay.logs.codec import Origin
from fbench.replay.logs.point_fields import (
    ALTITUDE_FIELDS,
    AZIMUTH_FIELDS,
    DOPPLER_FIELDS,
    INTENSITY_FIELDS,
    RANGE_FIELDS,
    RCS_FIELDS,
    RING_FIELDS,
    VECTOR_FIELDS,
    along_ray,
    ring_numbers,
)
from fbench.replay.logs.point_times import TIME_FIELDS, offset_ns
from fbench.replay.logs.ros.columns import Columns
from fbench.replay.logs.ros.sensor_messages import Cloud


def is_radar(cloud: Cloud) -> bool:
    """Tell whether points have a Doppler velocity."""
    return point_fields.is_radar(field.name for field in cloud.fields)


def lidar(cloud: Cloud, stamp_ns: int, origin: Origin) -> PointCloud:
    """Return a sweep, row by row for organised clouds, without the points that the cloud declares invalid.

    Raises:
        PointsError: where sizes don't fit together, or x, y, z aren't there.
    """
    columns = Columns(cloud)
    name = columns.name(TIME_FIELDS)
    times = None if name is None else columns.get((name,))
    sweep = PointCloud(
        origin.sensor, stamp_ns, origin.log_ns, columns.xyz(), columns.get(INTENSITY_FIELDS, "f4"),
        ring_numbers(columns.get(RING_FIELDS)),
        None if times is None else offset_ns(times, stamp_ns), origin.frame_number,
    )  # fmt: skip
    return sweep if cloud.is_dense else only_finite(sweep)


def radar(cloud: Cloud, stamp_ns: int, origin: Origin) -> RadarScan:
    """Return a radar scan, as `lidar` does; Doppler is NaN on the sensor's axis where only a vector is given.

    Raises:
        PointsError: where sizes don't fit together, or x, y, z aren't there.
    """
    columns = Columns(cloud)
    xyz = columns.xyz()
    velocity = columns.get(DOPPLER_FIELDS, "f4")
    scan = RadarScan(
        origin.sensor, stamp_ns, origin.log_ns, xyz, _along_ray(columns, xyz) if velocity is None else velocity,
        columns.get(RCS_FIELDS, "f4"), columns.get(RANGE_FIELDS, "f4"), columns.get(AZIMUTH_FIELDS, "f4"),
        columns.get(ALTITUDE_FIELDS, "f4"), origin.frame_number,
    )  # fmt: skip
    return scan if cloud.is_dense else only_finite(scan)


def _along_ray(columns: Columns, xyz: Float32) -> Float32 | None:
    vx, vy = (columns.get((name,), "f8") for name in VECTOR_FIELDS)
    return None if vx is None or vy is None else along_ray(xyz, vx, vy)
