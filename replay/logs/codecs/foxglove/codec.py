"""The codec of channels with Foxglove schemas, in Protobuf or JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.images import layout_name
from fbench.replay.data.messages import Message, Truth
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.boxes import scene_boxes
from fbench.replay.logs.codecs.codec import Codec, Origin, Probe, TruthPart, part_of
from fbench.replay.logs.codecs.foxglove import messages
from fbench.replay.logs.codecs.foxglove.json_messages import json_codec
from fbench.replay.logs.codecs.foxglove.proto import nanoseconds, parse, split
from fbench.replay.logs.codecs.foxglove.topics import FLAT_SUFFIX, HAS_BOXES2D, KIND, read_calibration
from fbench.replay.logs.codecs.foxglove.truth import read_boxes
from fbench.replay.logs.codecs.packed_points import is_radar
from fbench.replay.logs.codecs.video.stream import require_codec
from fbench.replay.logs.container import Channel
from fbench.replay.logs.coordinate_frames import Edge

JSON = "json"
_MAX_BYTES = 8 * 2**20
"""As of messages of ROS: an entity that says nothing takes two bytes, and a hundred times that in memory."""


_SCHEMAS: Mapping[str, tuple[tuple[str, ...], type[messages.Bulk] | None]] = {
    "foxglove.CompressedImage": (("camera",), CompressedImage),
    "foxglove.CompressedVideo": (("camera",), CompressedVideo),
    "foxglove.RawImage": (("camera",), RawImage),
    "foxglove.PointCloud": (("lidar", "radar"), CloudProto),
    "foxglove.LaserScan": (("lidar",), LaserScan),
    "foxglove.PoseInFrame": (("pose",), None),
    "foxglove.CameraCalibration": (("calibration",), None),
    "foxglove.FrameTransform": (("transform",), None),
    "foxglove.FrameTransforms": (("transform",), None),
    "foxglove.SceneUpdate": (("truth", "detections"), None),
}
"""What channels of a schema can be, and the messages of those with bulk data."""


def foxglove_types() -> Mapping[str, tuple[str, ...]]:
    """What channels can be, by the name of their schema."""
    return {name: kinds for name, (kinds, _) in sorted(_SCHEMAS.items())}


def foxglove_codec(channel: Channel) -> Codec | None:
    """Return the codec of a channel; `None` where its schema isn't one of those that fbench reads."""
    if channel.schema_name not in _SCHEMAS:
        return None
    codec = _FoxgloveCodec(channel.schema_name, channel.topic, is_own=KIND in channel.metadata)
    return json_codec(channel.schema_name, codec) if channel.encoding == JSON else codec


@dataclass(frozen=True)
class _FoxgloveCodec:
    """Decodes the messages of one schema; see `Codec`."""

    schema: str
    topic: str
    is_own: bool = False  # Whether the channel's metadata are those of fbench

    @property
    def kinds(self) -> tuple[str, ...]:
        return _SCHEMAS[self.schema][0]

    def probe(self, data: memoryview) -> Probe:
        """Tell kind and coordinate frame; a cloud with a Doppler field is a radar."""
        kind = self.kinds[0]
        if self.schema == "foxglove.PoseInFrame":
            return Probe(kind, "", messages.pose_frame(data))
        message = _SCHEMAS[self.schema][1]
        if message is None:
            return Probe(kind, "")
        proto = parse(message, data if message is LaserScan else split(data, message.DATA_FIELD_NUMBER)[0])
        if isinstance(proto, RawImage):
            layout_name(proto.encoding)
        if isinstance(proto, CompressedVideo):
            require_codec(proto.format)
        if isinstance(proto, CloudProto) and is_radar(field.name for field in proto.fields):
            kind = "radar"
        doubt = messages.find_doubt(data) if isinstance(proto, CloudProto) and kind == "lidar" else ""
        return Probe(kind, proto.frame_id, doubt=doubt)

    def message(self, kind: str, data: memoryview, origin: Origin) -> Message:
        match self.schema, kind:
            case "foxglove.CompressedVideo", _:
                return messages.read_video(data, origin)
            case "foxglove.RawImage", _:
                return messages.read_raw_image(data, origin)
            case _, "camera":
                return messages.read_compressed_image(data, origin)
            case "foxglove.LaserScan", _:
                return messages.read_planar(data, origin)
            case _, "lidar":
                return messages.read_cloud(data, origin)
            case _, "radar":
                return messages.read_radar(data, origin)
            case _:
                return messages.read_pose(data, origin)

    def assembler(self) -> None:
        """Each message is a measurement."""

    def transforms(self, data: memoryview) -> Sequence[tuple[str, Edge]]:
        return [
            (proto.child_frame_id, Edge(proto.parent_frame_id, *messages.arrays(proto.translation, proto.rotation)))
            for proto in self._transforms(data)
        ]

    def stamps(self, data: memoryview) -> Sequence[int]:
        """Tell when each of the transforms holds [ns]; 0 where none is given."""
        return [nanoseconds(proto.timestamp) for proto in self._transforms(data)]

    def _transforms(self, data: memoryview) -> Sequence[FrameTransform]:
        if self.schema == "foxglove.FrameTransforms":
            return list(parse(FrameTransforms, data).transforms)
        return [parse(FrameTransform, data)]

    def calibration(self, data: memoryview) -> tuple[str, CameraModel]:
        return read_calibration(data)

    def truth(self, data: memoryview, origin: Origin) -> TruthPart:
        """Decode boxes: 3D or 2D ones as fbench wrote them, of other programs 3D ones."""
        if not self.is_own:
            return _read_scene(data, origin)
        stamp_ns, log_ns, number = origin.publish_ns, origin.log_ns, origin.frame_number
        if self.topic.endswith(FLAT_SUFFIX):
            boxes2d, _ = read_boxes(data, Boxes2D)
            return TruthPart(Truth(stamp_ns, log_ns, None, boxes2d, number), is_2d=True)
        boxes3d, more = read_boxes(data, Boxes3D)
        return TruthPart(Truth(stamp_ns, log_ns, boxes3d, None, number), False, more.get(HAS_BOXES2D) == "yes")


def _read_scene(data: memoryview, origin: Origin) -> TruthPart:
    """Decode the boxes of a scene, at the newest stamp of its entities; deletions give nothing but a stamp. Raises
    DecodeError where the message is damaged or too large, or a box isn't finite.
    """
    if len(data) > _MAX_BYTES:
        raise DecodeError(f"scene of {len(data)} bytes, more than {_MAX_BYTES}")
    scene = parse(SceneUpdate, data)
    try:
        with np.errstate(all="ignore"):  # values that aren't finite, or out of range, are dealt with where they matter
            boxes, frames = scene_boxes(scene.entities)
    except (ValueError, DataError) as error:
        raise DecodeError(f"not a usable scene ({error})") from error
    timed: Sequence[SceneEntity | SceneEntityDeletion] = scene.entities or scene.deletions
    stamp_ns = max((nanoseconds(part.timestamp) for part in timed), default=0)
    truth = Truth(stamp_ns or origin.publish_ns, origin.log_ns, boxes, frame_number=origin.frame_number)
    return part_of(truth, frames)
