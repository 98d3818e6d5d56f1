"""Messages to and from a program: requests that leave points and images where they are, and checked responses."""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from google.protobuf.message import DecodeError as ProtobufError

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.replay.contracts.errors import DataError
from fbench.replay.data.arrays import MAX_TEXT, Array, text_array
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D, finite
from fbench.replay.data.frames import Fault, Frame, Output
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan
from fbench.replay.data.rig import Kind, LogInfo, Mount, Rig

VERSION = 1  # Of the protocol
KINDS: Mapping[Kind, schema.SensorKind.ValueType] = {
    "camera": schema.SENSOR_KIND_CAMERA, "lidar": schema.SENSOR_KIND_LIDAR, "radar": schema.SENSOR_KIND_RADAR,
}  # fmt: skip
_NOWHERE = Mount("camera", np.full(3, np.nan), np.array([0.0, 0, 0, 1]))  # Of a camera whose place nobody knows
Pieces = list[bytes | memoryview]  # Parts of one serialised message, in order


def hello(rig: Rig, info: LogInfo) -> schema.Hello:
    """Introduce a log and its rig."""
    sensors = []
    for name in sorted({*rig.mounts, *rig.bare}):
        mount = rig.mounts.get(name, _NOWHERE)
        place = {"translation_m": mount.translation_m.tolist(), "rotation_xyzw": mount.rotation_xyzw.tolist()}
        sensor = schema.Sensor(name=name, kind=KINDS[mount.kind], **place)
        if (camera := rig.cameras.get(name)) is not None:
            sensor.camera.k[:] = camera.K.ravel().tolist()
            sensor.camera.width_px, sensor.camera.height_px = camera.size_wh
            sensor.camera.distortion_model = camera.distortion_model
            sensor.camera.distortion[:] = camera.distortion.tolist()
        sensors.append(sensor)
    metadata = dict(info.metadata)
    return schema.Hello(version=VERSION, log_name=info.name, log_id=info.log_id, metadata=metadata, sensors=sensors)


def small_request(
    sequence: int,
    hello: schema.Hello | None = None,
    reset: schema.Reset | None = None,
    question: schema.Question | None = None,
) -> Pieces:
    """Return a request without bulk data."""
    return [schema.Request(sequence=sequence, hello=hello, reset=reset, question=question).SerializeToString()]


@dataclass(frozen=True)
class DecodedFrame:
    """A frame in which pictures of videos are raw images."""

    frame: Frame
    missing: Mapping[str, str]  # Cameras whose picture is damaged, with the reason
    faults: Sequence[Fault]
    stage_ns: Mapping[str, int]  # How long decoding took, where there was video

    def complete(self, output: Output) -> Output:
        """Return what a program made of the frame, with what was met before it got it."""
        if not self.stage_ns:
            return output
        faults, missing = (*self.faults, *output.faults), {**self.missing, **output.missing}
        stages = {**self.stage_ns, **output.stage_ns} if output.clock == "host" else output.stage_ns
        return replace(output, faults=faults, missing=missing, stage_ns=stages)


def decode_videos(frame: Frame) -> DecodedFrame:
    """Decode the pictures of videos, since a program gets no packet of those between; damaged ones are missing."""
    shown, missing, faults = dict(frame.messages), dict[str, str](), list[Fault]()
    start_ns = time.perf_counter_ns()
    for name, message in frame.messages.items():
        if isinstance(message, Image) and message.video is not None:
            if (pixels := decode(message)) is None:
                del shown[name]
                missing[name] = "video can't be decoded"
                faults.append(Fault("DEC002", f"{name} at stamp {message.stamp_ns}"))
            else:
                shown[name] = replace(message, data=pixels.tobytes(), encoding="bgr8", video=None)
    if shown == frame.messages:
        return DecodedFrame(frame, {}, (), {})
    frame = replace(frame, messages=shown, missing={**frame.missing, **missing})
    return DecodedFrame(frame, missing, faults, {"decode": time.perf_counter_ns() - start_ns})


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
        small = schema.Message(sensor=message.sensor, stamp_ns=message.stamp_ns, log_ns=message.log_ns)
        if message.frame_number is not None:
            small.frame_number = message.frame_number
        number, content = _CONTENT[type(message)](message)
        one = [small.SerializeToString(), *_nest(number, content)]
        pieces += _nest(schema.Frame.MESSAGES_FIELD_NUMBER, one)
    sequenced = schema.Request(sequence=sequence).SerializeToString()
    return [sequenced, *_nest(schema.Request.FRAME_FIELD_NUMBER, pieces)]


