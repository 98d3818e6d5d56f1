"""Codec between sensor messages and the Foxglove Protobuf schemas; exact for every field."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField as Field
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto
from foxglove_schemas_protobuf.Pose_pb2 import Pose as PoseProto
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from fbench.replay.contracts.errors import DecodeError, PointsError, UnsupportedError
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.images import RAW_CHANNELS, layout_name, pack_rows, read_size, sniff_format
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan
from fbench.replay.geometry.transforms import pose_matrix, transform
from fbench.replay.logs.codecs.codec import Origin
from fbench.replay.logs.codecs.foxglove.proto import nanoseconds, parse, split, timestamp
from fbench.replay.logs.codecs.packed_points import C, Columns, PointField, lidar_sweep, radar_scan
from fbench.replay.logs.coordinate_frames import BODIES

_TYPES: Mapping[int, str] = {
    Field.UINT8: "u1", Field.INT8: "i1", Field.UINT16: "u2", Field.INT16: "i2",
    Field.UINT32: "u4", Field.INT32: "i4", Field.FLOAT32: "f4", Field.FLOAT64: "f8",
}  # fmt: skip
_CODES: Mapping[Any, Any] = {np.dtype(name).newbyteorder("<"): code for code, name in _TYPES.items()}
WORLD = "world"
_IDENTITY = PoseProto(position=Vector3(), orientation=Quaternion(w=1.0))
_UNSET = PoseProto()


def image_proto(image: Image) -> RawImage | CompressedImage:
    """Encode an image: raw layouts as RawImage, all others as CompressedImage."""
    stamp, frame_id, data = timestamp(image.stamp_ns), image.sensor, image.data
    if image.encoding not in RAW_CHANNELS:
        return CompressedImage(timestamp=stamp, frame_id=frame_id, data=data, format=image.encoding)
    (width, height), encoding = image.size_wh, image.encoding
    raw = RawImage(timestamp=stamp, frame_id=frame_id, width=width, height=height, encoding=encoding, data=data)
    raw.step = width * RAW_CHANNELS[encoding]
    return raw


def read_compressed_image(data: memoryview, origin: Origin) -> Image:
    """Decode a CompressedImage; a foreign one's size is read from the header of the JPEG or PNG. Raises DecodeError
    where the message or that header is damaged.
    """
    head, encoded = split(data, CompressedImage.DATA_FIELD_NUMBER)
    proto, pixels = parse(CompressedImage, head), bytes(encoded)
    stamp_ns, size_wh = _stamp_ns(proto, origin), origin.size_wh
    encoding = proto.format if size_wh is not None else sniff_format(encoded)
    size_wh = size_wh or read_size(pixels)
    return Image(origin.sensor, stamp_ns, origin.log_ns, pixels, encoding, size_wh, origin.frame_number)


def read_raw_image(data: memoryview, origin: Origin) -> Image:
    """Decode a RawImage; padding at the end of the rows of a foreign one is removed. Raises DecodeError where the
    message is damaged, or of a foreign one the layout isn't known or the data don't fit.
    """
    head, rows = split(data, RawImage.DATA_FIELD_NUMBER)
    proto = parse(RawImage, head)
    stamp_ns, encoding, size_wh = _stamp_ns(proto, origin), proto.encoding, origin.size_wh
    if size_wh is not None:
        pixels = bytes(rows)
    else:
        encoding, size_wh = layout_name(encoding), (proto.width, proto.height)
        pixels = pack_rows(rows, encoding, size_wh, proto.step)
    return Image(origin.sensor, stamp_ns, origin.log_ns, pixels, encoding, size_wh, origin.frame_number)


def cloud_proto(cloud: PointCloud) -> CloudProto:
    """Encode a LiDAR sweep with the fields x, y, z and, where present, intensity, ring, offset_ns."""
    return _pack(cloud, {"intensity": cloud.intensity, "ring": cloud.ring, "offset_ns": cloud.offset_ns})


def radar_proto(scan: RadarScan) -> CloudProto:
    """Encode a radar scan: x, y, z and, where present, velocity, rcs, range, azimuth, altitude."""
    columns = {"velocity": scan.radial_velocity_mps, "rcs": scan.rcs_dbsm, "range": scan.range_m}
    return _pack(scan, columns | {"azimuth": scan.azimuth_rad, "altitude": scan.altitude_rad})


def _pack(points: PointCloud | RadarScan, columns: Mapping[str, Array | None]) -> CloudProto:
    """Encode coordinates and columns; those that are `None` are left out."""
    proto = CloudProto(timestamp=timestamp(points.stamp_ns), frame_id=points.sensor, pose=_IDENTITY)
    named: dict[str, Array] = {axis: points.xyz[:, i] for i, axis in enumerate("xyz")}
    named |= {name: column for name, column in columns.items() if column is not None}
    dtype = np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in named.items()])
    rows = np.empty(len(points.xyz), dtype)
    offset = 0
    for name, column in named.items():
        rows[name] = column
        proto.fields.add(name=name, offset=offset, type=_CODES[column.dtype.newbyteorder("<")])
        offset += column.dtype.itemsize
    proto.point_stride = dtype.itemsize
    proto.data = rows.tobytes()
    return proto


def read_cloud(data: memoryview, origin: Origin) -> PointCloud:
    """Decode a LiDAR sweep; points are moved by the message's pose where it has one. Times of points under other names
    than that of fbench are read as drivers write them; see `offset_ns`. Raises DecodeError where the message is damaged
    or has no coordinates.
    """
    proto, columns = _read_columns(data)
    return _place(proto, lidar_sweep(columns, _stamp_ns(proto, origin), origin, columns.get(("offset_ns",), "i4")))


def read_radar(data: memoryview, origin: Origin) -> RadarScan:
    """Decode a radar scan. Raises DecodeError where the message is damaged or has no coordinates."""
    proto, columns = _read_columns(data)
    return _place(proto, radar_scan(columns, _stamp_ns(proto, origin), origin))


def _read_columns(data: memoryview) -> tuple[CloudProto, Columns]:
    head, points = split(data, CloudProto.DATA_FIELD_NUMBER)
    proto = parse(CloudProto, head)
    stride, size = proto.point_stride, len(points)
    if stride == 0 and size:
        raise PointsError("points of 0 bytes")
    if stride and size % stride:
        raise PointsError(f"{size} bytes aren't a multiple of the point stride {stride}")
    fields = [PointField(field.name, field.offset, field.type) for field in proto.fields]
    return proto, Columns(fields, _TYPES, points, (1, size // stride if stride else 0), (size, stride))


def _place(proto: CloudProto, points: C) -> C:
    """Move points by the pose that the message gives, where it gives one."""
    if not proto.HasField("pose") or proto.pose in (_IDENTITY, _UNSET):
        return points
    try:
        matrix = pose_matrix(*arrays(proto.pose.position, proto.pose.orientation))
    except ValueError as error:
        raise DecodeError(f"pose of the points isn't one ({error})") from error
    with np.errstate(over="ignore", invalid="ignore"):  # what isn't finite is dealt with where it matters
        return replace(points, xyz=transform(matrix, points.xyz).astype(np.float32))


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
    pose = arrays(proto.pose.position, proto.pose.orientation)
    return Pose(origin.sensor, _stamp_ns(proto, origin), origin.log_ns, *pose, origin.frame_number)


def vector(xyz: Array) -> Vector3:
    """Encode (3,)."""
    x, y, z = xyz.tolist()
    return Vector3(x=x, y=y, z=z)


def rotation(xyzw: Array) -> Quaternion:
    """Encode a quaternion (4,) xyzw."""
    x, y, z, w = xyzw.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def arrays(v: Vector3, q: Quaternion) -> tuple[Float64, Float64]:
    """Return (3,) and (4,) xyzw as they are stored."""
    return np.array([v.x, v.y, v.z]), np.array([q.x, q.y, q.z, q.w])


def _stamp_ns(proto: RawImage | CompressedImage | CloudProto | PoseInFrame, origin: Origin) -> int:
    return nanoseconds(proto.timestamp) if proto.HasField("timestamp") else origin.publish_ns
