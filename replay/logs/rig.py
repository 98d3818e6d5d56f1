"""Codec between a rig and `foxglove.FrameTransform`, `foxglove.CameraCalibration`; the tree of transforms."""

from dataclasses import dataclass, field

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from fbench.replay.arrays import Float64
from fbench.replay.data import CameraModel, Mount
from fbench.replay.errors import DecodeError
from fbench.replay.geometry.transforms import pose_matrix, quaternion
from fbench.replay.logs.foxglove import BODY, arrays, rotation, vector
from fbench.replay.logs.proto import parse, timestamp


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


def read_calibration(data: bytes) -> tuple[str, CameraModel]:
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


@dataclass(frozen=True, eq=False)
class Edge:
    """The pose of a coordinate frame in its parent's."""

    parent: str
    translation_m: Float64
    rotation_xyzw: Float64


def read_transform(proto: FrameTransform) -> tuple[str, Edge]:
    """Return child and edge."""
    return proto.child_frame_id, Edge(proto.parent_frame_id, *arrays(proto.translation, proto.rotation))


@dataclass
class TransformTree:
    """Transforms by child; the first one of each child counts."""

    edges: dict[str, Edge] = field(default_factory=dict)

    def add(self, child: str, edge: Edge) -> None:
        """Add a transform unless the child has one."""
        self.edges.setdefault(child, edge)

    def path(self, frame: str) -> list[str]:
        """Coordinate frames from `frame` to its root; stops where a loop closes."""
        path = [frame]
        while path[-1] in self.edges and self.edges[path[-1]].parent not in path:
            path.append(self.edges[path[-1]].parent)
        return path

    def known(self, frame: str) -> bool:
        """Tell whether `frame` reaches a coordinate frame that is called like a body."""
        path = self.path(frame)
        return BODY in path or "base_link" in path

    def body(self, frame: str) -> str:
        """Coordinate frame that counts as the body for `frame`: `body`, else `base_link`, else the root."""
        path = self.path(frame)
        return next((name for name in (BODY, "base_link") if name in path), path[-1])

    def pose(self, frame: str) -> tuple[Float64, Float64] | None:
        """Translation (3,) and quaternion (4,) of `frame` in the body's; `None` where nothing links them.

        A direct transform is returned as it is stored, a chain is composed; a sensor in the body's frame sits at 0.

        Raises:
            DecodeError: where a quaternion of a chain is zero.
        """
        body = self.body(frame)
        if frame == body:
            return (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])) if self._is_body(frame) else None
        edge = self.edges[frame]
        if edge.parent == body:
            return edge.translation_m, edge.rotation_xyzw
        matrix = self._chain(self.path(frame), body)
        return matrix[:3, 3].copy(), quaternion(matrix[:3, :3])

    def _is_body(self, frame: str) -> bool:
        return frame in (BODY, "base_link") or any(edge.parent == frame for edge in self.edges.values())

    def _chain(self, path: list[str], body: str) -> Float64:
        matrix = np.eye(4)
        for frame in path[: path.index(body)]:
            edge = self.edges[frame]
            try:
                matrix = pose_matrix(edge.translation_m, edge.rotation_xyzw) @ matrix
            except ValueError as error:
                raise DecodeError(f"transform of '{frame}' has no valid rotation ({error})") from error
        return matrix
