"""Topics, channel metadata and payloads of everything that an MCAP log of fbench holds."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from google.protobuf.message import Message as Proto

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.data.video import CODECS
from fbench.replay.logs.codecs.codec import TruthPart, split_truth
from fbench.replay.logs.codecs.foxglove import messages
from fbench.replay.logs.codecs.foxglove.proto import parse, timestamp
from fbench.replay.logs.codecs.foxglove.truth import boxes_proto
from fbench.replay.logs.coordinate_frames import BODY


def read_calibration(data: bytes | memoryview) -> tuple[str, CameraModel]:
    """Decode coordinate frame and intrinsics. Raises DecodeError where the message is damaged or not calibrated."""
    proto = parse(CameraCalibration, data)
    if len(proto.K) != 9 or not any(proto.K):
        raise DecodeError(f"camera '{proto.frame_id}' isn't calibrated (K has {len(proto.K)} values)")
    K = np.array(list(proto.K)).reshape(3, 3)
    model = CameraModel(K, (proto.width, proto.height), proto.distortion_model, np.array(list(proto.D)))
    if not model.is_sound:
        raise DecodeError(f"camera '{proto.frame_id}' has no valid focal length, center and distortion")
    if not (proto.width and proto.height):
        raise DecodeError(f"camera '{proto.frame_id}' has an image size of {proto.width}x{proto.height}")
    return proto.frame_id, model


KIND, SENSOR, FRAME_NUMBER, SIZE = "kind", "sensor", "frame_number", "size_wh"  # Keys of channel metadata
SEQUENCE = "sequence"  # Value of `FRAME_NUMBER`: the container's sequence number holds the frame number
HAS_BOXES2D = "boxes_2d"  # Key in the metadata of 3D truth: whether 2D truth of the same stamp follows
FLAT_SUFFIX = "_2d"  # Ends the topics of fbench's own messages with boxes in images
BOXES3D, BOXES2D = "/truth/boxes", "/truth/boxes_2d"
RESULTS3D, RESULTS2D = "/results/boxes", "/results/boxes_2d"  # Of another system


class Record(NamedTuple):
    """One message as the container holds it."""

    topic: str
    metadata: Mapping[str, str]  # Of its channel
    proto: Proto


def message_records(message: Message | Truth) -> Iterator[Record]:
    """Encode a message: one record, for truth up to two. Raises ValueError where Protobuf can't hold a value: a text
    that isn't Unicode, a size beyond 32 bits.
    """
    numbered = {} if message.frame_number is None else {FRAME_NUMBER: SEQUENCE}
    if isinstance(message, Truth):
        yield from map(part_record, split_truth(message))
        return
    kind, _, encode = _FORMS[type(message)]
    proto = encode(message)
    metadata = {KIND: kind, SENSOR: message.sensor, **numbered}
    if isinstance(message, Image) and message.encoding not in CODECS:  # whose keyframes say it
        width, height = message.size_wh
        metadata[SIZE] = f"{width}x{height}"
    yield Record(message_topic(message), metadata, proto)


def message_topic(message: Message) -> str:
    """Topic of a measurement or pose in fbench's own logs."""
    return _FORMS[type(message)][1].format(message.sensor)


_FORMS: Mapping[type[Message], tuple[str, str, Callable[[Any], Proto]]] = {
    Image: ("camera", "/{}/image", messages.image_proto), PointCloud: ("lidar", "/{}/points", messages.cloud_proto),
    RadarScan: ("radar", "/{}/points", messages.radar_proto), Pose: ("pose", "/pose", messages.pose_proto),
}  # fmt: skip
"""Kind, topic and encoding of messages."""


def part_record(part: TruthPart, kind: str = "truth") -> Record:
    """Encode the 3D or the 2D boxes of one instant; `kind` is `truth`, or `detections` for those of another system.
    Raises ValueError as for messages, or where the boxes aren't in body coordinates.
    """
    truth = part.truth
    if part.frame_id:
        raise ValueError(f"boxes in coordinate frame '{part.frame_id}'")
    numbered = {} if truth.frame_number is None else {FRAME_NUMBER: SEQUENCE}
    metadata = {KIND: kind, **numbered}
    topic3d, topic2d = (BOXES3D, BOXES2D) if kind == "truth" else (RESULTS3D, RESULTS2D)
    if part.is_2d:
        return Record(topic2d, metadata, boxes_proto(truth.stamp_ns, truth.boxes2d))
    has_2d = {HAS_BOXES2D: "yes" if part.expects_2d else "no"}
    return Record(topic3d, metadata, boxes_proto(truth.stamp_ns, truth.boxes3d, has_2d))


def rig_records(stamp_ns: int, rig: Rig) -> Iterator[Record]:
    """Encode a rig: where each sensor sits on the body, and the intrinsics of each camera, whose images are used as
    they are (R = I, P = [K 0]). Raises ValueError as for messages.
    """
    stamp = timestamp(stamp_ns)
    for sensor, mount in sorted(rig.mounts.items()):
        place, turn = messages.vector(mount.translation_m), messages.rotation(mount.rotation_xyzw)
        proto = FrameTransform(
            timestamp=stamp, parent_frame_id=BODY, child_frame_id=sensor, translation=place, rotation=turn
        )
        yield Record("/tf", {KIND: "transform"}, proto)
    for sensor, camera in sorted(rig.cameras.items()):
        width, height = camera.size_wh
        projection = np.concatenate([camera.K, np.zeros((3, 1))], axis=1)
        calibration = CameraCalibration(
            timestamp=stamp, frame_id=sensor, width=width, height=height, distortion_model=camera.distortion_model,
            D=camera.distortion.tolist(), K=camera.K.ravel().tolist(), R=np.eye(3).ravel().tolist(),
            P=projection.ravel().tolist(),
        )  # fmt: skip
        yield Record(f"/{sensor}/calibration", {KIND: "calibration", SENSOR: sensor}, calibration)
