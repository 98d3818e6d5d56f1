"""The codec of channels with Foxglove Protobuf schemas."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from fbench.replay.data import Boxes2D, Boxes3D, CameraModel, Message, Truth
from fbench.replay.logs.codec import Codec, Origin, Probe
from fbench.replay.logs.container import Channel
from fbench.replay.logs.foxglove.messages import (
    pose_frame,
    read_cloud,
    read_compressed_image,
    read_pose,
    read_radar,
    read_raw_image,
)  # fmt: skip
from fbench.replay.logs.foxglove.proto import nanoseconds, parse
from fbench.replay.logs.foxglove.rig import read_calibration, read_transform
from fbench.replay.logs.foxglove.scene import read_scene
from fbench.replay.logs.foxglove.topics import FLAT_SUFFIX, HAS_BOXES2D, KIND
from fbench.replay.logs.foxglove.truth import read_boxes
from fbench.replay.logs.foxglove.wire import split
from fbench.replay.logs.point_fields import is_radar
from fbench.replay.logs.tree import Edge
from fbench.replay.logs.truth_part import TruthPart
from fbench.replay.raw_images import layout_name

_KINDS: Mapping[str, tuple[str, ...]] = {
    "foxglove.CompressedImage": ("camera",),
    "foxglove.RawImage": ("camera",),
    "foxglove.PointCloud": ("lidar", "radar"),
    "foxglove.PoseInFrame": ("pose",),
    "foxglove.CameraCalibration": ("calibration",),
    "foxglove.FrameTransform": ("transform",),
    "foxglove.FrameTransforms": ("transform",),
    "foxglove.SceneUpdate": ("truth", "detections"),
}
_SENSORS: Mapping[str, type[CompressedImage | RawImage | CloudProto]] = {
    "foxglove.CompressedImage": CompressedImage,
    "foxglove.RawImage": RawImage,
    "foxglove.PointCloud": CloudProto,
}


def foxglove_codec(channel: Channel) -> Codec | None:
    """Return the codec of a channel; `None` where its schema isn't one of those that fbench reads."""
    is_own = KIND in channel.metadata
    return FoxgloveCodec(channel.schema_name, channel.topic, is_own) if channel.schema_name in _KINDS else None


@dataclass(frozen=True)
class FoxgloveCodec:
    """Decodes the messages of one schema; see `Codec`."""

    schema: str
    topic: str
    is_own: bool = False
    """Whether the channel's metadata are those of fbench."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """What the channel can be."""
        return _KINDS[self.schema]

    def probe(self, data: memoryview) -> Probe:
        """Tell kind and coordinate frame; a cloud with a Doppler field is a radar."""
        kind = self.kinds[0]
        if self.schema == "foxglove.PoseInFrame":
            return Probe(kind, "", pose_frame(data))
        if self.schema not in _SENSORS:
            return Probe(kind, "")
        message = _SENSORS[self.schema]
        proto = parse(message, split(data, message.DATA_FIELD_NUMBER)[0])
        if isinstance(proto, RawImage):
            layout_name(proto.encoding)
        if isinstance(proto, CloudProto) and is_radar(field.name for field in proto.fields):
            kind = "radar"
        return Probe(kind, proto.frame_id)

    def message(self, kind: str, data: memoryview, origin: Origin) -> Message:
        """Decode a measurement or pose."""
        if self.schema == "foxglove.RawImage":
            return read_raw_image(data, origin)
        match kind:
            case "camera":
                return read_compressed_image(data, origin)
            case "lidar":
                return read_cloud(data, origin)
            case "radar":
                return read_radar(data, origin)
            case _:
                return read_pose(data, origin)

    def transforms(self, data: memoryview) -> Sequence[tuple[str, Edge]]:
        """Decode one or several transforms."""
        return [read_transform(proto) for proto in self._transforms(data)]

    def stamps(self, data: memoryview) -> Sequence[int]:
        """Tell when each of the transforms holds [ns]; 0 where none is given."""
        return [nanoseconds(proto.timestamp) for proto in self._transforms(data)]

    def _transforms(self, data: memoryview) -> Sequence[FrameTransform]:
        if self.schema == "foxglove.FrameTransforms":
            return list(parse(FrameTransforms, data).transforms)
        return [parse(FrameTransform, data)]

    def calibration(self, data: memoryview) -> tuple[str, CameraModel]:
        """Decode the coordinate frame and intrinsics of a camera."""
        return read_calibration(data)

    def truth(self, data: memoryview, origin: Origin) -> TruthPart:
        """Decode boxes: 3D or 2D ones as fbench wrote them, of other programs 3D ones."""
        if not self.is_own:
            return read_scene(data, origin)
        stamp_ns, log_ns, number = origin.publish_ns, origin.log_ns, origin.frame_number
        if self.topic.endswith(FLAT_SUFFIX):
            boxes2d, _ = read_boxes(data, Boxes2D)
            return TruthPart(Truth(stamp_ns, log_ns, None, boxes2d, number), is_2d=True)
        boxes3d, more = read_boxes(data, Boxes3D)
        return TruthPart(Truth(stamp_ns, log_ns, boxes3d, None, number), False, more.get(HAS_BOXES2D) == "yes")
