"""The names of the fields of points, as a message gives them."""

from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto

from fbench.replay.errors import DecodeError
from fbench.replay.logs.container import Channel, Entry
from fbench.replay.logs.foxglove.proto import parse
from fbench.replay.logs.foxglove.wire import split
from fbench.replay.logs.point_fields import DOPPLER_FIELDS, VECTOR_FIELDS
from fbench.replay.logs.ros.definitions import full_name
from fbench.replay.logs.ros.sensor_messages import read_cloud


def cloud_fields(channel: Channel, entry: Entry) -> tuple[str, ...]:
    """Return the names of a cloud's fields, none where the message isn't a cloud or can't be read."""
    if not isinstance(entry.data, memoryview):
        return ()
    try:
        if channel.schema_name == "foxglove.PointCloud":
            proto = parse(CloudProto, split(entry.data, CloudProto.DATA_FIELD_NUMBER)[0])
            return tuple(field.name for field in proto.fields)
        if channel.encoding in ("cdr", "ros1") and full_name(channel.schema_name) == "sensor_msgs/msg/PointCloud2":
            return tuple(field.name for field in read_cloud(entry.data, channel.encoding).fields)
    except DecodeError:
        pass
    return ()


def doppler_field(fields: tuple[str, ...]) -> str:
    """Return which field gives the radial velocity that fbench reads, empty where none does."""
    lower = {name.lower(): name for name in fields}
    found = next((lower[name] for name in DOPPLER_FIELDS if name in lower), "")
    if not found and all(name in lower for name in VECTOR_FIELDS):
        return " and ".join(lower[name] for name in VECTOR_FIELDS)
    return found


def compensated_field(fields: tuple[str, ...]) -> str:
    """Return a field with velocities that are free of the vehicle's own motion, which fbench doesn't read."""
    words = ("comp", "compensated", "corrected", "ego")
    speeds = ("v", "vr", "vx", "doppler", "velocity", "speed", "radial")
    for name in fields:
        parts = name.lower().split("_")
        if any(part in words for part in parts) and any(part in speeds for part in parts):
            return name
    return ""
