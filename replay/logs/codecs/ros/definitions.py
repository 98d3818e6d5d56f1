"""Message definitions: the one that a log carries, else that of the standard.

rosbags turns definitions into Python code, which it executes. A log is untrusted, so names, types and sizes must pass
a strict grammar first, and messages must not be able to grow far beyond their payload when they are decoded. Texts in
IDL count only for types that aren't standard. They are read by `idl`: rosbags' parser takes 0.2 s for one pair of
brackets, 7 s for two in each other.
"""

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.logs.codecs.ros.cursor import CDR
from fbench.replay.logs.codecs.ros.idl import idl_texts
from fbench.replay.logs.container import Schema

if TYPE_CHECKING:
    from rosbags.interfaces import Nodetype

DEFINITIONS: Mapping[str, str] = {
    "vision_msgs/msg/Detection2DArray": "std_msgs/Header header\nDetection2D[] detections",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nDetection3D[] detections",
    "vision_msgs/msg/Detection2D":
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\nstring id",
    "vision_msgs/msg/Detection3D":
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id",
    "vision_msgs/msg/ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/BoundingBox2D": "Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/Pose2D": "Point2D position\nfloat64 theta",
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y",
    **{
        f"{package}/msg/CustomMsg":
            "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
            "CustomPoint[] points"
        for package in ("livox_ros_driver", "livox_ros_driver2")
    },
    **{
        f"{package}/msg/CustomPoint":
            "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
        for package in ("livox_ros_driver", "livox_ros_driver2")
    },
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\nVelodynePacket[] packets",
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
    **{f"{package}/msg/PandarScan": "std_msgs/Header header\nPandarPacket[] packets"
       for package in ("pandar_msgs", "hesai_lidar")},
    **{f"{package}/msg/PandarPacket": "builtin_interfaces/Time stamp\nuint8[1500] data\nuint32 size"
       for package in ("pandar_msgs", "hesai_lidar")},
    "nebula_msgs/msg/NebulaPackets": "std_msgs/Header header\nNebulaPacket[] packets",
    "nebula_msgs/msg/NebulaPacket": "builtin_interfaces/Time stamp\nuint8[] data",
    "radar_msgs/msg/RadarScan": "std_msgs/Header header\nRadarReturn[] returns",
    "radar_msgs/msg/RadarReturn":
        "float32 range\nfloat32 azimuth\nfloat32 elevation\nfloat32 doppler_velocity\nfloat32 amplitude",
    "radar_msgs/msg/RadarTracks": "std_msgs/Header header\nRadarTrack[] tracks",
    "radar_msgs/msg/RadarTrack":
        "unique_identifier_msgs/UUID uuid\ngeometry_msgs/Point position\ngeometry_msgs/Vector3 velocity\n"
        "geometry_msgs/Vector3 acceleration\ngeometry_msgs/Vector3 size\nuint16 classification\n"
        "float32[6] position_covariance\nfloat32[6] velocity_covariance\nfloat32[6] acceleration_covariance\n"
        "float32[6] size_covariance",
    "unique_identifier_msgs/msg/UUID": "uint8[16] uuid",
    "foxglove_msgs/msg/CompressedVideo":
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format",
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket":
        "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
        "bool is_bigendian\nuint8[] data",
    "h264_msgs/msg/Packet": "std_msgs/Header header\nuint64 seq\nuint8[] data",
    "theora_image_transport/msg/Packet":
        "std_msgs/Header header\nuint8[] data\nint32 b_o_s\nint32 e_o_s\nint64 granulepos\nint64 packetno",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "tf/msg/tfMessage": "geometry_msgs/TransformStamped[] transforms",
}  # fmt: skip
"""Text of the definition by full name. Layouts are those of vision_msgs 4, radar_msgs 0.2, tf2_msgs,
foxglove_msgs, ffmpeg_image_transport_msgs 1, h264_msgs, theora_image_transport 5, and of the drivers of Livox,
Velodyne, Hesai and nebula.
"""

