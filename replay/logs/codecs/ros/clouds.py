"""PointCloud2, read without rosbags so that its bytes are copied once, and RadarScan of radar_msgs."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import DecodeError, PointsError
from fbench.replay.data.messages import Message, RadarScan
from fbench.replay.logs.codecs import packed_points
from fbench.replay.logs.codecs.codec import Origin, Probe
from fbench.replay.logs.codecs.packed_points import PointField
from fbench.replay.logs.codecs.point_times import read_times
from fbench.replay.logs.codecs.ros.cursor import Cursor, Header
from fbench.replay.logs.codecs.ros.decoder import get, header

MAX_FIELDS = 256
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8", 9: "i8", 10: "u8", 11: "u1"}
"""Of `sensor_msgs/PointField`; 9 to 11 (64-bit integers, bool) are those of ROS 2 Lyrical."""


@dataclass(frozen=True)
class Cloud:
    """`sensor_msgs/PointCloud2`."""

    header: Header
    height: int
    width: int
    fields: tuple[PointField, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: memoryview  # View of the payload
    is_dense: bool  # Whether all points are valid; else those that aren't have NaN for coordinates

    def columns(self) -> packed_points.Columns:
        """The points, row by row for organized clouds. Raises PointsError where sizes don't fit together. Some drivers
        give a wrong `row_step`; without padding the data alone say it.
        """
        row, size = self.width * self.point_step, len(self.data)
        if size != row * self.height or not (size or not self.height * self.width):
            if not (self.row_step >= row > 0 and size == self.row_step * self.height):
                raise PointsError(
                    f"cloud of {self.width}x{self.height} points of {self.point_step} bytes, rows of {self.row_step} "
                    f"bytes, has {size} bytes"
                )
            row = self.row_step
        shape, order = (self.height, self.width), ">" if self.is_bigendian else "<"
        return packed_points.Columns(self.fields, _TYPES, self.data, shape, (row, self.point_step), order)


def read_cloud(data: memoryview, encoding: str) -> Cloud:
    """Read a PointCloud2. Raises DecodeError where the payload is damaged, or has more than `MAX_FIELDS` fields."""
    cursor = Cursor(data, encoding)
    head, height, width, num = cursor.header(), cursor.uint32(), cursor.uint32(), cursor.uint32()
    if num > MAX_FIELDS:
        raise DecodeError(f"cloud has {num} fields, at most {MAX_FIELDS} are read")
    fields = [PointField(cursor.string(), cursor.uint32(), cursor.uint8(), cursor.uint32()) for _ in range(num)]
    is_bigendian, point_step, row_step = bool(cursor.uint8()), cursor.uint32(), cursor.uint32()
    blob, is_dense = cursor.blob(), bool(cursor.uint8())
    cursor.end()
    return Cloud(head, height, width, tuple(fields), is_bigendian, point_step, row_step, blob, is_dense)


def probe_cloud(cloud: Cloud, encoding: str) -> Probe:
    """Tell radar scans, whose points have Doppler, from LiDAR sweeps."""
    if packed_points.is_radar(field.name for field in cloud.fields):
        return Probe("radar", cloud.header.frame_id)
    try:
        doubt = read_times(cloud.columns(), cloud.header.stamp_ns).doubt
    except PointsError:  # counted where the message is read
        doubt = ""
    return Probe("lidar", cloud.header.frame_id, doubt=doubt)


def cloud_message(kind: str, cloud: Cloud, encoding: str, origin: Origin) -> Message:
    """Make a sweep or scan without points declared invalid. Raises PointsError where sizes or fields don't fit."""
    columns, stamp_ns = cloud.columns(), cloud.header.stamp_ns
    if kind == "radar":
        scan = packed_points.radar_scan(columns, stamp_ns, origin)
        return scan if cloud.is_dense else packed_points.only_finite(scan)
    sweep = packed_points.lidar_sweep(columns, stamp_ns, origin, read_times(columns, stamp_ns).offset_ns)
    return sweep if cloud.is_dense else packed_points.only_finite(sweep)


_RETURN = ("range", "azimuth", "elevation", "doppler_velocity", "amplitude")


def radar_scan(kind: str, message: Any, encoding: str, origin: Origin) -> RadarScan:
    """Read a RadarScan: azimuth positive to the left, elevation upwards (REP 103), x = r cos(el) cos(az). radar_msgs
    doesn't define the sign of `doppler_velocity`: it counts as positive when receding. `amplitude` is in dB, so
    `rcs_dbsm` is an uncalibrated magnitude.
    """
    stamp_ns = header(message, encoding).stamp_ns
    returns = [[get(point, name) for name in _RETURN] for point in get(message, "returns")]
    table = np.array(returns, np.float64).reshape(-1, len(_RETURN))
    distance, azimuth, elevation = table[:, 0], table[:, 1], table[:, 2]
    flat = distance * np.cos(elevation)
    xyz = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
    polar, xyz32 = table.astype(np.float32), xyz.astype(np.float32)
    return RadarScan(
        origin.sensor, stamp_ns, origin.log_ns, xyz32, polar[:, 3], polar[:, 4], polar[:, 0], polar[:, 1], polar[:, 2],
        origin.frame_number,
    )  # fmt: skip
