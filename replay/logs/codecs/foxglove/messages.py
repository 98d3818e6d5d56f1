"""Codec between sensor messages and the Foxglove Protobuf schemas; exact for every field."""

from collections.abc import Mapping, Sequence

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField as Field
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto
from foxglove_schemas_protobuf.Pose_pb2 import Pose as PoseProto
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from numpy.typing import DTypeLike

from fbench.replay.contracts.errors import DecodeError, PointsError, UnsupportedError
from fbench.replay.data.arrays import Array, Float32, Float64
from fbench.replay.data.images import RAW_CHANNELS, encoded_format, encoded_size, layout_name, pack_rows
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan
from fbench.replay.geometry.transforms import pose_matrix, transform
from fbench.replay.logs.codecs.codec import Origin
from fbench.replay.logs.codecs.foxglove.proto import nanoseconds, parse, split, timestamp
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
    ring_numbers,
)
from fbench.replay.logs.coordinate_frames import BODIES

_DTYPES = {
    Field.UINT8: "<u1", Field.INT8: "<i1", Field.UINT16: "<u2", Field.INT16: "<i2",
    Field.UINT32: "<u4", Field.INT32: "<i4", Field.FLOAT32: "<f4", Field.FLOAT64: "<f8",
}  # fmt: skip
_TYPES = {np.dtype(dtype): kind for kind, dtype in _DTYPES.items()}


def pack(proto: CloudProto, xyz: Float32, columns: Mapping[str, Array | None]) -> None:
    """Fill fields, stride and data of `proto`; columns that are `None` are left out."""
    named: dict[str, Array] = {axis: xyz[:, i] for i, axis in enumerate("xyz")}
    named |= {name: column for name, column in columns.items() if column is not None}
    dtype = np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in named.items()])
    rows = np.empty(len(xyz), dtype)
    offset = 0
    for name, column in named.items():
        rows[name] = column
        proto.fields.add(name=name, offset=offset, type=_TYPES[column.dtype.newbyteorder("<")])
        offset += column.dtype.itemsize
    proto.point_stride = dtype.itemsize
    proto.data = rows.tobytes()


class Columns:
    """The points of one message by column name in lower case; the first one of a name counts."""

    def __init__(self, proto: CloudProto, data: memoryview) -> None:
        self._data = data
        self._stride = proto.point_stride
        self._fields: dict[str, Field] = {}
        for field in proto.fields:
            self._fields.setdefault(field.name.lower(), field)
        if self._stride == 0 and self._data:
            raise PointsError("points of 0 bytes")
        if self._stride and len(self._data) % self._stride:
            raise PointsError(f"{len(self._data)} bytes aren't a multiple of the point stride {self._stride}")
        self._num = len(self._data) // self._stride if self._stride else 0

    def xyz(self) -> Float32:
        """Coordinates (N, 3) float32. Raises PointsError where x, y or z is missing."""
        missing = [axis for axis in "xyz" if axis not in self._fields]
        if missing:
            raise PointsError(f"points have no field {', '.join(missing)}")
        axes = [self._fields[axis] for axis in "xyz"]
        x = axes[0].offset
        if all(f.type == Field.FLOAT32 and f.offset == x + 4 * i for i, f in enumerate(axes)):
            self._check(axes[2])
            return self._strided(x, "<f4", 3)
        return np.stack([_cast(self._column(field), "f4") for field in axes], axis=1)

    def get(self, names: Sequence[str], dtype: DTypeLike | None = None) -> Array | None:
        """The first of these columns that is there, (N,), converted to `dtype` if given; `None` where there is none.
        Raises PointsError where the column has an unknown type or lies outside the points.
        """
        field = next((self._fields[name] for name in names if name in self._fields), None)
        if field is None:
            return None
        return self._column(field) if dtype is None else _cast(self._column(field), dtype)

    def _check(self, field: Field) -> np.dtype[np.generic]:
        if field.type not in _DTYPES:
            raise PointsError(f"field '{field.name}' has an unknown type {field.type}")
        dtype = np.dtype(_DTYPES[field.type])
        if self._num and field.offset + dtype.itemsize > self._stride:
            raise PointsError(f"field '{field.name}' lies outside the points of {self._stride} bytes")
        return dtype

    def _column(self, field: Field) -> Array:
        return self._strided(field.offset, self._check(field), 1)[:, 0]

    def _strided(self, offset: int, dtype: DTypeLike, width: int) -> Array:
        """Copy of (N, width) consecutive values at `offset` of each point; the only copy that is made of them."""
        dtype = np.dtype(dtype)
        if not self._num:
            return np.zeros((0, width), dtype)
        # As opaque items the values of a point are copied at once, which takes half the time.
        items = np.ndarray(self._num, f"V{width * dtype.itemsize}", self._data, offset, self._stride)
        return items.copy().view(dtype).reshape(self._num, width)


