"""PointCloud2, Image and CompressedImage: read without rosbags, so that their bytes are copied once."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import DTypeLike

from fbench.replay.contracts.errors import DecodeError, PointsError, UnsupportedError
from fbench.replay.data.arrays import Array, Float32
from fbench.replay.data.images import MAX_PIXELS, encoded_format, encoded_size, layout_name, pack_rows
from fbench.replay.data.messages import Image, Message, PointCloud, RadarScan
from fbench.replay.logs.codecs import points as point_fields
from fbench.replay.logs.codecs.codec import Origin, Probe
from fbench.replay.logs.codecs.points import (
    ALTITUDE_FIELDS,
    AZIMUTH_FIELDS,
    DOPPLER_FIELDS,
    INTENSITY_FIELDS,
    RANGE_FIELDS,
    RCS_FIELDS,
    RING_FIELDS,
    TIME_FIELDS,
    VECTOR_FIELDS,
    along_ray,
    offset_ns,
    only_finite,
    ring_numbers,
)
from fbench.replay.logs.codecs.ros.cursor import (
    Cloud,
    CompressedImage,
    PointField,
    RawImage,
    read_cloud,
    read_compressed_image,
    read_raw_image,
)
from fbench.replay.logs.codecs.ros.decoder import Reads

_CODES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8", 9: "i8", 10: "u8", 11: "u1"}
"""Of `sensor_msgs/PointField`; 9 to 11 (64-bit integers, bool) are those of ROS 2 Lyrical."""
FLOAT32 = 7


class Columns:
    """Fields by name in lower case; the first one of a name counts."""

    def __init__(self, cloud: Cloud) -> None:
        self._cloud, self._order = cloud, ">" if cloud.is_bigendian else "<"
        self._fields: dict[str, PointField] = {}
        for field in cloud.fields:
            self._fields.setdefault(field.name.lower(), field)
        self._num = cloud.height * cloud.width
        self._row_step = _row_step(cloud)

    def name(self, names: Sequence[str]) -> str | None:
        """The first of these names that is there."""
        return next((name for name in names if name in self._fields), None)

    def xyz(self) -> Float32:
        """Coordinates (N, 3) float32. Raises PointsError where x, y or z is missing or lies outside the points."""
        missing = [axis for axis in "xyz" if axis not in self._fields]
        if missing:
            raise PointsError(f"points have no field {', '.join(missing)}")
        x, y, z = (self._fields[axis] for axis in "xyz")
        if x.datatype == y.datatype == z.datatype == FLOAT32 and (y.offset, z.offset) == (x.offset + 4, x.offset + 8):
            return self._copy(x, 3)
        return np.stack([self._copy(field)[:, 0].astype("f4", copy=False) for field in (x, y, z)], axis=1)

    def get(self, names: Sequence[str], dtype: DTypeLike | None = None) -> Array | None:
        """The first of these fields that is there, (N,), converted to `dtype`; `None` where none is. Raises PointsError
        where the field has an unknown type or lies outside the points.
        """
        name = self.name(names)
        if name is None:
            return None
        column = self._copy(self._fields[name])[:, 0]
        return column if dtype is None else column.astype(dtype, copy=False)

    def _copy(self, field: PointField, width: int = 1) -> Array:
        """Copy (N, width) consecutive values of each point."""
        if field.datatype not in _CODES:
            raise PointsError(f"field '{field.name}' has an unknown type {field.datatype}")
        dtype = np.dtype(self._order + _CODES[field.datatype])
        if not self._num:
            return np.zeros((0, width), dtype.newbyteorder("="))
        cloud, size = self._cloud, dtype.itemsize
        if field.offset + width * size > cloud.point_step:
            raise PointsError(f"field '{field.name}' lies outside the points of {cloud.point_step} bytes")
        shape, strides = (cloud.height, cloud.width), (self._row_step, cloud.point_step)
        # One item for all values of a point: three times faster than copying each by itself.
        view: Array = np.ndarray(shape, f"V{width * size}", cloud.data, field.offset, strides)
        values = np.array(view, order="C").reshape(-1, 1).view(dtype)
        return values.astype(dtype.newbyteorder("="), copy=False)


def _row_step(cloud: Cloud) -> int:
    """Bytes from row to row. Some drivers give a wrong `row_step`; without padding the data alone say it."""
    row, size = cloud.width * cloud.point_step, len(cloud.data)
    if size == row * cloud.height and (size or not cloud.height * cloud.width):
        return row
    if cloud.row_step >= row > 0 and size == cloud.row_step * cloud.height:
        return cloud.row_step
    raise PointsError(
        f"cloud of {cloud.width}x{cloud.height} points of {cloud.point_step} bytes, rows of {cloud.row_step} bytes, "
        f"has {size} bytes"
    )


def is_radar(cloud: Cloud) -> bool:
    """Tell whether points have a Doppler velocity."""
    return point_fields.is_radar(field.name for field in cloud.fields)


def lidar(cloud: Cloud, stamp_ns: int, origin: Origin) -> PointCloud:
    """Return a sweep, row by row for organized clouds, without the points that the cloud declares invalid. Raises
    PointsError where sizes don't fit together, or x, y, z aren't there.
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
    """Return a radar scan, as `lidar` does; Doppler is NaN on the sensor's axis where only a vector is given. Raises
    PointsError where sizes don't fit together, or x, y, z aren't there.
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


def check_format(image: CompressedImage) -> None:
    """Refuse depth images, whose PNG isn't a picture. Raises DecodeError where it is one."""
    if "compressedDepth" in image.format:
        raise UnsupportedError(f"format '{image.format}' is a depth image, not supported")


