"""Messages without bulk data, decoded by rosbags: calibration, transforms, boxes, radar returns."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fbench.replay.data import Boxes2D, Boxes3D, CameraModel, Message, Truth
from fbench.replay.logs.codec import Origin, Probe
from fbench.replay.logs.ros import boxes
from fbench.replay.logs.ros.calibration import camera_model, edges
from fbench.replay.logs.ros.cursor import Header
from fbench.replay.logs.ros.decoder import Decode
from fbench.replay.logs.ros.fields import get, header
from fbench.replay.logs.ros.object_reads import OBJECTS, POSES
from fbench.replay.logs.ros.radar import radar_scan
from fbench.replay.logs.ros.reads import Reads
from fbench.replay.logs.tree import Edge
from fbench.replay.logs.truth_part import TruthPart


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