def _cast(column: Array, dtype: DTypeLike) -> Array:
    """Convert, values out of range as NumPy does it: foreign logs store rings as floats, intensities as integers."""
    with np.errstate(over="ignore", invalid="ignore"):
        return column.astype(dtype, copy=False)


WORLD = "world"


def image_proto(image: Image) -> RawImage | CompressedImage:
    """Encode an image: raw layouts as RawImage, all others as CompressedImage."""
    stamp = timestamp(image.stamp_ns)
    if image.encoding not in RAW_CHANNELS:
        return CompressedImage(timestamp=stamp, frame_id=image.sensor, data=image.data, format=image.encoding)
    width, height = image.size_wh
    step = width * RAW_CHANNELS[image.encoding]
    return RawImage(
        timestamp=stamp, frame_id=image.sensor, width=width, height=height, encoding=image.encoding, step=step,
        data=image.data,
    )  # fmt: skip


def read_compressed_image(data: memoryview, origin: Origin) -> Image:
    """Decode a CompressedImage; a foreign one's size is read from the header of the JPEG or PNG. Raises DecodeError
    where the message or that header is damaged.
    """
    head, encoded = split(data, CompressedImage.DATA_FIELD_NUMBER)
    proto, pixels = parse(CompressedImage, head), bytes(encoded)
    stamp_ns = _stamp_ns(proto, origin)
    if origin.size_wh is not None:
        return Image(origin.sensor, stamp_ns, origin.log_ns, pixels, proto.format, origin.size_wh, origin.frame_number)
    encoding, size_wh = encoded_format(encoded), encoded_size(pixels)
    return Image(origin.sensor, stamp_ns, origin.log_ns, pixels, encoding, size_wh, origin.frame_number)


def read_raw_image(data: memoryview, origin: Origin) -> Image:
    """Decode a RawImage; padding at the end of the rows of a foreign one is removed. Raises DecodeError where the
    message is damaged, or of a foreign one the layout isn't known or the data don't fit.
    """
    head, rows = split(data, RawImage.DATA_FIELD_NUMBER)
    proto = parse(RawImage, head)
    stamp_ns, number = _stamp_ns(proto, origin), origin.frame_number
    if origin.size_wh is not None:
        return Image(origin.sensor, stamp_ns, origin.log_ns, bytes(rows), proto.encoding, origin.size_wh, number)
    encoding, size_wh = layout_name(proto.encoding), (proto.width, proto.height)
    pixels = pack_rows(rows, encoding, size_wh, proto.step)
    return Image(origin.sensor, stamp_ns, origin.log_ns, pixels, encoding, size_wh, number)


def cloud_proto(cloud: PointCloud) -> CloudProto:
    """Encode a LiDAR sweep with the fields x, y, z and, where present, intensity, ring, offset_ns."""
    proto = CloudProto(timestamp=timestamp(cloud.stamp_ns), frame_id=cloud.sensor, pose=_IDENTITY)
    pack(proto, cloud.xyz, {"intensity": cloud.intensity, "ring": cloud.ring, "offset_ns": cloud.offset_ns})
    return proto


def read_cloud(data: memoryview, origin: Origin) -> PointCloud:
    """Decode a LiDAR sweep; points are moved by the message's pose where it has one.

    Times of points under other names than that of fbench are read as drivers write them; see `offset_ns`. Raises
    DecodeError where the message is damaged or has no coordinates.
    """
    proto, columns = _columns(data)
    stamp_ns, offsets, times = _stamp_ns(proto, origin), columns.get(("offset_ns",), "i4"), columns.get(TIME_FIELDS)
    if offsets is None and times is not None:
        offsets = offset_ns(times, stamp_ns)
    return PointCloud(
        origin.sensor, stamp_ns, origin.log_ns, _xyz(proto, columns), columns.get(INTENSITY_FIELDS, "f4"),
        ring_numbers(columns.get(RING_FIELDS)), offsets, origin.frame_number,
    )  # fmt: skip


