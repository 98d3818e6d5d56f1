"""Codec between a rig and `foxglove.FrameTransform`, `foxglove.CameraCalibration`."""

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from fbench.replay.data import CameraModel, Mount
from fbench.replay.errors import DecodeError
from fbench.replay.logs.foxglove.messages import arrays, rotation, vector
from fbench.replay.logs.foxglove.proto import parse, timestamp
from fbench.replay.logs.tree import BODY, Edge


def transform_proto(stamp_ns: int, sensor: str, mount: Mount) -> FrameTransform:
    """Encode where a sensor sits on the body."""
    return FrameTransform(
        timestamp=timestamp(stamp_ns), parent_frame_id=BODY, child_frame_id=sensor,
        translation=vector(mount.translation_m), rotation=rotation(mount.rotation_xyzw),
    )  # fmt: skip


def calibration_proto(stamp_ns: int, sensor: str, camera: CameraModel) -> CameraCalibration:
    """Encode the intrinsics of a camera whose images are used as they are (R = I, P = [K 0])."""
    width, height = camera.size_wh
    projection = np.concatenate([camera.K, np.zeros((3, 1))], axis=1)
    return CameraCalibration(
        timestamp=timestamp(stamp_ns), frame_id=sensor, width=width, height=height,
        distortion_model=camera.distortion_model, D=camera.distortion.tolist(), K=camera.K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(), P=projection.ravel().tolist(),
    )  # fmt: skip


def read_calibration(data: bytes | memoryview) -> tuple[str, CameraModel]:
    """Decode the coordinate frame and intrinsics of a camera.

    Raises:
        DecodeError: where the message is damaged or the camera isn't calibrated.
    """
    proto = parse(CameraCalibration, data)
    if len(proto.K) != 9 or not any(proto.K):
        raise DecodeError(f"camera '{proto.frame_id}' isn't calibrated (K has {len(proto.K)} values)")
    K = np.array(list(proto.K)).reshape(3, 3)
    distortion = np.array(list(proto.D))
    if not (np.isfinite(K).all() and np.isfinite(distortion).all() and K[0, 0] > 0 and K[1, 1] > 0):
        raise DecodeError(f"camera '{proto.frame_id}' has no valid focal length, centre and distortion")
    if not (proto.width and proto.height):
        raise DecodeError(f"camera '{proto.frame_id}' has an image size of {proto.width}x{proto.height}")
    return proto.frame_id, CameraModel(K, (proto.width, proto.height), proto.distortion_model, np.array(list(proto.D)))


def read_transform(proto: FrameTransform) -> tuple[str, Edge]:
    """Return child and edge."""
    return proto.child_frame_id, Edge(proto.parent_frame_id, *arrays(proto.translation, proto.rotation))