MAX_BYTES = 64 * 1024  # Of the text of a definition; the longest of a standard message has 20 KiB
_TEXTS, _IDL = ("ros2msg", "ros1msg"), "ros2idl"
_TYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}/msg/[A-Za-z][A-Za-z0-9_]{0,63}", re.ASCII)
_PACKAGE = re.compile(r"^((?:MSG: )?[ \t]*)([A-Za-z][A-Za-z0-9_]*)(?=/)", re.ASCII | re.MULTILINE)
_DDS = re.compile(r"(\w+)::msg::dds_::(\w+)_", re.ASCII)
_FIELD = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}", re.ASCII)
_SIZES: Mapping[str, int] = {
    "bool": 1, "byte": 1, "char": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4,
    "int64": 8, "uint64": 8, "float32": 4, "float64": 8, "string": 4,
}  # fmt: skip
_MAX_TYPES, _MAX_FIELDS, _MAX_OBJECTS = 32, 256, 256
_MAX_NUMBERS = 4096  # In an array of fixed size
_BYTES_PER_OBJECT = 5
"""What a repeated message has at least (Autoware has such of 5); a Python object takes some 200 bytes."""

Types = dict[str, tuple[list[Any], list[Any]]]  # Constants and fields by full name, as rosbags has them


def full_name(name: str) -> str:
    """Return `pkg/msg/Name`, also for `pkg/Name` and what recorders of DDS write: `pkg::msg::dds_::Name_`. rosbags
    knows packages in lower case only, unlike `ars_40X`.
    """
    if dds := _DDS.fullmatch(name):
        name = f"{dds[1]}/{dds[2]}"
    parts = name.split("/")
    parts[0] = parts[0].lower() if len(parts) > 1 else parts[0]
    return "/".join((parts[0], "msg", parts[1])) if len(parts) == 2 else name


def has_text(schema: Schema | None) -> bool:
    """Tell whether a log carries the definition in a form that is read."""
    return schema is not None and schema.encoding in (*_TEXTS, _IDL) and bool(schema.data.strip())


def types_of(name: str, schema: Schema | None, encoding: str, *, by_rosbags: bool = True) -> Types:
    """All types of `name`; the log's win. Raises DecodeError where one is damaged, incomplete or, if rosbags is to
    decode the messages, not sensible.
    """
    from rosbags.typesys import Stores, get_typestore

    standard = get_typestore(Stores.ROS2_JAZZY if encoding == CDR else Stores.ROS1_NOETIC).fielddefs
    types: Types = {}
    sources: tuple[Types, ...] = (_embed(name, schema), standard)
    if schema is not None and schema.encoding == _IDL and name not in DEFINITIONS and name not in standard:
        sources = (*sources, _parse(idl_texts(schema.data)))
    _collect(name, sources, types)
    if by_rosbags:
        _measure(name, types, {})
    return types


def _embed(name: str, schema: Schema | None) -> Types:
    if schema is None or schema.encoding not in _TEXTS or not has_text(schema):
        return {}
    if len(schema.data) > MAX_BYTES:
        raise DecodeError(f"definition of {name} has {len(schema.data)} bytes, more than {MAX_BYTES}")
    try:
        text = schema.data.decode()
    except UnicodeDecodeError as error:
        raise DecodeError(f"definition of {name} isn't UTF-8 ({error})") from error
    text = _PACKAGE.sub(lambda match: match[1] + match[2].lower(), text)
    return _parse({name: text.replace("\r\n", "\n").rstrip() + "\n"})


def _parse(texts: Mapping[str, str]) -> Types:
    from rosbags.typesys import TypesysError, get_types_from_msg

    types: Types = {}
    for name, text in texts.items():
        try:
            types |= get_types_from_msg(text, name)
        except TypesysError as error:
            raise DecodeError(f"definition of {name} can't be parsed") from error
        except (ValueError, TypeError, AssertionError, KeyError, IndexError, OverflowError, RecursionError) as error:
            raise DecodeError(f"definition of {name} can't be parsed ({error})") from error
    return types


