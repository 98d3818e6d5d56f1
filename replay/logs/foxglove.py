"""Codec between sensor messages and the Foxglove Protobuf schemas; exact for every field."""

from dataclasses import dataclass

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto
from foxglove_schemas_protobuf.Pose_pb2 import Pose as PoseProto
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from fbench.replay.arrays import Array, Float32, Float64
from fbench.replay.data import Image, PointCloud, Pose, RadarScan
from fbench.replay.errors import DecodeError
from fbench.replay.geometry.transforms import pose_matrix, transform
from fbench.replay.images import RAW_CHANNELS, encoded_size
from fbench.replay.logs.points import Columns, pack
from fbench.replay.logs.proto import nanoseconds, parse, timestamp

BODY = "body"
WORLD = "world"
_RAW_NAMES = {"8UC1": "mono8", "8UC3": "bgr8"}


@dataclass(frozen=True)
class Origin:
    """What the container says about one message."""

    sensor: str
    log_ns: int
    publish_ns: int
    frame_number: int | None = None
    size_wh: tuple[int, int] | None = None
    """Of images whose channel states it, as those that fbench wrote do."""


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


def read_compressed_image(data: bytes, origin: Origin) -> Image:
    """Decode a CompressedImage; a foreign one's size is read from the header of the JPEG or PNG.

    Raises:
        DecodeError: where the message or that header is damaged.
    """
    proto = parse(CompressedImage, data)
    stamp_ns = _stamp_ns(proto, origin)
    if origin.size_wh is not None:
        return Image(
            origin.sensor, stamp_ns, origin.log_ns, proto.data, proto.format, origin.size_wh, origin.frame_number
        )
    size_wh, encoding = encoded_size(proto.data), _plain_format(proto.format)
    return Image(origin.sensor, stamp_ns, origin.log_ns, proto.data, encoding, size_wh, origin.frame_number)


def read_raw_image(data: bytes, origin: Origin) -> Image:
    """Decode a RawImage; padding at the end of the rows of a foreign one is removed.

    Raises:
        DecodeError: where the message is damaged or shorter than its rows.
    """
    proto = parse(RawImage, data)
    pixels, encoding = proto.data, proto.encoding
    if origin.size_wh is None:
        encoding = _RAW_NAMES.get(encoding, encoding)
        pixels = _without_padding(proto, RAW_CHANNELS.get(encoding, 0))
    size_wh = origin.size_wh or (proto.width, proto.height)
    return Image(origin.sensor, _stamp_ns(proto, origin), origin.log_ns, pixels, encoding, size_wh, origin.frame_number)


def _plain_format(text: str) -> str:
    """Return `jpeg` for `jpg` and for ROS's `rgb8; jpeg compressed bgr8`, likewise for png and webp."""
    names = {"jpeg": "jpeg", "jpg": "jpeg", "png": "png", "webp": "webp"}
    return next((plain for name, plain in names.items() if name in text.lower()), text)


def _without_padding(proto: RawImage, channels: int) -> bytes:
    row = proto.width * channels
    if row == 0 or proto.step == row:
        return proto.data
    if proto.step < row or len(proto.data) < proto.step * proto.height:
        raise DecodeError(f"image of {proto.width}x{proto.height} has {len(proto.data)} bytes, step {proto.step}")
    rows = np.frombuffer(proto.data, np.uint8, proto.step * proto.height).reshape(proto.height, proto.step)
    return rows[:, :row].tobytes()


def cloud_proto(cloud: PointCloud) -> CloudProto:
    """Encode a LiDAR sweep with the fields x, y, z and, where present, intensity, ring, offset_ns."""
    proto = CloudProto(timestamp=timestamp(cloud.stamp_ns), frame_id=cloud.sensor, pose=_IDENTITY)
    pack(proto, cloud.xyz, {"intensity": cloud.intensity, "ring": cloud.ring, "offset_ns": cloud.offset_ns})
    return proto


def read_cloud(data: bytes, origin: Origin) -> PointCloud:
    """Decode a LiDAR sweep; points are moved by the message's pose where it has one.

    Raises:
        DecodeError: where the message is damaged or has no coordinates.
    """
    proto = parse(CloudProto, data)
    columns = Columns(proto)
    return PointCloud(
        origin.sensor, _stamp_ns(proto, origin), origin.log_ns, _xyz(proto, columns),
        columns.get(("intensity", "reflectivity"), "f4"), columns.get(("ring",), "u2"),
        columns.get(("offset_ns",), "i4"), origin.frame_number,
    )  # fmt: skip


RADAR_FIELDS = ("velocity", "doppler", "radial_velocity")
"""A cloud with one of these fields is a radar scan."""


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


def read_radar(data: bytes, origin: Origin) -> RadarScan:
    """Decode a radar scan.

    Raises:
        DecodeError: where the message is damaged or has no coordinates.
    """
    proto = parse(CloudProto, data)
    columns = Columns(proto)
    names = (RADAR_FIELDS, ("rcs",), ("range",), ("azimuth",), ("altitude", "elevation"))
    velocity, rcs, distance, azimuth, altitude = (columns.get(name, "f4") for name in names)
    return RadarScan(
        origin.sensor, _stamp_ns(proto, origin), origin.log_ns, _xyz(proto, columns), velocity, rcs, distance, azimuth,
        altitude, origin.frame_number,
    )  # fmt: skip


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


def read_pose(data: bytes, origin: Origin) -> Pose:
    """Decode a pose.

    Raises:
        DecodeError: where the message is damaged.
    """
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
