"""Layout of the messages that carry bulk data: PointCloud2, Image, CompressedImage. None has changed since ROS 1."""

from typing import NamedTuple

from fbench.replay.errors import DecodeError
from fbench.replay.logs.ros.cursor import Cursor, Header

MAX_FIELDS = 256


class PointField(NamedTuple):
    """`sensor_msgs/PointField`."""

    name: str
    offset: int
    datatype: int
    num: int
    """Values of this field a point has; only the first one is used."""


class Cloud(NamedTuple):
    """`sensor_msgs/PointCloud2`."""

    header: Header
    height: int
    width: int
    fields: tuple[PointField, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: memoryview
    """View of the payload."""
    is_dense: bool
    """Whether all points are valid; else those that aren't have NaN for coordinates."""


class RawImage(NamedTuple):
    """`sensor_msgs/Image`."""

    header: Header
    height: int
    width: int
    encoding: str
    is_bigendian: bool
    step: int
    data: memoryview
    """View of the payload."""


class CompressedImage(NamedTuple):
    """`sensor_msgs/CompressedImage`."""

    header: Header
    format: str
    data: memoryview
    """View of the payload."""


def read_cloud(data: memoryview, encoding: str) -> Cloud:
    """Read a PointCloud2.

    Raises:
        DecodeError: where the payload is damaged, or has more than `MAX_FIELDS` fields.
    """
    cursor = Cursor(data, encoding)
    header, height, width, num = cursor.header(), cursor.uint32(), cursor.uint32(), cursor.uint32()
    if num > MAX_FIELDS:
        raise DecodeError(f"cloud has {num} fields, at most {MAX_FIELDS} are read")
    fields = tuple(_field(cursor) for _ in range(num))
    is_bigendian, point_step, row_step = bool(cursor.uint8()), cursor.uint32(), cursor.uint32()
    points = cursor.blob()
    is_dense = bool(cursor.uint8())
    cursor.end()
    return Cloud(header, height, width, fields, is_bigendian, point_step, row_step, points, is_dense)


def _field(cursor: Cursor) -> PointField:
    return PointField(cursor.string(), cursor.uint32(), cursor.uint8(), cursor.uint32())


def read_raw_image(data: memoryview, encoding: str) -> RawImage:
    """Read an Image.

    Raises:
        DecodeError: where the payload is damaged.
    """
    cursor = Cursor(data, encoding)
    header, height, width, layout = cursor.header(), cursor.uint32(), cursor.uint32(), cursor.string()
    is_bigendian, step, pixels = bool(cursor.uint8()), cursor.uint32(), cursor.blob()
    cursor.end()
    return RawImage(header, height, width, layout, is_bigendian, step, pixels)


def read_compressed_image(data: memoryview, encoding: str) -> CompressedImage:
    """Read a CompressedImage.

    Raises:
        DecodeError: where the payload is damaged.
    """
    cursor = Cursor(data, encoding)
    header, form, pixels = cursor.header(), cursor.string(), cursor.blob()
    cursor.end()
    return CompressedImage(header, form, pixels)