def _collect(name: str, sources: tuple[Types, ...], types: Types) -> None:
    """Add a type and those of its fields: as the first source gives it, which is the log's, else as `DEFINITIONS`, else
    as the other sources do. Constants are left out, nothing needs them.
    """
    if name in types:
        return
    if not _TYPE.fullmatch(name):
        raise DecodeError(f"'{name[:80]}' isn't the name of a message type")
    first, *others = sources
    if name not in first and name in DEFINITIONS:
        first = _parse({name: DEFINITIONS[name]})  # one at a time: all take 8 ms
    fields = next((source[name][1] for source in (first, *others) if name in source), None)
    if fields is None:
        raise DecodeError(f"definition of {name} is missing")
    if len(types) >= _MAX_TYPES or len(fields) > _MAX_FIELDS:
        raise DecodeError(f"definition of {name} has more than {_MAX_TYPES} types or {_MAX_FIELDS} fields")
    types[name] = ([], list(fields))
    for field, descriptor in fields:
        if not _FIELD.fullmatch(field):
            raise DecodeError(f"definition of {name} has a field '{field[:80]}', which isn't a name")
        inner = _element(descriptor)[0]
        if inner not in _SIZES:
            _collect(inner, sources, types)


def _element(descriptor: tuple["Nodetype", Any]) -> tuple[str, int | None]:
    """Type of a field or of its elements, and their number: `None` for a sequence."""
    from rosbags.interfaces import Nodetype

    node, what = descriptor
    number: int | None = 1
    if node not in (Nodetype.BASE, Nodetype.NAME):
        number = what[1] if node == Nodetype.ARRAY else None
        node, what = what[0]
    return str(what[0] if node == Nodetype.BASE else what), number


def has_bulk_only(types: Types) -> bool:
    """Tell whether sequences in messages of these types are of numbers alone, which are read at once."""
    parts = [_element(descriptor) for _, fields in types.values() for _, descriptor in fields]
    return all(number is not None or (inner in _SIZES and inner != "string") for inner, number in parts)


class _Size(NamedTuple):
    """What a message of a type is decoded to."""

    objects: int
    texts: int  # Not in objects: an empty one costs nothing
    num_bytes: int  # Which its payload has at least


def _measure(name: str, types: Types, done: dict[str, _Size | None]) -> _Size:
    if name in _SIZES:
        return _Size(0, 1 if name == "string" else 0, _SIZES[name])
    if known := done.get(name):
        return known
    if name in done:
        raise DecodeError(f"definition of {name} contains itself")
    done[name] = None
    objects, texts, num_bytes = 1, 0, 0
    for field, descriptor in types[name][1]:
        inner, number = _element(descriptor)
        each = _measure(inner, types, done)
        if number is None:
            if each.num_bytes < _BYTES_PER_OBJECT * each.objects:
                what = f"{each.objects} parts in {each.num_bytes} bytes"
                raise DecodeError(f"definition of {name} repeats '{field}' of {what}")
            num_bytes += 4
        else:
            # Arrays of numbers are read at once, for others rosbags writes code for each element.
            most = _MAX_NUMBERS if inner in _SIZES and inner != "string" else 64
            if not 0 < number <= most:
                raise DecodeError(f"definition of {name} has an array '{field}' of {number}, 1 to {most} are read")
            objects, texts = objects + each.objects * number, texts + each.texts * number
            num_bytes += each.num_bytes * number
    if objects + texts > _MAX_OBJECTS:
        raise DecodeError(f"definition of {name} has {objects + texts} parts, more than {_MAX_OBJECTS}")
    size = done[name] = _Size(objects, texts, num_bytes)
    return size