def _image(image: Image) -> tuple[int, Pieces]:
    width, height = image.size_wh
    head = schema.Image(encoding=image.encoding, width_px=width, height_px=height)
    data = _nest(schema.Image.DATA_FIELD_NUMBER, [image.data])
    return schema.Message.IMAGE_FIELD_NUMBER, [head.SerializeToString(), *data]


WIRE = {"ring": "<u2", "offset_ns": "<i4"}  # Numbers of the columns that aren't float32 in messages


def _columns(points: PointCloud | RadarScan) -> tuple[int, Pieces]:
    is_cloud, pieces = isinstance(points, PointCloud), Pieces()
    for field in (schema.PointCloud if is_cloud else schema.RadarScan).DESCRIPTOR.fields:
        if (array := getattr(points, field.name)) is not None:
            # Bytes without a copy, where they lie in memory as they are wanted.
            data = np.ascontiguousarray(array, WIRE.get(field.name, "<f4")).reshape(-1).view(np.uint8).data
            pieces += _nest(field.number, [data])
    return schema.Message.POINTS_FIELD_NUMBER if is_cloud else schema.Message.RADAR_FIELD_NUMBER, pieces


def _pose(pose: Pose) -> tuple[int, Pieces]:
    content = schema.Pose(translation_m=pose.translation_m.tolist(), rotation_xyzw=pose.rotation_xyzw.tolist())
    return schema.Message.POSE_FIELD_NUMBER, [content.SerializeToString()]


_CONTENT: Mapping[type, Callable[..., tuple[int, Pieces]]] = {
    Image: _image,
    PointCloud: _columns,
    RadarScan: _columns,
    Pose: _pose,
}


def _nest(number: int, pieces: Sequence[bytes | memoryview]) -> Pieces:
    return [_varint(number << 3 | 2) + _varint(sum(map(len, pieces))), *pieces]


def _varint(value: int) -> bytes:
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    parts.append(value)
    return bytes(parts)


MAX_STAGES = 64  # Of a frame, and of a run
_MAX_BOXES = 10_000  # Of a frame; each costs time when it is scored
_MAX_FEW = 256  # Sensors that are missing, and faults
_MAX_CHARS = 200
_MAX_ALL_CHARS = 1 << 26  # Of a column, in which each text takes the room of the longest
_MAX_STAGE_NS = 2**62
_ALL_SOURCES = 15
SIZES = {"center_m": 3, "size_lwh_m": 3, "velocity_mps": 3, "xyxy_px": 4, "visible_xyxy_px": 4}  # Numbers a box
_REQUIRED = ("center_m", "size_lwh_m", "yaw_rad", "camera", "xyxy_px")
_TEXTS = ("camera", "label", "attribute", "source_label")
_DTYPES = {
    "track_id": np.int64, "num_lidar_pts": np.int64, "num_radar_pts": np.int64, "sources": np.uint8,
    "predicted": np.bool_, "ignore": np.bool_,
}  # fmt: skip
"""Of columns that are neither texts nor float64."""
COLUMNS = "columns"  # Field that names those that are there without boxes


class ProtocolError(DataError):
    """A program doesn't keep to the protocol: what it says next can't be trusted either."""


def parse_response(data: bytes | bytearray, sequence: int) -> schema.Response:
    """Decode the answer to request `sequence`. Raises ProtocolError where it can't be, or answers another request."""
    try:
        response = schema.Response.FromString(bytes(data))
    except ProtobufError as error:
        raise ProtocolError(f"answered with {len(data)} bytes that are no Response; texts must be UTF-8") from error
    if response.WhichOneof("kind") is None:
        raise ProtocolError("answered with a Response that says nothing of Ready, Done, Output or error")
    if response.sequence != sequence:
        raise ProtocolError(f"answered request {response.sequence}, expected {sequence}")
    return response