def radar_proto(scan: RadarScan) -> CloudProto:
    """Encode a radar scan: x, y, z and, where present, velocity, rcs, range, azimuth, altitude."""
    proto = CloudProto(timestamp=timestamp(scan.stamp_ns), frame_id=scan.sensor, pose=_IDENTITY)
    pack(
        proto,
        scan.xyz,
        {
            "velocity": scan.radial_velocity_mps, "rcs": scan.rcs_dbsm, "range": scan.range_m,
            "azimuth": scan.azimuth_rad, "altitude": scan.altitude_rad,
        },
    )  # fmt: skip
    return proto


def read_radar(data: memoryview, origin: Origin) -> RadarScan:
    """Decode a radar scan. Raises DecodeError where the message is damaged or has no coordinates."""
    proto, columns = _columns(data)
    names = (DOPPLER_FIELDS, RCS_FIELDS, RANGE_FIELDS, AZIMUTH_FIELDS, ALTITUDE_FIELDS)
    velocity, rcs, distance, azimuth, altitude = (columns.get(name, "f4") for name in names)
    vx, vy = (columns.get((name,), "f8") for name in VECTOR_FIELDS)
    if velocity is None and vx is not None and vy is not None:
        velocity = along_ray(columns.xyz(), vx, vy)
    return RadarScan(
        origin.sensor, _stamp_ns(proto, origin), origin.log_ns, _xyz(proto, columns), velocity, rcs, distance, azimuth,
        altitude, origin.frame_number,
    )  # fmt: skip


def _columns(data: memoryview) -> tuple[CloudProto, Columns]:
    head, points = split(data, CloudProto.DATA_FIELD_NUMBER)
    proto = parse(CloudProto, head)
    return proto, Columns(proto, points)


def _xyz(proto: CloudProto, columns: Columns) -> Float32:
    xyz = columns.xyz()
    if not proto.HasField("pose") or proto.pose in (_IDENTITY, _UNSET):
        return xyz
    translation, rotation = pose_arrays(proto.pose)
    try:
        matrix = pose_matrix(translation, rotation)
    except ValueError as error:
        raise DecodeError(f"pose of the points isn't one ({error})") from error
    return transform(matrix, xyz).astype(np.float32)


def pose_proto(pose: Pose) -> PoseInFrame:
    """Encode the body's pose in the world."""
    return PoseInFrame(
        timestamp=timestamp(pose.stamp_ns), frame_id=WORLD,
        pose=PoseProto(position=vector(pose.translation_m), orientation=rotation(pose.rotation_xyzw)),
    )  # fmt: skip


def pose_frame(data: memoryview) -> str:
    """Tell the coordinate frame in which a pose is given. Raises UnsupportedError where it is that of the body, so that
    the pose doesn't say where the body is. Raises DecodeError where the message is damaged.
    """
    frame_id: str = parse(PoseInFrame, data).frame_id
    if frame_id in BODIES:
        raise UnsupportedError(f"its poses are given in '{frame_id}', the body's own coordinate frame")
    return frame_id


def read_pose(data: memoryview, origin: Origin) -> Pose:
    """Decode a pose. Raises DecodeError where the message is damaged."""
    proto = parse(PoseInFrame, data)
    translation_m, rotation_xyzw = pose_arrays(proto.pose)
    return Pose(
        origin.sensor, _stamp_ns(proto, origin), origin.log_ns, translation_m, rotation_xyzw, origin.frame_number
    )


def vector(xyz: Array) -> Vector3:
    """Encode (3,)."""
    x, y, z = xyz.tolist()
    return Vector3(x=x, y=y, z=z)


def rotation(xyzw: Array) -> Quaternion:
    """Encode a quaternion (4,) xyzw."""
    x, y, z, w = xyzw.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def pose_arrays(proto: PoseProto) -> tuple[Float64, Float64]:
    """Return translation (3,) [m] and quaternion (4,) xyzw as they are stored."""
    return arrays(proto.position, proto.orientation)


def arrays(v: Vector3, q: Quaternion) -> tuple[Float64, Float64]:
    """Return (3,) and (4,) xyzw as they are stored."""
    return np.array([v.x, v.y, v.z]), np.array([q.x, q.y, q.z, q.w])


_IDENTITY = PoseProto(position=Vector3(), orientation=Quaternion(w=1.0))
_UNSET = PoseProto()


def _stamp_ns(proto: RawImage | CompressedImage | CloudProto | PoseInFrame, origin: Origin) -> int:
    return nanoseconds(proto.timestamp) if proto.HasField("timestamp") else origin.publish_ns
