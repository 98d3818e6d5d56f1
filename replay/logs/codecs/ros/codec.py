"""The codec of channels with ROS messages: CDR (ROS 2) or ROS 1."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.messages import Message
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.codec import SENSORS, Codec, Origin, Probe, TruthPart
from fbench.replay.logs.codecs.ros import boxes, camera, clouds, poses
from fbench.replay.logs.codecs.ros.cursor import CDR, ROS1
from fbench.replay.logs.codecs.ros.decoder import Decode, decoder, header
from fbench.replay.logs.codecs.ros.definitions import full_name, has_text, types_of
from fbench.replay.logs.container import Channel
from fbench.replay.logs.coordinate_frames import Edge

T = TypeVar("T")


@dataclass(frozen=True)
class _Type:
    """Functions of decoded messages of a type and their encoding; `None` where the type holds no such thing."""

    kinds: tuple[str, ...]
    message: Callable[[str, Any, str, Origin], Message] | None = None
    transforms: Callable[[Any], Sequence[tuple[str, Edge]]] | None = None
    calibration: Callable[[Any, str], tuple[str, CameraModel]] | None = None
    truth: Callable[[Any, str, Origin], TruthPart] | None = None
    probe: Callable[[Any, str], Probe] | None = None  # `None`: the header of sensors tells the coordinate frame
    layout: Callable[[memoryview, str], Any] | None = None
    """Decodes a payload of an encoding by the standard's definition, and no other, without rosbags."""
    needs_definition: bool = False  # Of the log: there are several generations of the type


_TF = _Type(("transform",), transforms=poses.transforms)
_POSE = _Type(("odometry",), poses.pose, probe=poses.probe_pose)
_TYPES: Mapping[str, _Type] = {
    "sensor_msgs/msg/PointCloud2": _Type(
        ("lidar", "radar"), clouds.cloud_message, probe=clouds.probe_cloud, layout=clouds.read_cloud
    ),
    "sensor_msgs/msg/Image": _Type(
        ("camera",), camera.raw_image, probe=camera.probe_image, layout=camera.read_raw_image
    ),
    "sensor_msgs/msg/CompressedImage": _Type(
        ("camera",), camera.decode_compressed_image, probe=camera.probe_image, layout=camera.read_compressed_image
    ),
    "sensor_msgs/msg/CameraInfo": _Type(("calibration",), calibration=camera.camera_model),
    "radar_msgs/msg/RadarScan": _Type(("radar",), clouds.radar_scan),
    "tf2_msgs/msg/TFMessage": _TF,
    "tf/msg/tfMessage": _TF,
    "nav_msgs/msg/Odometry": _POSE,
    "geometry_msgs/msg/PoseStamped": _POSE,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _POSE,
    "vision_msgs/msg/Detection2DArray": _Type(("truth",), truth=boxes.detections2d),
    "vision_msgs/msg/Detection3DArray": _Type(("truth",), truth=boxes.detections3d),
    "radar_msgs/msg/RadarTracks": _Type(("truth",), truth=boxes.radar_tracks),
    **{
        f"{package}/msg/{name}Objects": _Type(("truth",), truth=boxes.autoware_objects, needs_definition=True)
        for package in ("autoware_perception_msgs", "autoware_auto_perception_msgs")
        for name in ("Detected", "Tracked", "Predicted")
    },
    "derived_object_msgs/msg/ObjectArray": _Type(("truth",), truth=boxes.decode_derived_objects, needs_definition=True),
    "foxglove_msgs/msg/SceneUpdate": _Type(("truth",), truth=boxes.scene_update, needs_definition=True),
    "visualization_msgs/msg/MarkerArray": _Type(("detections",), truth=boxes.marker_boxes),
}
"""All types that fbench reads."""


def ros_codec(channel: Channel) -> Codec | None:
    """Return the codec of a channel; `None` where its encoding or type isn't one that fbench understands. Raises
    DecodeError where the definition that the log gives is damaged, or can't be one of this type.
    """
    name, encoding = full_name(channel.schema_name), channel.encoding
    known = _TYPES.get(name)
    if encoding not in (CDR, ROS1) or known is None or (known.needs_definition and not has_text(channel.schema)):
        return None
    types = types_of(name, channel.schema, encoding)
    if (layout := known.layout) is None:
        return _RosCodec(name, known, encoding, decoder(name, types, encoding))
    if types == types_of(name, None, encoding):
        return _RosCodec(name, known, encoding, lambda data: layout(data, encoding))
    raise DecodeError(f"definition of {name} isn't the standard one")


def ros_types() -> Mapping[str, tuple[str, ...]]:
    """What channels can be, by the name of their type."""
    return {name: known.kinds for name, known in sorted(_TYPES.items())}


def lacks_definition(channel: Channel) -> bool:
    """Tell whether a channel's type is one that fbench can't read without the definition, which the log doesn't hold
    in a form that is read.
    """
    known = _TYPES.get(full_name(channel.schema_name))
    return known is not None and known.needs_definition and not has_text(channel.schema)


class _RosCodec:
    """Implements `Codec` for one type of message, `pkg/msg/Name`."""

    def __init__(self, name: str, known: _Type, encoding: str, decode: Decode) -> None:
        self._name, self._type, self._encoding, self._decode = name, known, encoding, decode

    @property
    def kinds(self) -> tuple[str, ...]:
        return self._type.kinds

    def probe(self, data: memoryview) -> Probe:
        """Tell kind and coordinate frame; images that can't be shown (depth, say) are refused here already."""
        with self._guard(self._type.probe or self._probe_header, "") as probe:
            return probe(self._decode(data), self._encoding)

    def message(self, kind: str, data: memoryview, origin: Origin) -> Message:
        """Decode a measurement; its stamp is 0 where the header has none."""
        with self._guard(self._type.message, "measurement") as read:
            return read(kind, self._decode(data), self._encoding, origin)

    def transforms(self, data: memoryview) -> Sequence[tuple[str, Edge]]:
        with self._guard(self._type.transforms, "transform") as read:
            return read(self._decode(data))

    def stamps(self, data: memoryview) -> Sequence[int]:
        """Tell when each of the transforms holds [ns]; 0 where none is given."""
        with self._guard(self._type.transforms and poses.stamps, "transform") as read:
            return read(self._decode(data), self._encoding)

    def calibration(self, data: memoryview) -> tuple[str, CameraModel]:
        with self._guard(self._type.calibration, "calibration") as read:
            return read(self._decode(data), self._encoding)

    def truth(self, data: memoryview, origin: Origin) -> TruthPart:
        """Decode boxes, in the coordinate frame of their header."""
        with self._guard(self._type.truth, "box") as read:
            return read(self._decode(data), self._encoding, origin)

    def _probe_header(self, message: Any, encoding: str) -> Probe:
        is_sensor = self.kinds[0] in (*SENSORS, "calibration")
        return Probe(self.kinds[0], header(message, encoding).frame_id if is_sensor else "")

    @contextmanager
    def _guard(self, function: T | None, what: str) -> Iterator[T]:
        if function is None:
            raise DecodeError(f"{self._name} holds no {what}")
        try:
            # Values that aren't finite, or out of range, are dealt with where they matter.
            with np.errstate(all="ignore"):
                yield function
        # A definition in the log may give any field another type than the one that is expected.
        except (AttributeError, LookupError, TypeError, ValueError, OverflowError, DataError) as error:
            raise DecodeError(f"not a usable {self._name} ({error})") from error