def raw(image: RawImage, stamp_ns: int, origin: Origin) -> Image:
    """Return a raw image, its rows packed and 16 bits little-endian. Raises DecodeError where the layout isn't known,
    or size and data don't fit together.
    """
    name, size_wh = layout_name(image.encoding), (image.width, image.height)
    if image.width * image.height > MAX_PIXELS:
        raise DecodeError(f"image of {image.width}x{image.height} px is larger than {MAX_PIXELS} px")
    pixels = pack_rows(image.data, name, size_wh, image.step, is_bigendian=image.is_bigendian)
    return Image(origin.sensor, stamp_ns, origin.log_ns, pixels, name, size_wh, origin.frame_number)


def compressed_image(image: CompressedImage, stamp_ns: int, origin: Origin) -> Image:
    """Return a compressed image; its first bytes tell what it is, because writers name formats in many ways. Raises
    DecodeError where it is a depth image, or neither JPEG nor PNG nor WebP, or its header is damaged.
    """
    check_format(image)
    encoding = encoded_format(image.data)
    data = bytes(image.data)
    size_wh = encoded_size(data)
    return Image(origin.sensor, stamp_ns, origin.log_ns, data, encoding, size_wh, origin.frame_number)


def cloud_reads(encoding: str) -> Reads:
    """PointCloud2: radar scans where points have Doppler, else LiDAR sweeps."""

    def probe(data: memoryview) -> Probe:
        cloud = read_cloud(data, encoding)
        return Probe("radar" if is_radar(cloud) else "lidar", cloud.header.frame_id)

    def message(kind: str, data: memoryview, origin: Origin) -> Message:
        cloud = read_cloud(data, encoding)
        convert = radar if kind == "radar" else lidar
        return convert(cloud, cloud.header.stamp_ns, origin)

    return Reads(("lidar", "radar"), probe, message)


def raw_image_reads(encoding: str) -> Reads:
    """Image; a layout that can't be shown is refused at the first look."""

    def probe(data: memoryview) -> Probe:
        image = read_raw_image(data, encoding)
        layout_name(image.encoding)
        return Probe("camera", image.header.frame_id)

    def message(kind: str, data: memoryview, origin: Origin) -> Message:
        image = read_raw_image(data, encoding)
        return raw(image, image.header.stamp_ns, origin)

    return Reads(("camera",), probe, message)


def compressed_image_reads(encoding: str) -> Reads:
    """CompressedImage; depth images are refused at the first look."""

    def probe(data: memoryview) -> Probe:
        image = read_compressed_image(data, encoding)
        check_format(image)
        return Probe("camera", image.header.frame_id)

    def message(kind: str, data: memoryview, origin: Origin) -> Message:
        image = read_compressed_image(data, encoding)
        return compressed_image(image, image.header.stamp_ns, origin)

    return Reads(("camera",), probe, message)


BULK: Mapping[str, Callable[[str], Reads]] = {
    "sensor_msgs/msg/PointCloud2": cloud_reads,
    "sensor_msgs/msg/Image": raw_image_reads,
    "sensor_msgs/msg/CompressedImage": compressed_image_reads,
}
"""By type: what a channel with messages of an encoding can be decoded to."""
