"""Requests to a program: messages of the schema, with points and images left where they are."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.replay.data.arrays import Array
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.data.rig import LogInfo, Rig

VERSION = 1
"""Of the protocol."""
_KINDS = {
    "camera": schema.SENSOR_KIND_CAMERA,
    "lidar": schema.SENSOR_KIND_LIDAR,
    "radar": schema.SENSOR_KIND_RADAR,
}
Pieces = list[bytes | memoryview]
"""Parts of one serialised message, in order."""


def hello(rig: Rig, info: LogInfo) -> schema.Hello:
    """Introduce a log and its rig."""
    return schema.Hello(
        version=VERSION,
        log_name=info.name,
        log_id=info.log_id,
        metadata=dict(info.metadata),
        sensors=[_sensor(rig, name) for name in sorted(rig.mounts)],
    )


def _sensor(rig: Rig, name: str) -> schema.Sensor:
    mount, camera = rig.mounts[name], rig.cameras.get(name)
    sensor = schema.Sensor(
        name=name,
        kind=_KINDS[mount.kind],
        translation_m=mount.translation_m.tolist(),
        rotation_xyzw=mount.rotation_xyzw.tolist(),
    )
    if camera is not None:
        sensor.camera.k[:] = camera.K.ravel().tolist()
        sensor.camera.width_px, sensor.camera.height_px = camera.size_wh
        sensor.camera.distortion_model = camera.distortion_model
        sensor.camera.distortion[:] = camera.distortion.tolist()
    return sensor


def small_request(sequence: int, kind: schema.Hello | schema.Reset) -> Pieces:
    """Return a request without bulk data."""
    if isinstance(kind, schema.Hello):
        return [schema.Request(sequence=sequence, hello=kind).SerializeToString()]
    return [schema.Request(sequence=sequence, reset=kind).SerializeToString()]


def frame_request(sequence: int, frame: Frame) -> Pieces:
    """Return the request for one frame: the small fields by the generated code, around views of the bulk data.

    Serialised fields of one message may follow each other in any order and be joined, so that what is written by hand
    is only the tag and length before each array.
    """
    head = schema.Frame(index=frame.index, stamp_ns=frame.stamp_ns, segment=frame.segment, missing=dict(frame.missing))
    if frame.frame_number is not None:
        head.frame_number = frame.frame_number
    pieces: Pieces = [head.SerializeToString()]
    for _, message in sorted(frame.messages.items()):
        pieces += _nested(schema.Frame.MESSAGES_FIELD_NUMBER, _message(message))
    sequenced = schema.Request(sequence=sequence).SerializeToString()
    return [sequenced, *_nested(schema.Request.FRAME_FIELD_NUMBER, pieces)]


def _message(message: Message) -> Pieces:
    head = schema.Message(sensor=message.sensor, stamp_ns=message.stamp_ns, log_ns=message.log_ns)
    number, content = _CONTENT[type(message)](message)
    return [head.SerializeToString(), *_nested(number, content)]


def _image(image: Image) -> tuple[int, Pieces]:
    width, height = image.size_wh
    head = schema.Image(encoding=image.encoding, width_px=width, height_px=height)
    data = _nested(schema.Image.DATA_FIELD_NUMBER, [image.data])
    return schema.Message.IMAGE_FIELD_NUMBER, [head.SerializeToString(), *data]


def _points(cloud: PointCloud) -> tuple[int, Pieces]:
    fields = schema.PointCloud
    return schema.Message.POINTS_FIELD_NUMBER, _columns(
        (fields.XYZ_FIELD_NUMBER, cloud.xyz, "<f4"),
        (fields.INTENSITY_FIELD_NUMBER, cloud.intensity, "<f4"),
        (fields.RING_FIELD_NUMBER, cloud.ring, "<u2"),
        (fields.OFFSET_NS_FIELD_NUMBER, cloud.offset_ns, "<i4"),
    )


def _radar(scan: RadarScan) -> tuple[int, Pieces]:
    fields = schema.RadarScan
    return schema.Message.RADAR_FIELD_NUMBER, _columns(
        (fields.XYZ_FIELD_NUMBER, scan.xyz, "<f4"),
        (fields.RADIAL_VELOCITY_MPS_FIELD_NUMBER, scan.radial_velocity_mps, "<f4"),
        (fields.RCS_DBSM_FIELD_NUMBER, scan.rcs_dbsm, "<f4"),
        (fields.RANGE_M_FIELD_NUMBER, scan.range_m, "<f4"),
        (fields.AZIMUTH_RAD_FIELD_NUMBER, scan.azimuth_rad, "<f4"),
        (fields.ALTITUDE_RAD_FIELD_NUMBER, scan.altitude_rad, "<f4"),
    )


def _pose(pose: Pose) -> tuple[int, Pieces]:
    content = schema.Pose(translation_m=pose.translation_m.tolist(), rotation_xyzw=pose.rotation_xyzw.tolist())
    return schema.Message.POSE_FIELD_NUMBER, [content.SerializeToString()]


_CONTENT: Mapping[type, Callable[..., tuple[int, Pieces]]] = {
    Image: _image,
    PointCloud: _points,
    RadarScan: _radar,
    Pose: _pose,
}


def _columns(*columns: tuple[int, Array | None, str]) -> Pieces:
    pieces: Pieces = []
    for number, array, dtype in columns:
        if array is not None:
            pieces += _nested(number, [_view(array, dtype)])
    return pieces


def _view(array: Array, dtype: str) -> memoryview:
    """Bytes of an array, without a copy where it lies in memory as it is wanted."""
    return np.ascontiguousarray(array, dtype).reshape(-1).view(np.uint8).data


def _nested(number: int, pieces: Sequence[bytes | memoryview]) -> Pieces:
    """One length-delimited field."""
    return [_varint(number << 3 | 2) + _varint(sum(map(len, pieces))), *pieces]


def _varint(value: int) -> bytes:
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    parts.append(value)
    return bytes(parts)
