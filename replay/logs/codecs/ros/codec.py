"""The codec of channels with ROS messages: CDR (ROS 2) or ROS 1."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ParamSpec, TypeVar

import numpy as np

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Message, Truth
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.codec import Codec, Origin, Probe, TruthPart
from fbench.replay.logs.codecs.ros import boxes
from fbench.replay.logs.codecs.ros.boxes import OBJECTS, POSES, UNDEFINED
from fbench.replay.logs.codecs.ros.cursor import CDR, ROS1, Header
from fbench.replay.logs.codecs.ros.decoder import Decode, Reads, camera_model, decoder, edges, get, header, radar_scan
from fbench.replay.logs.codecs.ros.definitions import full_name, has_text, types_of
from fbench.replay.logs.codecs.ros.point_cloud2 import BULK
from fbench.replay.logs.container import Channel
from fbench.replay.logs.coordinate_frames import Edge


def calibration_reads(decode: Decode, encoding: str) -> Reads:
    """CameraInfo."""

    def calibration(data: memoryview) -> tuple[str, CameraModel]:
        info = decode(data)
        frame_id = header(info, encoding).frame_id
        return frame_id, camera_model(info, frame_id)

    return Reads(("calibration",), _probe("calibration", decode, encoding), calibration=calibration)


def transform_reads(decode: Decode, encoding: str) -> Reads:
    """TFMessage, which has no coordinate frame of its own."""

    def probe(data: memoryview) -> Probe:
        decode(data)
        return Probe("transform", "")

    def transforms(data: memoryview) -> Sequence[tuple[str, Edge]]:
        return edges(decode(data))

    def stamps(data: memoryview) -> Sequence[int]:
        return [header(part, encoding).stamp_ns for part in get(decode(data), "transforms")]

    return Reads(("transform",), probe, transforms=transforms, stamps=stamps)


def radar_scan_reads(decode: Decode, encoding: str) -> Reads:
    """RadarScan."""

    def message(kind: str, data: memoryview, origin: Origin) -> Message:
        scan = decode(data)
        return radar_scan(scan, header(scan, encoding).stamp_ns, origin)

    return Reads(("radar",), _probe("radar", decode, encoding), message)


def detections3d_reads(decode: Decode, encoding: str) -> Reads:
    """Detection3DArray."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        head = header(message, encoding)
        return _part(boxes.detections3d(message), head, boxes.frame_of(message, head, encoding), origin)

    return Reads(("truth",), _probe("truth", decode, encoding), truth=truth)


def detections2d_reads(decode: Decode, encoding: str) -> Reads:
    """Detection2DArray; the coordinate frame is that of the camera."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        head = header(message, encoding)
        frame_id = boxes.frame_of(message, head, encoding)
        return _part(boxes.detections2d(message, frame_id), head, frame_id, origin)

    return Reads(("truth",), _probe("truth", decode, encoding), truth=truth)


def radar_tracks_reads(decode: Decode, encoding: str) -> Reads:
    """RadarTracks."""

    def truth(data: memoryview, origin: Origin) -> TruthPart:
        message = decode(data)
        head = header(message, encoding)
        return _part(boxes.radar_tracks(message), head, head.frame_id, origin)

    return Reads(("truth",), _probe("truth", decode, encoding), truth=truth)


def _probe(kind: str, decode: Decode, encoding: str) -> Callable[[memoryview], Probe]:
    return lambda data: Probe(kind, header(decode(data), encoding).frame_id)


def _part(found: Boxes3D | Boxes2D, head: Header, frame_id: str, origin: Origin) -> TruthPart:
    stamp_ns, is_2d = head.stamp_ns, isinstance(found, Boxes2D)
    columns: dict[str, Any] = {"boxes2d" if is_2d else "boxes3d": found}
    truth = Truth(stamp_ns, origin.log_ns, **columns, frame_number=origin.frame_number)
    return TruthPart(truth, is_2d, frame_id=frame_id)


SMALL: Mapping[str, Callable[[Decode, str], Reads]] = {
    "sensor_msgs/msg/CameraInfo": calibration_reads,
    "tf2_msgs/msg/TFMessage": transform_reads,
    "tf/msg/tfMessage": transform_reads,
    "vision_msgs/msg/Detection2DArray": detections2d_reads,
    "vision_msgs/msg/Detection3DArray": detections3d_reads,
    "radar_msgs/msg/RadarScan": radar_scan_reads,
    "radar_msgs/msg/RadarTracks": radar_tracks_reads,
    **POSES,
    **OBJECTS,
}
"""By type: what a channel can be decoded to, given how its payloads are decoded and their encoding."""


P = ParamSpec("P")
T = TypeVar("T")


def ros_codec(channel: Channel) -> Codec | None:
    """Return the codec of a channel; `None` where its encoding or type isn't one that fbench understands. Raises
    DecodeError where the definition that the log gives is damaged, or can't be one of this type.
    """
    name, encoding = full_name(channel.schema_name), channel.encoding
    if encoding not in (CDR, ROS1):
        return None
    if name in BULK:
        _check_standard(name, channel)
        return RosCodec(name, BULK[name](encoding))
    if name in UNDEFINED and not has_text(channel.schema):
        return None
    if name in SMALL:
        decode = decoder(name, types_of(name, channel.schema, encoding), encoding)
        return RosCodec(name, SMALL[name](decode, encoding))
    return None


def _check_standard(name: str, channel: Channel) -> None:
    given = types_of(name, channel.schema, channel.encoding)
    if given != types_of(name, None, channel.encoding):
        raise DecodeError(f"definition of {name} isn't the standard one")


class RosCodec:
    """Implements `Codec` for one type of message, `pkg/msg/Name`."""

    def __init__(self, name: str, reads: Reads) -> None:
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
            with np.errstate(
                all="ignore"
            ):  # values that aren't finite, or out of range, are dealt with where they matter
                return function(*args, **kwargs)
        # A definition in the log may give any field another type than the one that is expected.
        except (TypeError, ValueError, OverflowError, DataError) as error:
            raise DecodeError(f"not a usable {self._name} ({error})") from error
