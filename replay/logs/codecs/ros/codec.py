"""The codec of channels with ROS messages: CDR (ROS 2) or ROS 1."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeVar

import numpy as np

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.messages import Message
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.codec import Codec, Origin, Probe, TruthPart
from fbench.replay.logs.codecs.ros.boxes import (
    autoware_objects_reader,
    derived_objects_reader,
    detections2d_reader,
    detections3d_reader,
    marker_reader,
    radar_tracks_reader,
    scene_update_reader,
)
from fbench.replay.logs.codecs.ros.camera import (
    camera_info_reader,
    compressed_image_reader,
    image_reader,
    read_compressed_image,
    read_raw_image,
)
from fbench.replay.logs.codecs.ros.cursor import CDR, ROS1
from fbench.replay.logs.codecs.ros.decoder import Decode, MessageReader, decoder
from fbench.replay.logs.codecs.ros.definitions import full_name, has_text, types_of
from fbench.replay.logs.codecs.ros.point_cloud2 import point_cloud_reader, read_cloud
from fbench.replay.logs.codecs.ros.poses import pose_reader, transform_reader
from fbench.replay.logs.codecs.ros.radar_scan import radar_scan_reader
from fbench.replay.logs.container import Channel
from fbench.replay.logs.coordinate_frames import Edge

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class _Type:
    """How fbench reads one type of message."""

    make_reader: Callable[[Decode, str], MessageReader]
    layout: Callable[[memoryview, str], Any] | None = None
    """Decodes a payload of an encoding by the standard's definition, and no other, without rosbags."""
    needs_definition: bool = False  # Of the log: there are several generations of the type


_TYPES: Mapping[str, _Type] = {
    "sensor_msgs/msg/PointCloud2": _Type(point_cloud_reader, layout=read_cloud),
    "sensor_msgs/msg/Image": _Type(image_reader, layout=read_raw_image),
    "sensor_msgs/msg/CompressedImage": _Type(compressed_image_reader, layout=read_compressed_image),
    "sensor_msgs/msg/CameraInfo": _Type(camera_info_reader),
    "radar_msgs/msg/RadarScan": _Type(radar_scan_reader),
    "tf2_msgs/msg/TFMessage": _Type(transform_reader),
    "tf/msg/tfMessage": _Type(transform_reader),
    "nav_msgs/msg/Odometry": _Type(pose_reader),
    "geometry_msgs/msg/PoseStamped": _Type(pose_reader),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _Type(pose_reader),
    "vision_msgs/msg/Detection2DArray": _Type(detections2d_reader),
    "vision_msgs/msg/Detection3DArray": _Type(detections3d_reader),
    "radar_msgs/msg/RadarTracks": _Type(radar_tracks_reader),
    **{
        f"{package}/msg/{name}Objects": _Type(autoware_objects_reader, needs_definition=True)
        for package in ("autoware_perception_msgs", "autoware_auto_perception_msgs")
        for name in ("Detected", "Tracked", "Predicted")
    },
    "derived_object_msgs/msg/ObjectArray": _Type(derived_objects_reader, needs_definition=True),
    "foxglove_msgs/msg/SceneUpdate": _Type(scene_update_reader, needs_definition=True),
    "visualization_msgs/msg/MarkerArray": _Type(marker_reader),
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
    if known.layout is None:
        decode = decoder(name, types, encoding)
    elif types == types_of(name, None, encoding):
        decode = _bind(known.layout, encoding)
    else:
        raise DecodeError(f"definition of {name} isn't the standard one")
    return RosCodec(name, known.make_reader(decode, encoding))


def _bind(layout: Callable[[memoryview, str], Any], encoding: str) -> Decode:
    return lambda data: layout(data, encoding)


class RosCodec:
    """Implements `Codec` for one type of message, `pkg/msg/Name`."""

    def __init__(self, name: str, reads: MessageReader) -> None:
        self._name, self._reads = name, reads

    @property
    def kinds(self) -> tuple[str, ...]:
        """What the channel can be."""
        return self._reads.kinds

    def probe(self, data: memoryview) -> Probe:
        """Tell kind and coordinate frame; images that can't be shown (depth, say) are refused here already."""
        return self._call(self._reads.probe, data)

    def message(self, kind: str, data: memoryview, origin: Origin) -> Message:
        """Decode a measurement; its stamp is 0 where the header has none."""
        return self._call(self._given(self._reads.message, "measurement"), kind, data, origin)

    def transforms(self, data: memoryview) -> Sequence[tuple[str, Edge]]:
        """Decode transforms: child and its pose in the parent."""
        return self._call(self._given(self._reads.transforms, "transform"), data)

    def stamps(self, data: memoryview) -> Sequence[int]:
        """Tell when each of the transforms holds [ns]; 0 where none is given."""
        return self._call(self._given(self._reads.stamps, "transform"), data)

    def calibration(self, data: memoryview) -> tuple[str, CameraModel]:
        """Decode the coordinate frame and intrinsics of a camera."""
        return self._call(self._given(self._reads.calibration, "calibration"), data)

    def truth(self, data: memoryview, origin: Origin) -> TruthPart:
        """Decode boxes, in the coordinate frame of their header."""
        return self._call(self._given(self._reads.truth, "box"), data, origin)

    def _given(self, function: Callable[P, T] | None, what: str) -> Callable[P, T]:
        if function is None:
            raise DecodeError(f"{self._name} holds no {what}")
        return function

    def _call(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            # Values that aren't finite, or out of range, are dealt with where they matter.
            with np.errstate(all="ignore"):
                return function(*args, **kwargs)
        # A definition in the log may give any field another type than the one that is expected.
        except (AttributeError, LookupError, TypeError, ValueError, OverflowError, DataError) as error:
            raise DecodeError(f"not a usable {self._name} ({error})") from error