def to_output(output: schema.Output) -> Output:
    """Return what a program found. Raises DataError naming the field where boxes are incomplete, too many or not
    finite.
    """
    _require_short("missing", [*output.missing, *output.missing.values()], 2 * _MAX_FEW)
    _require_short("faults", [text for fault in output.faults for text in (fault.code, fault.where)], 2 * _MAX_FEW)
    _require_short("stages", [stage.name for stage in output.stages], MAX_STAGES)
    for stage in output.stages:
        if stage.duration_ns > _MAX_STAGE_NS:
            raise DataError(f"stages: '{stage.name}' took {stage.duration_ns} ns, which can't be")
    for name in ("detections", "tracks"):
        given = getattr(output.in_2d if output.HasField("in_2d") else output.in_3d, name)
        if (num := len(given.camera if output.HasField("in_2d") else given.yaw_rad)) > _MAX_BOXES:
            raise DataError(f"{name}: expected at most {_MAX_BOXES} boxes, got {num}")
        if max(given.sources, default=0) > _ALL_SOURCES:
            raise DataError(f"{name}.sources: expected sums of 1, 2, 4 and 8, got {max(given.sources)}")
    found = read_output(output)
    tracks = type(found.detections).empty() if found.tracks is None else found.tracks
    # An id names one object of a frame, and in images one of each camera.
    ids = [] if tracks.track_id is None else tracks.track_id.tolist()
    cameras = tracks.camera.tolist() if isinstance(tracks, Boxes2D) else [""] * len(ids)
    named = Counter((camera, id_) for camera, id_ in zip(cameras, ids, strict=False) if id_ >= 0)
    twice = next((id_ for (_, id_), num in named.items() if num > 1), None)
    if twice is not None:
        raise DataError(f"tracks: id {twice} is there twice; an id names one object of a frame")
    for name, boxes in (("detections", found.detections), ("tracks", tracks)):
        sane, scored = finite(boxes)
        if not np.all(sane & scored):
            first = int(np.argmin(sane & scored))
            raise DataError(f"{name}: {'score' if sane[first] else 'geometry'} of box {first} isn't finite")
    return found


_MAX_DIGEST = 64  # Digests of a frame, and characters of each: more is no digest of a stage


def read_output(output: schema.Output) -> Output:
    """Return what was found, as it was said. Raises DataError naming the field where boxes are incomplete."""
    kind = output.WhichOneof("boxes")
    if kind is None:
        raise DataError("gave an Output without in_3d or in_2d; set one, empty where nothing was found")
    found = output.in_2d if kind == "in_2d" else output.in_3d
    detections, tracks = (_read_boxes(name, getattr(found, name)) for name in ("detections", "tracks"))
    return Output(
        detections,
        tracks if found.HasField("tracks") else None,
        {stage.name: stage.duration_ns for stage in output.stages},
        tuple(Fault(fault.code, fault.where) for fault in output.faults),
        dict(sorted(output.missing.items())),
        "log" if output.log_clock else "host",
        {part.stage[:_MAX_DIGEST]: part.digest[:_MAX_DIGEST] for part in output.digests[:_MAX_DIGEST]},
    )


def _read_boxes(name: str, boxes: schema.Boxes2D | schema.Boxes3D) -> Boxes:
    columns = dict[str, Array]()
    for field in boxes.DESCRIPTOR.fields:
        values, size = getattr(boxes, field.name), SIZES.get(field.name)
        if size is not None and len(values) % size:
            raise DataError(f"{name}.{field.name}: expected {size} numbers a box, got {len(values)} in all")
        is_there = values or field.name in _REQUIRED or field.name in boxes.columns
        if field.name == COLUMNS or not is_there:
            continue
        if field.name in _TEXTS:
            if len(values) * min(MAX_TEXT, max(map(len, values), default=0)) > _MAX_ALL_CHARS:
                raise DataError(f"{name}.{field.name}: {len(values)} texts are too long")
            columns[field.name] = text_array(list(values))
        else:
            if field.name == "sources" and max(values, default=0) > np.iinfo(np.uint8).max:
                raise DataError(f"{name}.sources: expected 8 bits, got {max(values)}")
            column: Array = np.array(values, _DTYPES.get(field.name, np.float64))
            columns[field.name] = column if size is None else column.reshape(-1, size)
    return Boxes3D(**columns) if isinstance(boxes, schema.Boxes3D) else Boxes2D(**columns)


def _require_short(where: str, texts: Sequence[str], limit: int) -> None:
    if len(texts) > limit:
        raise DataError(f"{where}: expected at most {limit}, got {len(texts)}")
    longest = max(map(len, texts), default=0)
    if longest > _MAX_CHARS:
        raise DataError(f"{where}: a text has {longest} characters, at most {_MAX_CHARS} are taken")
