"""What each channel of an MCAP log means: kind, sensor, and where its frame numbers are."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.records import Channel

from fbench.replay.errors import DecodeError, LogError
from fbench.replay.logs.foxglove import RADAR_FIELDS
from fbench.replay.logs.mcap_file import McapFile
from fbench.replay.logs.proto import parse
from fbench.replay.logs.topics import FRAME_NUMBER, KIND, SENSOR, SEQUENCE, SIZE

SCHEMAS: Mapping[str, tuple[str, ...]] = {
    "foxglove.CompressedImage": ("camera",),
    "foxglove.RawImage": ("camera",),
    "foxglove.PointCloud": ("lidar", "radar"),
    "foxglove.PoseInFrame": ("pose",),
    "foxglove.CameraCalibration": ("calibration",),
    "foxglove.FrameTransform": ("transform",),
    "foxglove.FrameTransforms": ("transform",),
    "foxglove.SceneUpdate": ("truth",),
}
"""The kinds that a channel of each schema can have."""
_SENSOR_SCHEMAS: Mapping[str, type[CompressedImage | RawImage | CloudProto]] = {
    "foxglove.CompressedImage": CompressedImage,
    "foxglove.RawImage": RawImage,
    "foxglove.PointCloud": CloudProto,
}


@dataclass(frozen=True)
class Role:
    """The meaning of one channel."""

    schema: str
    kind: str
    sensor: str = ""
    frame_id: str = ""
    """Coordinate frame of the sensor."""
    numbered: bool = False
    """Whether the container's sequence number is the frame number."""
    size_wh: tuple[int, int] | None = None


def roles(file: McapFile) -> dict[int, Role]:
    """Roles of the channels that fbench understands, by id; the other topics are counted.

    Raises:
        LogError: where one topic holds messages of two schemas that both are understood.
    """
    found: dict[int, Role] = {}
    foreign: dict[int, str] = {}
    for channel in sorted(file.index.channels.values(), key=lambda c: (c.topic, c.id)):
        schema = file.schema(channel.id)
        name = schema.name if schema is not None else ""
        kinds = SCHEMAS.get(name, ()) if channel.message_encoding == "protobuf" else ()
        own = _own(channel, name)
        if own is not None and own.kind in kinds:
            found[channel.id] = own
        elif kinds and kinds != ("truth",):
            foreign[channel.id] = name
        else:
            _count_unknown(file, channel, name)
    found |= _foreign(file, foreign)
    _check_schemas(file, found)
    return found


def _count_unknown(file: McapFile, channel: Channel, schema: str) -> None:
    what = f"topic '{channel.topic}' has unknown schema '{schema}' (encoding {channel.message_encoding or 'none'})"
    file.once("LOG008", (channel.topic,), what)


def _own(channel: Channel, schema: str) -> Role | None:
    """Read channel metadata as fbench writes them; `None` where they aren't there."""
    kind, sensor = channel.metadata.get(KIND), channel.metadata.get(SENSOR, "")
    if kind is None or (kind in ("camera", "lidar", "radar", "pose", "calibration") and SENSOR not in channel.metadata):
        return None
    return Role(schema, kind, sensor, sensor, channel.metadata.get(FRAME_NUMBER) == SEQUENCE, _size(channel))


def _size(channel: Channel) -> tuple[int, int] | None:
    width, _, height = channel.metadata.get(SIZE, "").partition("x")
    return (int(width), int(height)) if width.isdecimal() and height.isdecimal() else None


def _foreign(file: McapFile, schemas: Mapping[int, str]) -> dict[int, Role]:
    """Find kind and sensor of channels without our metadata from their first messages."""
    sensors = {id_: _probe(file, id_, name) for id_, name in schemas.items() if name in _SENSOR_SCHEMAS}
    frames = {id_: frame for id_, (_, frame) in sensors.items()}
    topics = {(file.index.channels[id_].topic, frame) for id_, frame in frames.items()}
    shared = Counter(frame for _, frame in topics)
    found: dict[int, Role] = {}
    for id_, schema in schemas.items():
        topic = file.index.channels[id_].topic
        if id_ in sensors:
            kind, frame = sensors[id_]
            found[id_] = Role(schema, kind, frame if frame and shared[frame] == 1 else topic.strip("/"), frame)
        else:
            found[id_] = Role(schema, SCHEMAS[schema][0], topic.strip("/"))
    return found


def _probe(file: McapFile, channel: int, schema: str) -> tuple[str, str]:
    """Kind and coordinate frame of a sensor's channel."""
    entry = file.first(frozenset([channel]))
    kind = SCHEMAS[schema][0]
    if entry is None:
        return kind, ""
    try:
        proto = parse(_SENSOR_SCHEMAS[schema], bytes(entry.data))
    except DecodeError:
        return kind, ""
    if isinstance(proto, CloudProto) and any(f.name in RADAR_FIELDS for f in proto.fields):
        kind = "radar"
    return kind, proto.frame_id


def _check_schemas(file: McapFile, found: Mapping[int, Role]) -> None:
    schemas: dict[str, str] = {}
    for id_, role in sorted(found.items()):
        topic = file.index.channels[id_].topic
        if schemas.setdefault(topic, role.schema) != role.schema:
            raise LogError(
                f"{file.path}: topic '{topic}' has messages of two schemas, {schemas[topic]} and {role.schema}"
            )
